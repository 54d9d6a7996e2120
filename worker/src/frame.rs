//! Renders one frame to a file in this process: no server, no leases.
//!
//! The bytes are those that every farm produces.

use std::fs::File;
use std::io::{self, BufWriter, Seek, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use proto::Rect;
use proto::tile::Tiling;
use scene::Job;

use crate::blob;
use crate::image::{Encoders, ImageError, PictureSpec};
use crate::renderer::{CancelFlag, RenderError, Renderer, TilePixels, TileRequest, chunk_length};
use crate::stitch::{BlobRows, RowSource, TileRows};

/// Pixel data above this size passes through a file.
const MEMORY_BYTES: u64 = 256 << 20;

/// Durations of a frame's phases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameTimes {
    /// Rendering its tiles.
    pub render: Duration,
    /// Stitching, encoding and writing.
    pub encode: Duration,
}

/// Renders a frame and writes its picture in the job's format. Tiles are cut as a server would cut them, or
/// `tile_px` wide; a frame too large for memory passes through an unnamed file in `scratch`. `progress`
/// receives the number of newly finished rays.
#[expect(clippy::too_many_arguments, reason = "job, output and progress; called in one place")]
pub fn render_frame(
    renderer: &dyn Renderer,
    job: &Job,
    frame: u32,
    tile_px: Option<u32>,
    scratch: &Path,
    out: &mut (impl Write + Seek + Send),
    cancel: &CancelFlag,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<FrameTimes, RenderFrameError> {
    let start = Instant::now();
    let mut source =
        if frame_bytes(job) <= MEMORY_BYTES { TileBuffer::Memory(Vec::new()) } else { scratch_file(scratch)? };
    let rects = tiles(job, tile_px);
    for chunk in rects.chunks(chunk_length(renderer, job, rects.iter().copied())) {
        let runs: Vec<TileRequest<'_>> = chunk.iter().map(|&rect| TileRequest { job, frame, rect }).collect();
        for pixels in renderer.render_tiles(&runs, cancel, progress)? {
            source.push(pixels).map_err(RenderFrameError::Scratch)?;
        }
    }
    let render = start.elapsed();
    let start = Instant::now();
    let encoders = Encoders::new(renderer.encoder_threads()).map_err(RenderError::Threads)?;
    let picture = PictureSpec::new(&job.at(frame).map_err(ImageError::from)?);
    let mut encode =
        |source: &mut (dyn RowSource + Send)| encoders.run(|threads| picture.write_on(threads, source, out, cancel));
    match source {
        TileBuffer::Memory(tiles) => encode(&mut TileRows(&tiles))?,
        TileBuffer::File(file, places) => {
            let file = file.into_inner().map_err(|error| RenderFrameError::Scratch(error.into_error()))?;
            encode(&mut BlobRows::new(file, places))?;
        }
    }
    Ok(FrameTimes { render, encode: start.elapsed() })
}

/// Tiles of a frame.
fn tiles(job: &Job, edge: Option<u32>) -> Vec<Rect> {
    let film = job.image.film();
    let (width, height, samples) = (film.width, film.height, job.image.samples.max());
    Tiling { width, height, samples, pixel_bytes: film.pixel_bytes(), tile_edge: edge }.tiles()
}

fn frame_bytes(job: &Job) -> u64 {
    let film = job.image.film();
    film.pixels() * u64::from(film.pixel_bytes())
}

enum TileBuffer {
    Memory(Vec<TilePixels>),
    File(BufWriter<File>, Vec<(Rect, u64)>),
}

fn scratch_file(scratch: &Path) -> Result<TileBuffer, RenderFrameError> {
    let file = tempfile::tempfile_in(scratch).map_err(RenderFrameError::Scratch)?;
    Ok(TileBuffer::File(BufWriter::with_capacity(1 << 20, file), Vec::new()))
}

impl TileBuffer {
    fn push(&mut self, pixels: TilePixels) -> io::Result<()> {
        match self {
            Self::Memory(tiles) => tiles.push(pixels),
            Self::File(file, places) => {
                let end = places.last().map_or(0, |&(rect, start)| start + blob::size_bytes(rect, pixels.planes.len()));
                blob::write(&pixels, file)?;
                places.push((pixels.rect, end));
            }
        }
        Ok(())
    }
}

/// Error when rendering a frame to a file.
#[derive(Debug, thiserror::Error)]
pub enum RenderFrameError {
    /// A tile could not be rendered.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The picture could not be written.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The scratch folder could not be used.
    #[error("could not write to the scratch folder")]
    Scratch(#[source] io::Error),
}

impl RenderFrameError {
    /// Whether the error is a cancel.
    pub fn is_cancelled(&self) -> bool {
        matches!(self, Self::Render(RenderError::Cancelled) | Self::Image(ImageError::Cancelled))
    }
}
