//! Renders on an NVIDIA GPU: the picture's formulas as CUDA C, compiled at run time. The pixels are bit-identical to
//! every other renderer's.
//!
//! Only `cuda/device.rs`, `cuda/device/table.rs` and `cuda/compiler.rs` are unsafe; this module has no formula of a
//! picture.

mod active_blocks;
mod cache;
mod cells;
mod compiler;
mod device;
mod error;
mod launches;
mod paths;
mod render;
mod source;
mod tuning;

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use proto::Rect;

use crate::cells::{FastBuilder, KnownCells};
use crate::recent::{self, Recent};
use crate::renderer::{CancelFlag, RenderError, Renderer, TilePixels, TileRequest};
use crate::{CpuRenderer, Simd};
use cache::{Cache, CachedKernel};
use cells::Cells;
use device::{Buffer, Device, DivisionKernels, LoadedModule};
use launches::CostModel;

pub use cache::default_cache_folder;
pub use compiler::Compiler;
pub use device::{BLOCK_DIMS, BlockDim, Resources};
pub use error::CudaError;
pub use launches::KernelTimes;
pub use source::{DIVISION_POINT, KernelSource};

/// Maximum number of nodes whose formulas a kernel has, see [`scene::compiled_nodes`].
pub const MAX_NODES: u32 = proto::worker_protocol::CUDA_MAX_NODES;
/// Maximum memory of freed planes kept for reuse, in numbers.
const MAX_SPARE_FLOATS: usize = 128 << 20;
/// Renders in progress at a time: the source of one is recorded, one is in kernels, and the pixels of one are copied.
const OVERLAPPING: usize = 3;
/// Maximum number of kernels loaded on the GPU.
const MAX_PROGRAMS: usize = 64;
/// Scene of the self-test: shapes, seams, both ways of a mandelbulb, materials, and layers in direct light. The shipped
/// scenes of `sdfarm selftest` have every option.
const SELF_TEST: &str = include_str!("cuda/self_test.json");

/// Number of usable GPUs on this machine, or an error with the reason.
pub fn devices() -> Result<usize, RenderError> {
    match device::count() {
        Ok(0) => Err(unavailable("cuda", &CudaError::NoDevice)),
        Ok(count) => Ok(count),
        Err(error) => Err(unavailable("cuda", &error)),
    }
}

/// Renders on one GPU.
#[derive(Debug)]
pub struct CudaRenderer {
    name: String,
    device: Device,
    compiler: Compiler,
    cache: Cache,
    /// Block dimensions for all kernels, whose threads render a pixel each; `None` means the fastest for each.
    block: Option<BlockDim>,
    /// How many cells a frame may have.
    cell_builder: FastBuilder,
    programs: Mutex<HashMap<blake3::Hash, Arc<Kernel>>>,
    /// The compiler's logs about sources that it rejected.
    rejected: Recent<blake3::Hash, String>,
    /// Kernels that divide cells, by their texts.
    divisions: Mutex<HashMap<blake3::Hash, Arc<DivisionKernels>>>,
    sources: Recent<blake3::Hash, Vec<KernelSource>>,
    known_cells: KnownCells,
    /// Locked while a frame's launches are created, because they share the kernels' constants.
    launching: Mutex<()>,
    buffers: Mutex<Vec<Buffer>>,
    lost_reason: Mutex<Option<String>>,
    /// Planes that are no longer needed, to be reused.
    spare: Mutex<Vec<Vec<f32>>>,
    encoders: Option<usize>,
    kernels: Mutex<KernelTimes>,
    /// Time spent on preparing kernels.
    setup_time: Mutex<Duration>,
}

/// Kernel on the GPU, with what was measured of it.
#[derive(Debug)]
struct Kernel {
    loaded: LoadedModule,
    block: BlockDim,
    known: Mutex<KernelState>,
}

#[derive(Debug, Default)]
struct KernelState {
    cost: CostModel,
    /// Current uniforms of the kernel.
    parameters: Option<Vec<u32>>,
    /// Its current cells.
    cells: Option<Cells>,
}

/// Compiled kernel and its figures.
#[derive(Clone, Copy, Debug)]
pub struct CompileReport {
    /// Time to compile (or read) it, load it, and choose its block dimensions.
    pub time: Duration,
    /// Whether its machine code was cached.
    pub was_cached: bool,
    /// Block dimensions.
    pub block: BlockDim,
    /// Threads of a block for each pixel.
    pub threads_of_pixel: u32,
    /// Resources.
    pub resources: Resources,
}

