//! Preview of an unfinished frame: its finished tiles over a coarse pass.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use scene::Job;
use scene::film::DisplayTransform;
use worker::blob::{self, BlobError, BlobReader};

use crate::canvas::{Canvas, shown};
use crate::coarse::{self, CoarseCache};

/// Draws the preview as a PNG of at most this width. Tiles that cannot be read, or do not belong to the frame, are
/// skipped.
pub(super) fn draw(
    job: &Job,
    frame: u32,
    width_px: u32,
    tiles: &[PathBuf],
    below: &CoarseCache<'_>,
) -> anyhow::Result<Vec<u8>> {
    let at_frame = job.at(frame)?;
    let (grade, opaque) = (DisplayTransform::new(at_frame.image()), !at_frame.scene().is_transparent());
    let film = at_frame.image().film();
    let mut canvas = Canvas::new(film.width, film.height, width_px);
    for tile in tiles {
        // The blob was deleted meanwhile or is damaged: the coarse pass is shown there.
        drop(add(&mut canvas, tile, grade, opaque));
    }
    let coarse = below.pixels(job, frame)?;
    let below = coarse.and_then(|coarse| coarse::scaled(&coarse, grade, opaque, canvas.size()));
    canvas.png(below.as_ref())
}

fn add(canvas: &mut Canvas, tile: &Path, grade: DisplayTransform, opaque: bool) -> Result<(), BlobError> {
    let mut reader = BlobReader::open_at(BufReader::new(File::open(tile)?), 0)?;
    let rect = reader.rect();
    if reader.planes() < 4 {
        return Ok(());
    }
    let mut bytes = Vec::new();
    let mut planes: [Vec<f32>; 4] = Default::default();
    for (number, plane) in planes.iter_mut().enumerate() {
        reader.read_rows(number, 0..rect.height, &mut bytes)?;
        plane.resize(bytes.len() / size_of::<f32>(), 0.0);
        blob::floats_from_bytes(&bytes, plane);
    }
    let width = rect.width as usize;
    for row in 0..rect.height {
        let start = row as usize * width;
        let pixels = (start..start + width).map(|at| shown(std::array::from_fn(|n| planes[n][at]), grade, opaque));
        canvas.add(rect.x, rect.y.saturating_add(row), pixels);
    }
    Ok(())
}
