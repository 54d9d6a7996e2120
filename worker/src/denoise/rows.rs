//! The rows of a denoised picture, from those of its tiles.

use std::ops::Range;

use proto::Rect;
use scene::job::GUIDE_CHANNELS;
use scene::{Image, Layer};

use super::{MARGIN_PX, Region};
use crate::renderer::TilePixels;
use crate::stitch::{RowBand, RowSource, StitchError};

/// Pixels of a region that is denoised at once, if its rows are not too long.
const REGION_PIXELS: usize = 3 << 20;

/// Where the planes of a picture are that is denoised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DenoisedPlanes {
    height: u32,
    /// Number of planes of the finished picture; those of the guides follow.
    finished: usize,
    /// The first plane of the colors before the denoiser, if they are kept.
    noisy: Option<usize>,
}

impl DenoisedPlanes {
    /// The planes of a picture; `None` if it is not denoised.
    pub(crate) fn of(image: &Image) -> Option<Self> {
        let channels = image.channels();
        let noisy = channels.iter().position(|channel| *channel == Layer::Noisy.channels()[0]);
        image.is_denoised().then_some(Self { height: image.height, finished: channels.len(), noisy })
    }

    fn rendered(self) -> usize {
        self.finished + GUIDE_CHANNELS.len()
    }

    /// The finished planes of a rectangle of rendered pixels.
    fn finish(self, width: usize, height: usize, mut planes: Vec<Vec<f32>>) -> Vec<Vec<f32>> {
        let guides = planes.split_off(self.finished);
        let color: [Vec<f32>; 3] = std::array::from_fn(|channel| planes[channel].clone());
        let [red, green, blue, x, y, z, inverse_depth, error] =
            <[Vec<f32>; GUIDE_CHANNELS.len()]>::try_from(guides).expect("a rendered picture has all guides");
        let (albedo, normal) = ([red, green, blue], [x, y, z]);
        let region = Region { width, height, color, albedo, normal, inverse_depth, error };
        let denoised = region.denoised();
        if let Some(noisy) = self.noisy {
            planes.splice(noisy..noisy + 3, region.color);
        }
        for (plane, denoised) in planes.iter_mut().zip(denoised) {
            // A file must not distinguish zeros by their sign.
            *plane = denoised.into_iter().map(|value| value + 0.0).collect();
        }
        planes
    }

    /// The finished pixels of `inner`, from rendered ones that reach [`MARGIN_PX`] farther, or to the edge of the
    /// picture.
    pub(crate) fn finished_tile(self, rendered: TilePixels, inner: Rect) -> TilePixels {
        let TilePixels { rect, planes } = rendered;
        let planes = self.finish(rect.width as usize, rect.height as usize, planes);
        let cropped = |plane: &Vec<f32>| {
            let rows = plane.chunks_exact(rect.width as usize).skip((inner.y - rect.y) as usize);
            let rows = rows.take(inner.height as usize);
            let left = (inner.x - rect.x) as usize;
            rows.flat_map(|row| row[left..left + inner.width as usize].iter().copied()).collect()
        };
        TilePixels { rect: inner, planes: planes.iter().map(cropped).collect() }
    }
}

/// Denoises the rows of a picture.
pub(crate) struct DenoisedRows<'a> {
    source: &'a mut dyn RowSource,
    planes: DenoisedPlanes,
    width: u32,
    /// Rows that are finished at once.
    rows: u32,
    /// Rows that are finished, with their planes.
    finished: (Range<u32>, Vec<Vec<f32>>),
}

impl<'a> DenoisedRows<'a> {
    /// The rows of a picture of this width.
    pub(crate) fn new(source: &'a mut dyn RowSource, planes: DenoisedPlanes, width: u32) -> Self {
        let fitting = u32::try_from(REGION_PIXELS / width as usize).unwrap_or(u32::MAX);
        let rows = fitting.saturating_sub(2 * MARGIN_PX).max(2 * MARGIN_PX);
        Self { source, planes, width, rows, finished: (0..0, Vec::new()) }
    }