impl CudaRenderer {
    /// Opens the GPU with this ordinal, and verifies that it renders the expected bits. Compiled kernels are
    /// stored in `cache`. Threads of blocks of these dimensions render a pixel each; `None` means the fastest layout.
    pub fn new(ordinal: usize, cache: Option<&Path>, block: Option<BlockDim>) -> Result<Self, RenderError> {
        let refused = |error: CudaError| unavailable(&format!("cuda:{ordinal}"), &error);
        let renderer = Self::open(ordinal, cache, block).map_err(refused)?;
        let (gpu, compiler) = (&renderer.device.name, &renderer.compiler.version);
        tracing::debug!(device = renderer.name, gpu, compiler, "found a GPU");
        renderer.self_test().map_err(refused)?;
        Ok(renderer)
    }

    /// Opens a GPU without a self-test.
    fn open(ordinal: usize, cache: Option<&Path>, block: Option<BlockDim>) -> Result<Self, CudaError> {
        Ok(Self {
            name: format!("cuda:{ordinal}"),
            device: Device::open(ordinal)?,
            compiler: Compiler::find()?,
            cache: Cache::new(cache),
            block,
            cell_builder: FastBuilder::UNLIMITED,
            programs: Mutex::default(),
            divisions: Mutex::default(),
            sources: Mutex::default(),
            known_cells: KnownCells::default(),
            launching: Mutex::default(),
            buffers: Mutex::default(),
            lost_reason: Mutex::default(),
            spare: Mutex::default(),
            encoders: None,
            kernels: Mutex::default(),
            rejected: Recent::default(),
            setup_time: Mutex::default(),
        })
    }

    /// Limits encoding to this many threads; `None` means all cores.
    pub fn with_encoders(self, encoders: Option<usize>) -> Self {
        Self { encoders, ..self }
    }

    /// Limits the cells of a frame to this many bytes, see [`CpuRenderer::with_cell_memory`].
    pub fn with_cell_memory(self, bytes: usize) -> Self {
        Self { cell_builder: FastBuilder::with_memory(bytes), ..self }
    }

    /// Product name of the GPU.
    pub fn gpu(&self) -> &str {
        &self.device.name
    }

    /// Maximum `f32` operations per second of the GPU; a fused operation counts as two.
    pub fn peak_flops(&self) -> f64 {
        let lanes = if matches!(self.device.architecture, 75 | 80) { 64.0 } else { 128.0 };
        2.0 * lanes * f64::from(self.device.multiprocessors) * f64::from(self.device.clock_khz) * 1e3
    }

    /// Time of kernels since the last call of this method.
    pub fn take_kernel_times(&self) -> KernelTimes {
        std::mem::take(&mut *lock(&self.kernels))
    }

    /// Prepares the kernel of a tile, and reports the time that took.
    pub fn compile(&self, run: &TileRequest<'_>) -> Result<CompileReport, RenderError> {
        let cancel = CancelFlag::new();
        let sources = self.sources(run, &cancel).map_err(|error| self.render_error(&error))?;
        let source = &sources[0];
        let start = Instant::now();
        let (program, was_kept) = self.program(source, run, &cancel).map_err(|error| self.render_error(&error))?;
        let time = start.elapsed();
        let resources =
            self.device.resources(&program.loaded, program.block).map_err(|error| self.render_error(&error))?;
        let (block, threads_of_pixel) = (program.block, source.together);
        Ok(CompileReport { time, was_cached: was_kept, block, threads_of_pixel, resources })
    }

    /// Unloads the kernels from the GPU; those on disk remain.
    pub fn clear_kernels(&self) {
        lock(&self.programs).clear();
        lock(&self.divisions).clear();
    }

    /// Renders the self-test and compares it with the CPU's.
    fn self_test(&self) -> Result<(), CudaError> {
        let job = scene::parse(SELF_TEST.as_bytes()).expect("the self-test is a job");
        let run =
            TileRequest { job: &job, frame: 0, rect: Rect::full(job.image.film().width, job.image.film().height) };
        let mut got = Vec::new();
        self.render_groups(&[run], &CancelFlag::new(), &|_| {}, &mut || {}, &mut got)?;
        let cpu = CpuRenderer::new(None, Simd::Auto).and_then(|cpu| cpu.render(&run, &CancelFlag::new(), &|_| {}));
        let Ok(want) = cpu else { return Err(CudaError::Cancelled) };
        let bits =
            |pixels: &TilePixels| pixels.planes.iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>();
        let (got, want) = (bits(&got[0]), bits(&want));
        let differing = got.iter().zip(&want).filter(|(got, want)| got != want).count();
        if differing == 0 { Ok(()) } else { Err(CudaError::SelfTestFailed { differing, values: want.len() }) }
    }

