//! Interface of all renderers: tiles in, pixels out.
//!
//! Nothing here renders, and nothing here knows of leases, servers or files.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use proto::Rect;
use scene::real::Words;
use scene::visits::Visited;

use tape::{EvaluatorError, InvalidTape, Unavailable, interrupt};

/// Renders tiles on one device. Each render has exclusive use of it until it ends, or calls `on_device_free`; only the
/// renders of [`Renderer::beside`] share it.
///
/// The pixels depend only on the tiles requested: all renderers are bit-identical.
pub trait Renderer: Send + Sync {
    /// Device: `cpu` or `cuda:0`.
    fn device(&self) -> String;

    /// Renders one tile. `progress` receives the number of newly finished rays, from any thread; a CPU says first that
    /// there are none, when the scene is prepared. `cancel` takes effect within 50 ms.
    fn render(
        &self,
        run: &TileRequest<'_>,
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<TilePixels, RenderError>;

    /// Renders tiles of one job and frame, in the given order. Returns all of them or an error.
    fn render_tiles(
        &self,
        runs: &[TileRequest<'_>],
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<TilePixels>, RenderError> {
        runs.iter().map(|run| self.render(run, cancel, progress)).collect()
    }

    /// Renders tiles like [`Self::render_tiles`]. Calls `on_device_free`, if at all, once another render may start on
    /// the device while this one fetches its pixels.
    fn render_overlapped(
        &self,
        runs: &[TileRequest<'_>],
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
        on_device_free: &mut dyn FnMut(),
    ) -> Result<Vec<TilePixels>, RenderError> {
        let _ = on_device_free;
        self.render_tiles(runs, cancel, progress)
    }

    /// Whether [`Self::render_recorded`] records anything.
    fn can_record(&self) -> bool {
        false
    }

    /// Renders one tile, and records what its rays ask for; without a record if that is not known.
    fn render_recorded(
        &self,
        run: &TileRequest<'_>,
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<(TilePixels, Option<Visited>), RenderError> {
        Ok((self.render(run, cancel, progress)?, None))
    }

    /// Prepares the frame of a tile without the device, while that renders another frame.
    fn prepare(&self, run: &TileRequest<'_>, cancel: &CancelFlag) -> Result<(), RenderError> {
        let _ = (run, cancel);
        Ok(())
    }

    /// Number of renders whose stages may overlap, at least 1; only one of them renders at a time.
    fn overlapping(&self) -> usize {
        1
    }

    /// Returns and resets the time spent preparing scenes, which does not count toward the rendering
    /// speed.
    fn take_setup_time(&self) -> Duration {
        Duration::ZERO
    }

    /// Preferred number of tiles per call, at least 1.
    fn preferred_tiles(&self) -> usize {
        1
    }

    /// Another renderer on the device, whose renders run at the same time as this one's and share its power; `None` if the
    /// device has none.
    fn beside(&self) -> Result<Option<Arc<dyn Renderer>>, RenderError> {
        Ok(None)
    }

    /// Number of threads that may encode, at least 1.
    fn encoder_threads(&self) -> usize {
        std::thread::available_parallelism().map_or(1, usize::from)
    }

    /// Accepts pixels that are no longer needed, so that their memory can be reused.
    fn recycle(&self, pixels: Vec<TilePixels>) {
        drop(pixels);
    }

    /// Largest scene that it can render, in nodes; `None` for any.
    fn max_nodes(&self) -> Option<u32> {
        None
    }

    /// Reason why its device is lost; `Some` is final.
    fn lost_reason(&self) -> Option<String> {
        None
    }
}

/// Maximum memory of tiles that are rendered together, unless there is only one.
const CHUNK_BYTES: u64 = 256 << 20;

/// Number of these tiles per call: the renderer's preference, limited by memory.
pub(crate) fn chunk_length(renderer: &dyn Renderer, job: &scene::Job, rects: impl Iterator<Item = Rect>) -> usize {
    let largest_bytes = rects.map(Rect::pixels).max().unwrap_or(1) * u64::from(job.image.film().pixel_bytes());
    let fitting = usize::try_from(CHUNK_BYTES / largest_bytes.max(1)).unwrap_or(usize::MAX);
    renderer.preferred_tiles().min(fitting).max(1)
}

/// A tile to render.
#[derive(Clone, Copy, Debug)]
pub struct TileRequest<'a> {
    /// The job it belongs to.
    pub job: &'a scene::Job,
    /// The frame, from 0.
    pub frame: u32,
    /// The tile's pixels. Blocks of adaptive samples begin at its corner, so that is at multiples of
    /// [`scene::sample_count::BLOCK_PX`] in a picture.
    pub rect: Rect,
}

/// A rectangle of finished pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct TilePixels {
    /// Position in the picture.
    pub rect: Rect,
    /// One plane for each of [`scene::Film::channels`], row by row from the top.
    /// R, G and B are scene-linear and premultiplied by A.
    pub planes: Vec<Vec<f32>>,
}

impl TilePixels {
    /// This many planes, all 0.
    pub fn zeroed(rect: Rect, planes: usize) -> Self {
        let length = usize::try_from(rect.pixels()).expect("limits keep a tile's pixels countable");
        Self { rect, planes: vec![vec![0.0; length]; planes] }
    }
}

/// Flag that cancels a render; clones share it.
#[derive(Clone, Debug, Default)]
pub struct CancelFlag(Arc<AtomicBool>);

impl CancelFlag {
    /// A flag that is not set.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets the flag permanently.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// The flag itself.
    pub(crate) fn flag(&self) -> &AtomicBool {
        &self.0
    }

    /// Whether the flag is set.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Records or compiles formulas on this thread, until it is done or the flag is set.
    pub(crate) fn ends<T>(&self, work: impl FnOnce() -> T) -> Result<T, RenderError> {
        interrupt::until_set(&self.0, work).map_err(|interrupt::Interrupted| RenderError::Cancelled)
    }
}

/// Error of a render.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The render was cancelled.
    #[error("the render was cancelled")]
    Cancelled,
    /// This machine lacks the requested feature.
    #[error("this machine cannot render with {requested}: {reason}")]
    Unavailable {
        /// Requested SIMD level or device.
        requested: String,
        /// Missing feature, and the fix.
        reason: String,
    },
    /// The threads to render on could not be started.
    #[error("could not start the rendering threads")]
    Threads(#[source] rayon::ThreadPoolBuildError),
    /// The job is invalid at this frame.
    #[error("the job is invalid in this frame")]
    InvalidFrame(#[from] scene::FrameError),
    /// The formulas were recorded wrongly.
    #[error("the recorded formulas are invalid, which is a fault of sdfarm")]
    InvalidTape(#[from] InvalidTape),
    /// The cells of the scene need more memory than they may have.
    #[error(
        "the cells that a few rows of pixels need do not fit into {:.1} MB: allow more (--cell-memory), or use fewer \
         shapes, or shapes that overlap less",
        *bytes as f64 / 1e6
    )]
    ManyCells {
        /// Memory that they may have, in bytes.
        bytes: usize,
    },
    /// The device failed.
    #[error("{device} could not render: {reason}")]
    Device {
        /// Name of the device.
        device: String,
        /// Message.
        reason: String,
    },
}

impl From<Unavailable> for RenderError {
    fn from(Unavailable { simd, reason }: Unavailable) -> Self {
        Self::Unavailable { requested: format!("--simd {simd}"), reason }
    }
}

impl From<EvaluatorError> for RenderError {
    fn from(error: EvaluatorError) -> Self {
        match error {
            EvaluatorError::Unavailable(unavailable) => unavailable.into(),
            EvaluatorError::InvalidTape(invalid) => Self::InvalidTape(invalid),
        }
    }
}

impl RenderError {
    /// The cells of this table need more memory.
    pub(crate) fn many_cells(table: &Words) -> Self {
        Self::ManyCells { bytes: table.capacity() * size_of::<u32>() }
    }
}
