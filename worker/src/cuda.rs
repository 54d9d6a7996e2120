//! Renders on an NVIDIA GPU: the picture's formulas as CUDA C, compiled at run time, run a thread
//! a pixel. The pixels are those of every other renderer, to the bit.
//!
//! Only `cuda/device.rs` and `cuda/compiler.rs` are unsafe; no formula of a picture is written here.

mod cache;
mod compiler;
mod device;
mod error;
mod launches;
mod source;

use std::collections::{HashMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use proto::Rect;
use rayon::prelude::*;
use scene::Image;

use crate::renderer::{Cancel, Pixels, RenderError, Renderer, TileRun};
use crate::{CpuRenderer, Simd};
use cache::{Cache, Kept};
use device::{Buffer, Device, Launched, Loaded};
use launches::{Cost, Launches};

pub use compiler::Compiler;
pub use device::{Resources, Shape};
pub use error::Trouble;
pub use launches::KernelTimes;
pub use source::Source;

/// Maximum size of a scene compiled to straight-line code, in nodes.
pub const MAX_NODES: u32 = 500;
/// Shapes of blocks that are tried for each program.
pub const SHAPES: [Shape; 5] = [
    Shape { columns: 8, rows: 8 },
    Shape { columns: 16, rows: 8 },
    Shape { columns: 16, rows: 16 },
    Shape { columns: 32, rows: 8 },
    Shape { columns: 128, rows: 1 },
];
/// Pixels that are on the GPU and on their way back at a time, in numbers.
const BUFFER_NUMBERS: usize = 64 << 20;
/// Maximum memory of freed planes kept for reuse, in numbers.
const MAX_SPARE_NUMBERS: usize = 128 << 20;
/// Maximum number of kernels loaded on the GPU.
const MAX_PROGRAMS: usize = 64;
/// Scene of the self-test, with a sample of every feature.
const SELF_TEST: &str = include_str!("cuda/self_test.json");

/// Number of usable GPUs on this machine; an error with the reason if there is none.
pub fn devices() -> Result<usize, RenderError> {
    match device::count() {
        Ok(0) => Err(unavailable("cuda", &Trouble::NoDevice)),
        Ok(count) => Ok(count),
        Err(trouble) => Err(unavailable("cuda", &trouble)),
    }
}

/// Default folder of the kernel cache: the user's cache folder.
pub fn default_cache_folder() -> Option<PathBuf> {
    let absolute = |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let cache = absolute("XDG_CACHE_HOME").or_else(|| absolute("HOME").map(|home| home.join(".cache")))?;
    Some(cache.join("sdfarm").join("kernels"))
}

/// Renders on one GPU.
#[derive(Debug)]
pub struct CudaRenderer {
    name: String,
    device: Device,
    compiler: Compiler,
    cache: Cache,
    /// One shape for all programs, instead of the fastest for each.
    shape: Option<Shape>,
    programs: Mutex<HashMap<blake3::Hash, Arc<Program>>>,
    /// Held while a frame's launches are made, because they share the kernels' constants.
    launching: Mutex<()>,
    buffers: Mutex<Vec<Buffer>>,
    lost: Mutex<Option<String>>,
    /// Memory of pixels that are not needed any more.
    spare: Mutex<Vec<Vec<f32>>>,
    encoders: Option<usize>,
    kernels: Mutex<KernelTimes>,
    /// Time that went into making programs.
    setup_time: Mutex<Duration>,
}

/// A program on the GPU, and what is known of it.
#[derive(Debug)]
struct Program {
    loaded: Loaded,
    shape: Shape,
    known: Mutex<Known>,
}

#[derive(Debug, Default)]
struct Known {
    cost: Cost,
    /// The numbers that the program now has.
    numbers: Option<Vec<u32>>,
}

/// Tiles whose pixels are on their way.
struct Underway {
    rects: Vec<Rect>,
    buffer: Buffer,
}

/// Compiled kernel and its figures.
#[derive(Clone, Copy, Debug)]
pub struct Compiled {
    /// Compiling (or reading) it, loading it, and finding its shape of blocks.
    pub time: Duration,
    /// Whether its machine code was there already.
    pub was_kept: bool,
    /// The shape of its blocks.
    pub shape: Shape,
    /// Resources.
    pub resources: Resources,
}

impl CudaRenderer {
    /// Opens the GPU of this number, and verifies that it renders the expected bits. Compiled kernels are
    /// stored in `cache`; blocks have `shape`, or the fastest one.
    pub fn new(ordinal: usize, cache: Option<&Path>, shape: Option<Shape>) -> Result<Self, RenderError> {
        let name = format!("cuda:{ordinal}");
        let refused = |trouble: Trouble| unavailable(&name, &trouble);
        let device = Device::open(ordinal).map_err(refused)?;
        let compiler = Compiler::find().map_err(refused)?;
        tracing::debug!(device = name, gpu = device.name, compiler = compiler.version, "found a GPU");
        let renderer = Self {
            name: name.clone(),
            device,
            compiler,
            cache: Cache::new(cache),
            shape,
            programs: Mutex::default(),
            launching: Mutex::default(),
            buffers: Mutex::default(),
            lost: Mutex::default(),
            spare: Mutex::default(),
            encoders: None,
            kernels: Mutex::default(),
            setup_time: Mutex::default(),
        };
        renderer.prove().map_err(refused)?;
        Ok(renderer)
    }

    /// Limits encoding to this many threads; all cores if `None`.
    pub fn with_encoders(self, encoders: Option<usize>) -> Self {
        Self { encoders, ..self }
    }

    /// Product name of the GPU.
    pub fn gpu(&self) -> &str {
        &self.device.name
    }

    /// The most operations on `f32` a second that the GPU could do, a fused one counted twice.
    pub fn peak_flops(&self) -> f64 {
        let lanes = if matches!(self.device.architecture, 75 | 80) { 64.0 } else { 128.0 };
        2.0 * lanes * f64::from(self.device.multiprocessors) * f64::from(self.device.clock_khz) * 1e3
    }

    /// Time that kernels have taken since the last time this was asked.
    pub fn take_kernel_times(&self) -> KernelTimes {
        std::mem::take(&mut *lock(&self.kernels))
    }

    /// Makes the kernel of a tile ready, and reports the time that took.
    pub fn compile(&self, run: &TileRun<'_>) -> Result<Compiled, RenderError> {
        let source = Source::new(&run.job.at(run.frame)?);
        let start = Instant::now();
        let (program, was_kept) = self.program(&source, run).map_err(|trouble| self.failed(&trouble))?;
        let time = start.elapsed();
        let resources =
            self.device.resources(&program.loaded, program.shape).map_err(|trouble| self.failed(&trouble))?;
        Ok(Compiled { time, was_kept, shape: program.shape, resources })
    }

    /// Forgets the programs on the GPU; those on disk stay.
    pub fn forget(&self) {
        lock(&self.programs).clear();
    }

    /// Renders the self-test and compares it with the CPU's.
    fn prove(&self) -> Result<(), Trouble> {
        let job = scene::parse(SELF_TEST.as_bytes()).expect("the self-test is a job");
        let run = TileRun { job: &job, frame: 0, rect: Rect::full(job.image.width, job.image.height) };
        let mut got = Vec::new();
        self.render_groups(&[run], &Cancel::new(), &|_| {}, &mut got)?;
        let cpu = CpuRenderer::new(None, Simd::Auto).and_then(|cpu| cpu.render(&run, &Cancel::new(), &|_| {}));
        let Ok(want) = cpu else { return Err(Trouble::Cancelled) };
        let bits = |pixels: &Pixels| pixels.planes.iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>();
        let (got, want) = (bits(&got[0]), bits(&want));
        let differing = got.iter().zip(&want).filter(|(got, want)| got != want).count();
        if differing == 0 { Ok(()) } else { Err(Trouble::WrongBits { differing, values: want.len() }) }
    }

    /// Kernel of a source, compiled if necessary; also returns whether it came from the cache.
    fn program(&self, source: &Source, sample: &TileRun<'_>) -> Result<(Arc<Program>, bool), Trouble> {
        let key = Cache::key(&source.text, &compiler::options(self.device.architecture), &self.compiler.version);
        if let Some(program) = lock(&self.programs).get(&key) {
            return Ok((program.clone(), true));
        }
        let start = Instant::now();
        // A cached kernel that cannot be loaded, for example by another driver, is compiled again.
        let load = |code: &[u8]| self.device.load(code, !sample.job.image.layers.is_empty());
        let kept = self.cache.get(key).and_then(|kept| Some((load(&kept.code).ok()?, kept.shape)));
        let was_kept = kept.is_some();
        let (loaded, shape) = if let Some(kept) = kept {
            kept
        } else {
            let code = self
                .compiler
                .compile(&source.text, self.device.architecture)
                .map_err(|trouble| compiler::keep(trouble, &source.text, self.cache.folder()))?;
            let loaded = load(&code)?;
            let shape = self.fastest_shape(&loaded, source, sample)?;
            self.cache.put(key, &Kept { code, shape });
            (loaded, shape)
        };
        let program = Arc::new(Program { loaded, shape: self.shape.unwrap_or(shape), known: Mutex::default() });
        let mut programs = lock(&self.programs);
        if programs.len() >= MAX_PROGRAMS {
            programs.clear();
        }
        programs.insert(key, program.clone());
        *lock(&self.setup_time) += start.elapsed();
        Ok((program, was_kept))
    }

    /// Renders a part of a tile with each block shape, large enough for a meaningful time.
    fn fastest_shape(&self, loaded: &Loaded, source: &Source, run: &TileRun<'_>) -> Result<Shape, Trouble> {
        const ENOUGH_MS: f64 = 0.5;
        const ROUNDS: usize = 3;
        self.device.set_numbers(loaded, &source.parameters)?;
        let mut best = [f64::INFINITY; SHAPES.len()];
        let mut edge = 128;
        loop {
            let (width, height) = (run.rect.width.min(edge), run.rect.height.min(edge));
            let (x, y) = (run.rect.x + (run.rect.width - width) / 2, run.rect.y + (run.rect.height - height) / 2);
            let piece = Rect { x, y, width, height };
            let mut buffer = self.device.buffer(piece.pixels() as usize * run.job.image.channels().len())?;
            // Once to warm up, and to see whether it is enough.
            let ms = self.trial(loaded, SHAPES[0], piece, run, &mut buffer)?;
            if ms < ENOUGH_MS && piece != run.rect {
                edge *= 2;
                continue;
            }
            for _ in 0..ROUNDS {
                for (best, shape) in best.iter_mut().zip(SHAPES) {
                    *best = best.min(self.trial(loaded, shape, piece, run, &mut buffer)?);
                }
            }
            tracing::debug!(?best, edge, "tried every shape of blocks");
            let fastest = (0..SHAPES.len()).min_by(|&a, &b| best[a].total_cmp(&best[b]));
            return Ok(SHAPES[fastest.unwrap_or(0)]);
        }
    }

    /// Time of a part with one block shape, in milliseconds.
    fn trial(
        &self,
        loaded: &Loaded,
        shape: Shape,
        piece: Rect,
        run: &TileRun<'_>,
        buffer: &mut Buffer,
    ) -> Result<f64, Trouble> {
        let layout = launches::lay_out(&[piece], run.job.image.channels().len(), shape).in_rows();
        let laid_out = self.device.lay_out(&layout)?;
        let end_sample = run.job.image.samples.min(4);
        let part = device::Part { first_block: 0, blocks: layout.blocks, first_sample: 0, end_sample, is_last: true };
        self.device.launch(loaded, shape, &laid_out, part, buffer)?.wait()
    }

    /// Renders tiles, as many at a time as the buffers hold; one lot is copied while the next renders.
    fn render_groups(
        &self,
        runs: &[TileRun<'_>],
        cancel: &Cancel,
        progress: &(dyn Fn(u64) + Sync),
        finished: &mut Vec<Pixels>,
    ) -> Result<(), Trouble> {
        let Some(first) = runs.first() else { return Ok(()) };
        let nodes = first.job.nodes();
        if nodes > MAX_NODES {
            return Err(Trouble::TooLarge { nodes, most: MAX_NODES });
        }
        let source = Source::new(&first.job.at(first.frame)?);
        let planes = first.job.image.channels().len();
        let numbers = |run: &TileRun<'_>| run.rect.pixels() as usize * planes;
        let mut underway: Option<Underway> = None;
        let mut rest = runs;
        let mut most = BUFFER_NUMBERS;
        while !rest.is_empty() {
            let mut total = 0;
            let fitting = rest.iter().take_while(|run| {
                total += numbers(run);
                total <= most
            });
            let (group, others) = rest.split_at(fitting.count().max(1));
            let next = self.start(&source, group, cancel);
            if let Some(before) = underway.take() {
                finished.extend(self.finish(before, &first.job.image, progress)?);
            }
            if group.len() > 1 && matches!(next, Err(Trouble::OutOfMemory { .. })) {
                // Tiles that do not fit in memory together may fit one after another.
                most = group.iter().map(numbers).sum::<usize>() / 2;
                continue;
            }
            underway = Some(next?);
            rest = others;
        }
        if let Some(last) = underway {
            finished.extend(self.finish(last, &first.job.image, progress)?);
        }
        Ok(())
    }

    /// Launches the render of some tiles and the copy of their pixels.
    fn start(&self, source: &Source, runs: &[TileRun<'_>], cancel: &Cancel) -> Result<Underway, Trouble> {
        let image = &runs[0].job.image;
        let rects: Vec<Rect> = runs.iter().map(|run| run.rect).collect();
        let planes = image.channels().len();
        let numbers = rects.iter().map(|rect| rect.pixels() as usize).sum::<usize>() * planes;
        let _launching = lock(&self.launching);
        let (program, _) = self.program(source, &runs[runs.len() / 2])?;
        let mut buffer = self.take_buffer(numbers)?;
        let mut known = lock(&program.known);
        if known.numbers.as_ref() != Some(&source.parameters) {
            known.numbers = None;
            self.device.set_numbers(&program.loaded, &source.parameters)?;
            known.numbers = Some(source.parameters.clone());
        }
        let layout = launches::lay_out(&rects, planes, program.shape).ordered(&known.cost, image.samples);
        let laid_out = self.device.lay_out(&layout)?;
        let wave = self.device.multiprocessors * (2048 / program.shape.threads());
        let mut launches = Launches::new(layout.blocks, image.samples, wave);
        let mut flying: VecDeque<(device::Part, Launched)> = VecDeque::new();
        loop {
            let part = if cancel.is_cancelled() { None } else { launches.next(&known.cost) };
            if let Some(part) = part {
                let launched = self.device.launch(&program.loaded, program.shape, &laid_out, part, &mut buffer)?;
                flying.push_back((part, launched));
            }
            // One launch runs while the next is queued.
            if flying.len() == 2 || part.is_none() {
                let Some((part, launched)) = flying.pop_front() else { break };
                let ms = launched.wait()?;
                known.cost.learn(part, ms);
                lock(&self.kernels).add(ms);
            }
        }
        if cancel.is_cancelled() {
            lock(&self.buffers).push(buffer);
            return Err(Trouble::Cancelled);
        }
        self.device.fetch(&mut buffer, numbers)?;
        Ok(Underway { rects, buffer })
    }

    /// Waits for pixels and returns them.
    fn finish(
        &self,
        underway: Underway,
        image: &Image,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<Pixels>, Trouble> {
        let Underway { rects, buffer } = underway;
        let planes = image.channels().len();
        let mut rest = self.device.fetched(&buffer)?;
        let parts: Vec<(Rect, &[f32])> = rects
            .into_iter()
            .map(|rect| {
                let (own, others) = rest.split_at(rect.pixels() as usize * planes);
                rest = others;
                (rect, own)
            })
            .collect();
        let finished = parts
            .into_par_iter()
            .map(|(rect, numbers)| {
                let planes = numbers.par_chunks(rect.pixels() as usize).map(|plane| self.kept(plane)).collect();
                progress(rect.pixels() * u64::from(image.samples));
                Pixels { rect, planes }
            })
            .collect();
        lock(&self.buffers).push(buffer);
        Ok(finished)
    }

    /// Buffer that is large enough; smaller ones are freed.
    fn take_buffer(&self, numbers: usize) -> Result<Buffer, Trouble> {
        let mut buffers = lock(&self.buffers);
        buffers.retain(|buffer| buffer.numbers() >= numbers);
        match buffers.pop() {
            Some(buffer) => Ok(buffer),
            None => self.device.buffer(numbers),
        }
    }

    /// Copy of a plane, in reused memory if possible: new memory costs more than the copy.
    fn kept(&self, plane: &[f32]) -> Vec<f32> {
        let spare = {
            let mut spare = lock(&self.spare);
            let place = spare.iter().position(|old| old.capacity() >= plane.len());
            place.map(|place| spare.swap_remove(place))
        };
        let mut copy = spare.unwrap_or_default();
        copy.clear();
        copy.extend_from_slice(plane);
        copy
    }

    /// Notes a lost GPU; the trouble as a render's error.
    fn failed(&self, trouble: &Trouble) -> RenderError {
        if trouble.is_lost() {
            *lock(&self.lost) = Some(format!("{}: {trouble}", self.name));
        }
        match trouble {
            Trouble::Cancelled => RenderError::Cancelled,
            Trouble::Frame(refusal) => RenderError::Frame(refusal.clone()),
            _ => RenderError::Device { device: self.name.clone(), reason: trouble.to_string() },
        }
    }
}

impl Renderer for CudaRenderer {
    fn device(&self) -> String {
        self.name.clone()
    }

    fn render(
        &self,
        run: &TileRun<'_>,
        cancel: &Cancel,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Pixels, RenderError> {
        let mut finished = self.render_all(std::slice::from_ref(run), cancel, progress)?;
        Ok(finished.pop().expect("a render gives every tile it was asked for"))
    }

    fn render_all(
        &self,
        runs: &[TileRun<'_>],
        cancel: &Cancel,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<Pixels>, RenderError> {
        let mut finished = Vec::with_capacity(runs.len());
        let rendered = self.render_groups(runs, cancel, progress, &mut finished);
        rendered.map(|()| finished).map_err(|trouble| self.failed(&trouble))
    }

    fn take_setup_time(&self) -> Duration {
        std::mem::take(&mut *lock(&self.setup_time))
    }

    fn batch(&self) -> usize {
        1024
    }

    fn encoders(&self) -> usize {
        self.encoders.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
    }

    fn recycle(&self, pixels: Vec<Pixels>) {
        let mut spare = lock(&self.spare);
        let mut numbers: usize = spare.iter().map(Vec::capacity).sum();
        for plane in pixels.into_iter().flat_map(|pixels| pixels.planes) {
            numbers += plane.capacity();
            if numbers > MAX_SPARE_NUMBERS {
                break;
            }
            spare.push(plane);
        }
    }

    fn max_nodes(&self) -> Option<u32> {
        Some(MAX_NODES)
    }

    fn retired(&self) -> Option<String> {
        lock(&self.lost).clone()
    }
}

fn unavailable(wanted: &str, trouble: &Trouble) -> RenderError {
    RenderError::Unavailable { wanted: format!("--device {wanted}"), reason: trouble.to_string() }
}

/// Locks a mutex; poisoning is ignored because a panic elsewhere leaves no partial state here.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