    /// Finishes rows from `start` on.
    fn finish_from(&mut self, start: u32) -> Result<(), StitchError> {
        let height = self.planes.height;
        let end = start.saturating_add(self.rows).min(height);
        let rows = start.saturating_sub(MARGIN_PX)..end.saturating_add(MARGIN_PX).min(height);
        let mut band = RowBand::new(self.width, self.planes.rendered());
        self.source.read(rows.clone(), &mut band)?;
        let width = self.width as usize;
        let mut planes = self.planes.finish(width, rows.len(), band.into_planes());
        for plane in &mut planes {
            plane.truncate((end - rows.start) as usize * width);
            plane.drain(..(start - rows.start) as usize * width);
        }
        self.finished = (start..end, planes);
        Ok(())
    }
}

impl RowSource for DenoisedRows<'_> {
    fn read(&mut self, rows: Range<u32>, band: &mut RowBand) -> Result<(), StitchError> {
        band.reset(rows.clone());
        for (index, row) in rows.enumerate() {
            if !self.finished.0.contains(&row) {
                self.finish_from(row)?;
            }
            let (finished, planes) = &self.finished;
            for (plane, numbers) in planes.iter().enumerate() {
                let start = (row - finished.start) as usize * self.width as usize;
                band.row_mut(plane, index).copy_from_slice(&numbers[start..start + self.width as usize]);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::stitch::TileRows;

    const WIDTH: u32 = 90;
    const HEIGHT: u32 = 230;

    fn planes() -> DenoisedPlanes {
        let image =
            json!({ "width": WIDTH, "height": HEIGHT, "format": "exr", "denoise": true, "layers": ["depth", "noisy"] });
        DenoisedPlanes::of(&serde_json::from_value(image).expect("an image")).expect("it is denoised")
    }

    /// Rendered pixels of a rectangle, with noise and without geometry.
    fn rendered(rect: Rect) -> TilePixels {
        let mut pixels = TilePixels::zeroed(rect, planes().rendered());
        let places = (rect.y..rect.y + rect.height).flat_map(|y| (rect.x..rect.x + rect.width).map(move |x| (x, y)));
        for (index, (x, y)) in places.enumerate() {
            let noise = (x * 7 + y * 13) % 11;
            for channel in 0..3 {
                pixels.planes[channel][index] = 1.0 + noise as f32 * 0.1 + y as f32 * 0.01;
            }
            pixels.planes[4][index] = y as f32;
            *pixels.planes.last_mut().and_then(|errors| errors.get_mut(index)).expect("a plane of errors") = 0.3;
        }
        pixels
    }

    /// All finished planes, from this many rows at once.
    fn finished(rows: Option<u32>) -> Vec<Vec<f32>> {
        let tiles = [
            rendered(Rect { x: 0, y: 0, width: WIDTH, height: 64 }),
            rendered(Rect { x: 0, y: 64, width: WIDTH, height: HEIGHT - 64 }),
        ];
        let mut tiles = TileRows(&tiles);
        let mut source = DenoisedRows::new(&mut tiles, planes(), WIDTH);
        source.rows = rows.unwrap_or(source.rows);
        let mut planes = vec![Vec::new(); 8];
        for start in (0..HEIGHT).step_by(16) {
            let end = HEIGHT.min(start + 16);
            let mut band = RowBand::new(WIDTH, 8);
            source.read(start..end, &mut band).expect("all rows are there");
            planes.iter_mut().zip(band.into_planes()).for_each(|(all, some)| all.extend(some));
        }
        planes
    }

    #[test]
    fn rows_and_tiles_are_the_same_however_many_are_finished_at_once() {
        let want = finished(None);
        assert!(want[0].iter().zip(&want[5]).all(|(denoised, noisy)| denoised != noisy), "it is denoised");
        assert_eq!(want[4][WIDTH as usize * 200], 200.0, "the depth is kept");
        for rows in [1, 7, 40] {
            assert_eq!(finished(Some(rows)), want, "{rows} rows at once");
        }
        let inner = Rect { x: 10, y: 96, width: 20, height: 32 };
        let around = Rect { x: 0, y: 24, width: WIDTH, height: 32 + 2 * 72 };
        let tile = planes().finished_tile(rendered(around), inner);
        for (plane, numbers) in tile.planes.iter().enumerate() {
            let rows =
                (inner.y..inner.y + inner.height).flat_map(|y| (inner.x..inner.x + inner.width).map(move |x| (x, y)));
            let wanted: Vec<f32> = rows.map(|(x, y)| want[plane][(y * WIDTH + x) as usize]).collect();
            assert_eq!(*numbers, wanted, "plane {plane}");
        }
    }
}