    /// Kernel of a source, compiled if necessary; also returns whether it came from the cache.
    fn program(
        &self,
        source: &KernelSource,
        sample: &TileRequest<'_>,
        cancel: &CancelFlag,
    ) -> Result<(Arc<Kernel>, bool), CudaError> {
        let key = Cache::entry_name(&source.text, &compiler::options(self.device.architecture), &self.compiler.version);
        if let Some(program) = lock(&self.programs).get(&key) {
            return Ok((program.clone(), true));
        }
        let start = Instant::now();
        let division = source.division.as_ref().map(|text| self.division_kernels(text, cancel)).transpose()?;
        // A cached kernel that cannot be loaded, for example by another driver, is compiled again.
        let has_layers = sample.job.image.film().has_layers();
        let load = |code: &[u8]| self.device.load(code, source.together, has_layers, division.as_ref());
        let kept = self.cache.get(key).and_then(|kept| Some((load(&kept.code).ok()?, kept.block)));
        let was_kept = kept.is_some();
        let (loaded, block) = if let Some(kept) = kept {
            kept
        } else {
            let code = self.compile_text(key, &source.text, cancel)?;
            let loaded = load(&code)?;
            let block = self.tune_block_dim(&loaded, source, sample, cancel)?;
            self.cache.put(key, &CachedKernel { code, block });
            (loaded, block)
        };
        let program = Arc::new(Kernel { loaded, block: self.block.unwrap_or(block), known: Mutex::default() });
        let mut programs = lock(&self.programs);
        if programs.len() >= MAX_PROGRAMS {
            programs.clear();
        }
        programs.insert(key, program.clone());
        *lock(&self.setup_time) += start.elapsed();
        Ok((program, was_kept))
    }

    /// Kernels that divide cells, compiled if necessary. They are the same for most scenes.
    fn division_kernels(&self, text: &str, cancel: &CancelFlag) -> Result<Arc<DivisionKernels>, CudaError> {
        let key = Cache::entry_name(text, &compiler::options(self.device.architecture), &self.compiler.version);
        let mut known = lock(&self.divisions);
        if let Some(kernels) = known.get(&key) {
            return Ok(kernels.clone());
        }
        let kept = self.cache.get(key).and_then(|kept| self.device.load_division(&kept.code).ok());
        let kernels = if let Some(kept) = kept {
            kept
        } else {
            let code = self.compile_text(key, text, cancel)?;
            let kernels = self.device.load_division(&code)?;
            self.cache.put(key, &CachedKernel { code, block: BLOCK_DIMS[0] });
            kernels
        };
        let kernels = Arc::new(kernels);
        known.insert(key, kernels.clone());
        Ok(kernels)
    }

    /// Compiles a source, unless the compiler has rejected it before.
    fn compile_text(&self, key: blake3::Hash, text: &str, cancel: &CancelFlag) -> Result<Vec<u8>, CudaError> {
        /// Rejected sources whose reasons are known.
        const MAX_REJECTED: usize = 64;
        if let Some(log) = recent::find(&self.rejected, |other| *other == key) {
            return Err(CudaError::Compile { log: log.to_string() });
        }
        let compiled = compiler::compile_until_cancelled(&self.compiler, text, self.device.architecture, cancel);
        if let Err(CudaError::Compile { log }) = &compiled {
            let file = self.cache.put_rejected(text, log).map(|path| path.display().to_string());
            tracing::warn!(file, "the compiler rejected a kernel's source");
            // Without an error in the source, the next attempt may succeed.
            if log.contains("error") {
                recent::insert(&self.rejected, key, Arc::new(log.clone()), MAX_REJECTED);
            }
        }
        compiled
    }

