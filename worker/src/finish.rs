//! Finishes pictures: reweights fireflies, and denoises, which needs the pixels around each pixel.

use std::ops::Range;

use proto::Rect;
use scene::film::BRIGHTNESS_LEVELS;
use scene::film::GUIDE_CHANNELS;
use scene::{ImageSpec, Layer};

use crate::renderer::TilePixels;
use crate::stitch::{RowBand, RowSource, StitchError};
use crate::{denoise, fireflies};

/// Numbers of a region that is finished at once, of all planes, if its rows are not too long.
const REGION_NUMBERS: usize = 48 << 20;

/// How a picture is finished, and where its planes are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Finish {
    /// Number of planes of a rendered picture.
    rendered: usize,
    /// The first plane of light by its brightness, if fireflies are reweighted; a finished picture's planes follow.
    levels: Option<usize>,
    is_denoised: bool,
    /// The first plane of the colors as sampled, if they are kept.
    noisy: Option<usize>,
}

impl Finish {
    /// How a picture is finished; `None` if it is as rendered.
    pub(crate) fn of(image: &ImageSpec) -> Option<Self> {
        let film = image.film();
        let noisy = film.channels().iter().position(|channel| channel == Layer::Noisy.channels()[0]);
        (image.is_denoised() || image.is_reweighted()).then(|| Self {
            rendered: film.rendered_channels().len(),
            levels: image.is_reweighted().then_some(film.light_channels()),
            is_denoised: image.is_denoised(),
            noisy,
        })
    }

    /// Distance to the farthest pixel that a finished pixel depends on, in pixels.
    pub(crate) fn margin_px(self) -> u32 {
        let reweighted = if self.levels.is_some() { fireflies::MARGIN_PX } else { 0 };
        reweighted + if self.is_denoised { denoise::MARGIN_PX } else { 0 }
    }

    /// The finished planes of a rectangle of rendered pixels.
    fn finish(self, width: usize, height: usize, mut planes: Vec<Vec<f32>>) -> Vec<Vec<f32>> {
        let guides = self.is_denoised.then(|| planes.split_off(self.rendered - GUIDE_CHANNELS.len()));
        let sampled: [Vec<f32>; 3] = std::array::from_fn(|channel| std::mem::take(&mut planes[channel]));
        let reweighted = self.levels.map(|levels| {
            let counts = planes.pop().expect("a picture to reweight has the numbers of samples");
            let levels: Vec<Vec<f32>> = planes.drain(levels..levels + 3 * BRIGHTNESS_LEVELS).collect();
            fireflies::Region { width, color: &sampled, levels: &levels, counts: &counts }.reweighted()
        });
        let error = reweighted.as_ref().map(|reweighted| error_shares(&sampled, reweighted));
        let mut color = reweighted.unwrap_or_else(|| sampled.clone());
        if let Some(guides) = guides {
            let [red, green, blue, x, y, z, inverse_depth, mut errors] =
                <[Vec<f32>; GUIDE_CHANNELS.len()]>::try_from(guides).expect("a rendered picture has all guides");
            if let Some(shares) = error {
                errors.iter_mut().zip(shares).for_each(|(error, share)| *error *= share);
            }
            let (albedo, normal) = ([red, green, blue], [x, y, z]);
            color = denoise::Region { width, height, color, albedo, normal, inverse_depth, error: errors }.denoised();
        }
        if let Some(noisy) = self.noisy {
            planes.splice(noisy..noisy + 3, sampled);
        }
        for (plane, color) in planes.iter_mut().zip(color) {
            // A file must not distinguish zeros by their sign.
            *plane = color.into_iter().map(|value| value + 0.0).collect();
        }
        planes
    }

    /// The finished pixels of `inner`, from rendered ones that reach [`Self::margin_px`] farther, or to the edge of the
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

/// Share of each pixel's noise that is left: that of its light.
fn error_shares(sampled: &[Vec<f32>; 3], reweighted: &[Vec<f32>; 3]) -> Vec<f32> {
    let sum = |color: &[Vec<f32>; 3], pixel: usize| color[0][pixel] + color[1][pixel] + color[2][pixel];
    let share = |pixel: usize| {
        let before = sum(sampled, pixel);
        if before > 0.0 { (sum(reweighted, pixel) / before).min(1.0) } else { 1.0 }
    };
    (0..sampled[0].len()).map(share).collect()
}

/// Finishes the rows of a picture.
pub(crate) struct FinishedRows<'a> {
    source: &'a mut dyn RowSource,
    finish: Finish,
    width: u32,
    height: u32,
    /// Rows that are finished at once.
    rows: u32,
    /// Rows that are finished, with their planes.
    finished: (Range<u32>, Vec<Vec<f32>>),
}

impl<'a> FinishedRows<'a> {
    /// The rows of a picture of this size.
    pub(crate) fn new(source: &'a mut dyn RowSource, finish: Finish, [width, height]: [u32; 2]) -> Self {
        let fitting = REGION_NUMBERS / (width as usize * finish.rendered);
        let (fitting, margin) = (u32::try_from(fitting).unwrap_or(u32::MAX), finish.margin_px());
        let rows = fitting.saturating_sub(2 * margin).max(2 * margin);
        Self { source, finish, width, height, rows, finished: (0..0, Vec::new()) }
    }

    /// Finishes rows from `start` on.
    fn finish_from(&mut self, start: u32) -> Result<(), StitchError> {
        let (height, margin) = (self.height, self.finish.margin_px());
        let end = start.saturating_add(self.rows).min(height);
        let rows = start.saturating_sub(margin)..end.saturating_add(margin).min(height);
        let mut band = RowBand::new(self.width, self.finish.rendered);
        self.source.read(rows.clone(), &mut band)?;
        let width = self.width as usize;
        let mut planes = self.finish.finish(width, rows.len(), band.into_planes());
        for plane in &mut planes {
            plane.truncate((end - rows.start) as usize * width);
            plane.drain(..(start - rows.start) as usize * width);
        }
        self.finished = (start..end, planes);
        Ok(())
    }
}

impl RowSource for FinishedRows<'_> {
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

    fn denoised() -> Finish {
        let image =
            json!({ "width": WIDTH, "height": HEIGHT, "format": "exr", "denoise": true, "layers": ["depth", "noisy"] });
        Finish::of(&serde_json::from_value(image).expect("an image")).expect("it is denoised")
    }

    /// Rendered pixels of a rectangle, with noise and without geometry.
    fn rendered(rect: Rect) -> TilePixels {
        let mut pixels = TilePixels::zeroed(rect, denoised().rendered);
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
        let mut source = FinishedRows::new(&mut tiles, denoised(), [WIDTH, HEIGHT]);
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
        let tile = denoised().finished_tile(rendered(around), inner);
        for (plane, numbers) in tile.planes.iter().enumerate() {
            let rows =
                (inner.y..inner.y + inner.height).flat_map(|y| (inner.x..inner.x + inner.width).map(move |x| (x, y)));
            let wanted: Vec<f32> = rows.map(|(x, y)| want[plane][(y * WIDTH + x) as usize]).collect();
            assert_eq!(*numbers, wanted, "plane {plane}");
        }
    }
}