    /// Kernel sources of a frame, one for each of its instants, with its cells; the last frames' are kept.
    fn sources(&self, run: &TileRequest<'_>, cancel: &CancelFlag) -> Result<Arc<Vec<KernelSource>>, CudaError> {
        /// Frames whose tiles may arrive in turns.
        const MAX_SOURCES: usize = 4;
        let exposure = run.job.exposure(run.frame)?;
        let key = exposure.pixels_cache_key();
        if let Some(known) = recent::find(&self.sources, |other| *other == key) {
            return Ok(known);
        }
        let nodes = scene::frame_compiled_nodes(exposure.last());
        if nodes > MAX_NODES {
            return Err(CudaError::TooLarge { nodes, most: MAX_NODES });
        }
        let sources = || KernelSource::of_exposure(&exposure, self.block.map(|_| 1), self.cell_builder);
        let mut sources = cancel.ends(sources).map_err(|_| CudaError::Cancelled)??;
        for (source, at_frame) in sources.iter_mut().zip(&exposure.instants) {
            source.table = source.table.take().map(|table| self.known_cells.share(at_frame, &table));
        }
        Ok(recent::insert(&self.sources, key, Arc::new(sources), MAX_SOURCES))
    }

    /// Records a lost GPU; returns the CUDA error as a render error.
    fn render_error(&self, error: &CudaError) -> RenderError {
        if error.is_lost() {
            *lock(&self.lost_reason) = Some(format!("{}: {error}", self.name));
        }
        match error {
            CudaError::Cancelled => RenderError::Cancelled,
            CudaError::InvalidFrame(refusal) => RenderError::InvalidFrame(refusal.clone()),
            CudaError::InvalidTape(refusal) => RenderError::InvalidTape(*refusal),
            _ => RenderError::Device { device: self.name.clone(), reason: error.to_string() },
        }
    }
}

impl Renderer for CudaRenderer {
    fn device(&self) -> String {
        self.name.clone()
    }

    fn render(
        &self,
        run: &TileRequest<'_>,
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<TilePixels, RenderError> {
        let mut finished = self.render_tiles(std::slice::from_ref(run), cancel, progress)?;
        Ok(finished.pop().expect("a render returns every requested tile"))
    }

    fn render_tiles(
        &self,
        runs: &[TileRequest<'_>],
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<TilePixels>, RenderError> {
        self.render_overlapped(runs, cancel, progress, &mut || {})
    }

    fn render_overlapped(
        &self,
        runs: &[TileRequest<'_>],
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
        on_device_free: &mut dyn FnMut(),
    ) -> Result<Vec<TilePixels>, RenderError> {
        let mut finished = Vec::with_capacity(runs.len());
        let rendered = self.render_groups(runs, cancel, progress, on_device_free, &mut finished);
        rendered.map(|()| finished).map_err(|error| self.render_error(&error))
    }

    fn prepare(&self, run: &TileRequest<'_>, cancel: &CancelFlag) -> Result<(), RenderError> {
        self.sources(run, cancel).map(drop).map_err(|error| self.render_error(&error))
    }

    fn overlapping(&self) -> usize {
        OVERLAPPING
    }

    fn take_setup_time(&self) -> Duration {
        std::mem::take(&mut *lock(&self.setup_time))
    }

    fn preferred_tiles(&self) -> usize {
        1024
    }

    fn beside(&self) -> Result<Option<Arc<dyn Renderer>>, RenderError> {
        // Its launches are in a stream of their own, and its kernels have constants of their own.
        let other = Self::open(self.device.ordinal(), self.cache.folder(), self.block);
        let other = other.map_err(|error| self.render_error(&error))?;
        Ok(Some(Arc::new(Self { cell_builder: self.cell_builder, encoders: self.encoders, ..other })))
    }

    fn encoder_threads(&self) -> usize {
        // Some cores remain for the server, and for the threads that launch kernels and fetch pixels.
        let all = || std::thread::available_parallelism().map_or(1, usize::from);
        self.encoders.unwrap_or_else(|| (all() - all() / 8).max(1))
    }

    fn recycle(&self, pixels: Vec<TilePixels>) {
        let mut spare = lock(&self.spare);
        let mut numbers: usize = spare.iter().map(Vec::capacity).sum();
        for plane in pixels.into_iter().flat_map(|pixels| pixels.planes) {
            numbers += plane.capacity();
            if numbers > MAX_SPARE_FLOATS {
                break;
            }
            spare.push(plane);
        }
    }

    fn max_nodes(&self) -> Option<u32> {
        Some(MAX_NODES)
    }

    fn lost_reason(&self) -> Option<String> {
        lock(&self.lost_reason).clone()
    }
}

fn unavailable(wanted: &str, error: &CudaError) -> RenderError {
    RenderError::Unavailable { requested: format!("--device {wanted}"), reason: error.to_string() }
}

/// Locks a mutex; poisoning is ignored because a panic elsewhere leaves no partial state here.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
