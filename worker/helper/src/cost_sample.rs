//! Estimates the cost of a job from a sixteenth of its pixels: small blocks all over its frames are rendered
//! as in the picture, on all threads at once, for a limited time.
//!
//! It measures CPU time rather than elapsed time, because the farm may be busy.

use std::io::Cursor;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use proto::Rect;
use proto::preview_helper::CostSample;
use rustix::time::{ClockId, clock_gettime};
use scene::Job;
use scene::limits::MIN_REWEIGHTED_SAMPLES;
use worker::image::{Encoders, PictureSpec};
use worker::stitch::TileRows;
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TilePixels, TileRequest};

use crate::attempt;

/// Edge of a block, in pixels.
pub(super) const BLOCK_PX: u32 = 16;
/// In each square with this edge, one block is rendered: a sixteenth.
const CELL_PX: u32 = 64;
/// Maximum rays per pixel of a sample: a ray of four costs up to 1.8 times as much as one of sixteen, and one of more hardly
/// less.
const MAX_SAMPLES: u32 = 16;
/// Maximum number of sampled frames of an animation, spread evenly from the first to the last.
const MAX_FRAMES: u32 = 5;
/// Maximum data of a frame that a worker holds, in bytes.
const MAX_FRAME_BYTES: u64 = 256 << 20;

/// Samples a job on `threads` threads for about `render_ms`; again for up to four times as long if the range of its time is wide,
/// or if making cells takes a part of the time, which rays then share.
pub fn sample(job: &Job, threads: usize, render_ms: u64) -> anyhow::Result<CostSample> {
    /// Factor between the ends of a range that is not wide.
    const NARROW: f64 = 3.0;
    /// Growth of the time.
    const LONGER: u64 = 4;
    /// The longest time, because others wait for the helper.
    const MOST_MS: u64 = 3_000;
    let sample = sample_once(job, threads, render_ms);
    let is_enough = |sample: &CostSample| {
        let (low, high) = sample.range(1.0);
        high <= NARROW * low && sample.shared_seconds_per_frame == 0.0
    };
    if sample.as_ref().is_ok_and(is_enough) {
        sample
    } else {
        sample_once(job, threads, (LONGER * render_ms).min(MOST_MS))
    }
}

fn sample_once(job: &Job, threads: usize, render_ms: u64) -> anyhow::Result<CostSample> {
    let count = job.frames.count.min(MAX_FRAMES);
    let spread = |index: u32| u64::from(job.frames.count - 1) * u64::from(index) / u64::from((count - 1).max(1));
    let limit = Duration::from_millis(render_ms) / count;
    let first = CpuRenderer::new(Some(1), Simd::Auto)?;
    let renderers: Vec<CpuRenderer> = (0..threads.max(1)).map(|_| first.sharing(1)).collect::<Result<_, _>>()?;
    let mut costs = Vec::new();
    for index in 0..count {
        costs.push(measure(job, spread(index) as u32, &renderers, limit)?);
    }
    let mut sum = FrameCost::default();
    for cost in &costs {
        sum.add(cost);
    }
    let frames = f64::from(count);
    ensure!(sum.rays > 0, "its pixels take too long to render a sample of them");
    let film = job.image.film();
    let frame_bytes = film.pixels() * u64::from(film.pixel_bytes());
    Ok(CostSample {
        rays: sum.rays,
        thread_seconds_per_ray: sum.seconds_per_ray / frames,
        setup_seconds_per_tile: sum.setup_seconds / frames,
        shared_seconds_per_frame: sum.shared_seconds / frames,
        encode_seconds_per_pixel: sum.encode_seconds_per_pixel / frames,
        relative_error: relative_error(&costs, job.frames.count),
        memory_bytes: peak_memory_bytes() + frame_bytes.min(MAX_FRAME_BYTES),
    })
}

/// Cost of one frame, or of several in sum.
#[derive(Clone, Copy, Debug, Default)]
struct FrameCost {
    rays: u64,
    seconds_per_ray: f64,
    setup_seconds: f64,
    shared_seconds: f64,
    encode_seconds_per_pixel: f64,
    /// Variance of the estimate of `seconds_per_ray`, from the spread of its blocks.
    variance: f64,
    /// Fraction of the frame's time that is for what its tiles share, which is only roughly known.
    shared_fraction: f64,
}

impl FrameCost {
    fn add(&mut self, other: &Self) {
        self.rays += other.rays;
        self.seconds_per_ray += other.seconds_per_ray;
        self.setup_seconds += other.setup_seconds;
        self.shared_seconds += other.shared_seconds;
        self.encode_seconds_per_pixel += other.encode_seconds_per_pixel;
    }
}

fn measure(job: &Job, frame: u32, renderers: &[CpuRenderer], limit: Duration) -> anyhow::Result<FrameCost> {
    let mut job = job.clone();
    if job.image.layers.is_empty() {
        let most = if job.image.is_reweighted() { MIN_REWEIGHTED_SAMPLES } else { MAX_SAMPLES };
        job.image.samples = job.image.samples.max().min(most).into();
    }
    let rects = blocks(job.image.film().width, job.image.film().height);
    let first = renderers.first().context("there is a renderer")?;
    // Cells are made by one ray a pixel nearly as much as by several, so that this reaches more of them.
    let mut single = job.clone();
    if single.image.layers.is_empty() {
        single.image.samples = 1.into();
    }
    let has_cells = first.has_cells(&job, frame)?;
    // A compiled frame is prepared for each block as for a tile, which a pixel shows.
    let pixel = Rect { width: 1, height: 1, ..*rects.first().context("a picture has a block")? };
    let pixels = Pass::render(&job, frame, renderers.get(..1).unwrap_or_default(), limit / 4, &[pixel; 2])?;
    let setup_seconds = pixels.blocks.iter().map(|block| block.seconds).reduce(f64::min).unwrap_or_default();
    let (sampled, all, shared_seconds) = if has_cells {
        first.has_cells(&single, frame)?;
        let making = Pass::render(&single, frame, renderers, limit / 2, &rects)?;
        // Blocks that were not finished would still make cells.
        let mut finished: Vec<Rect> = making.blocks.iter().map(|block| block.pixels.rect).collect();
        if finished.is_empty() {
            finished.extend(rects.first());
        }
        let made = Pass::render(&single, frame, renderers, limit / 6, &finished)?;
        let again = || Pass::render(&job, frame, renderers, limit / 6, &finished);
        let passes = [again()?, again()?].into_iter().filter(|pass| pass.rays > 0);
        match passes.min_by(|a, b| a.seconds_per_ray(0.0).total_cmp(&b.seconds_per_ray(0.0))) {
            Some(pass) => {
                let frame_blocks = job.image.film().pixels() as f64 / f64::from(BLOCK_PX * BLOCK_PX);
                let shared_seconds = making.shared_seconds(made.seconds_per_ray(0.0), frame_blocks);
                (&job, pass, shared_seconds)
            }
            None => (&single, making, 0.0),
        }
    } else {
        (&job, Pass::render(&job, frame, renderers, limit, &rects)?, 0.0)
    };
    let (rays, seconds_per_ray) = (all.rays, all.seconds_per_ray(setup_seconds));
    let variance = all.variance(rects.len());
    let rendering = seconds_per_ray * job.image.rays() as f64;
    let shared_fraction = shared_seconds / (shared_seconds + rendering).max(f64::MIN_POSITIVE);
    let blocks = all.blocks.into_iter().map(|block| block.pixels).collect();
    let encode_seconds_per_pixel = encode(PictureSpec::new(&sampled.at(frame)?), blocks)?;
    Ok(FrameCost {
        rays,
        seconds_per_ray,
        setup_seconds,
        shared_seconds,
        encode_seconds_per_pixel,
        variance,
        shared_fraction,
    })
}

/// Error of the estimate from these frames of an animation, as a fraction, with a chance of 95 %.
fn relative_error(costs: &[FrameCost], frames: u32) -> f64 {
    /// Part that no spread shows: what else the machine's cores do, and what blocks of few samples cost more than a picture.
    const SYSTEMATIC: f64 = 0.45;
    /// Error of the time for cells, as a fraction of it.
    const SHARED: f64 = 0.55;
    /// Half the width of a range of 95 %, in standard deviations.
    const DEVIATIONS: f64 = 1.96;
    let count = costs.len() as f64;
    let mean = costs.iter().map(|cost| cost.seconds_per_ray).sum::<f64>() / count;
    if mean <= 0.0 {
        return 1.0;
    }
    let within = costs.iter().map(|cost| cost.variance).sum::<f64>() / (count * count);
    let squares: f64 = costs.iter().map(|cost| (cost.seconds_per_ray - mean).powi(2)).sum();
    let unseen = 1.0 - count / f64::from(frames);
    let between = if count > 1.0 { squares / (count - 1.0) / count * unseen } else { 0.0 };
    let shared = costs.iter().map(|cost| cost.shared_fraction).sum::<f64>() / count * SHARED;
    let spread = DEVIATIONS * (within + between).sqrt() / mean;
    (spread.powi(2) + shared.powi(2) + SYSTEMATIC.powi(2)).sqrt()
}

/// A finished block.
#[derive(Debug)]
pub(super) struct Block {
    pub(super) pixels: TilePixels,
    /// CPU time, in seconds.
    pub(super) seconds: f64,
}

/// Rays and finished blocks, and the CPU time of all threads for them, in seconds.
#[derive(Debug)]
pub(super) struct Pass {
    pub(super) rays: u64,
    pub(super) seconds: f64,
    pub(super) blocks: Vec<Block>,
}

impl Pass {
    /// Renders blocks until each thread has used the time limit, on all renderers at once; on a busy machine for at most twice
    /// that time.
    pub(super) fn render(
        job: &Job,
        frame: u32,
        renderers: &[CpuRenderer],
        limit: Duration,
        rects: &[Rect],
    ) -> anyhow::Result<Self> {
        let next = AtomicUsize::new(0);
        let start = Instant::now();
        let cancel = CancelFlag::new();
        // A block that takes too long is cancelled.
        let passes = attempt::limited(&cancel, Some(limit * 3), || {
            let (next, cancel) = (&next, &cancel);
            let work = move |renderer: &CpuRenderer| {
                let mut pass = Self { rays: 0, seconds: 0.0, blocks: Vec::new() };
                while pass.seconds < limit.as_secs_f64() && start.elapsed() < limit * 2 {
                    let Some(&rect) = rects.get(next.fetch_add(1, Ordering::Relaxed)) else { break };
                    let rays = AtomicU64::new(0);
                    let count = |more: u64| {
                        rays.fetch_add(more, Ordering::Relaxed);
                    };
                    let before = thread_seconds();
                    let rendered = renderer.render(&TileRequest { job, frame, rect }, cancel, &count);
                    let seconds = thread_seconds() - before;
                    // The rays of a cancelled block count as well: it is the expensive ones that are cancelled.
                    pass.rays += rays.into_inner();
                    pass.seconds += seconds;
                    match rendered {
                        Ok(pixels) => pass.blocks.push(Block { pixels, seconds }),
                        Err(worker::RenderError::Cancelled) => break,
                        Err(error) => return Err(error),
                    }
                }
                Ok(pass)
            };
            let run = move |renderer: &CpuRenderer| renderer.on_thread(|| work(renderer));
            let ended: Vec<_> = std::thread::scope(|scope| {
                let threads: Vec<_> = renderers.iter().map(|renderer| scope.spawn(move || run(renderer))).collect();
                threads.into_iter().map(std::thread::ScopedJoinHandle::join).collect()
            });
            let ended = ended.into_iter().map(|end| {
                end.map_err(|_| anyhow::anyhow!("a rendering thread panicked"))?.context("could not render a sample")
            });
            ended.collect::<anyhow::Result<Vec<Self>>>()
        })?;
        let mut all = Self { rays: 0, seconds: 0.0, blocks: Vec::new() };
        for pass in passes {
            all.rays += pass.rays;
            all.seconds += pass.seconds;
            all.blocks.extend(pass.blocks);
        }
        Ok(all)
    }

    /// Variance of the mean time of a ray, where these are some of `total` blocks. Few blocks say little of their own spread.
    fn variance(&self, total: usize) -> f64 {
        let per_ray = |block: &Block| {
            let rays = block.pixels.rect.pixels() as f64 * self.rays as f64 / self.pixels().max(1.0);
            block.seconds / rays.max(1.0)
        };
        let count = self.blocks.len() as f64;
        let mean = self.blocks.iter().map(per_ray).sum::<f64>() / count.max(1.0);
        if self.blocks.len() < 2 {
            return self.seconds_per_ray(0.0).powi(2);
        }
        let squares: f64 = self.blocks.iter().map(|block| (per_ray(block) - mean).powi(2)).sum();
        // A block stands for the cell around it, and shows a sixteenth of it.
        let shown = count / total.max(1) as f64 / 16.0;
        squares / (count - 1.0) / count * (1.0 - shown) * (1.0 + 5.0 / count)
    }

    fn pixels(&self) -> f64 {
        self.blocks.iter().map(|block| block.pixels.rect.pixels() as f64).sum()
    }

    /// CPU time of a ray, without that for preparing each block.
    fn seconds_per_ray(&self, setup_seconds: f64) -> f64 {
        let rendering = (self.seconds - self.blocks.len() as f64 * setup_seconds).max(self.seconds / 10.0);
        rendering / self.rays.max(1) as f64
    }

    /// CPU time of making the cells of a frame of `frame_blocks`, where a ray takes `seconds_per_ray` without that.
    fn shared_seconds(&self, seconds_per_ray: f64, frame_blocks: f64) -> f64 {
        /// Blocks all over a picture share large cells, so that the time grows with a power of their number: with none in scenes
        /// of few thousand shapes, and with the square root in the largest ones of docs/benchmarks.md. This is the middle.
        const GROWTH: f64 = 0.25;
        let making = (self.seconds - self.rays as f64 * seconds_per_ray).max(0.0);
        making * (frame_blocks / self.blocks.len().max(1) as f64).max(1.0).powf(GROWTH)
    }
}

/// Returns a block in each cell of a picture, ordered so that the first few are spread all over it.
pub(super) fn blocks(width: u32, height: u32) -> Vec<Rect> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut roll = |sides: u32| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) % u64::from(sides)) as u32
    };
    let mut rects = Vec::new();
    for top in (0..height).step_by(CELL_PX as usize) {
        for left in (0..width).step_by(CELL_PX as usize) {
            let (x, y) = (left + roll(CELL_PX), top + roll(CELL_PX));
            let (x, y) = (x.min(width.saturating_sub(BLOCK_PX)), y.min(height.saturating_sub(BLOCK_PX)));
            rects.push(Rect { x, y, width: BLOCK_PX.min(width - x), height: BLOCK_PX.min(height - y) });
        }
    }
    for last in (1..rects.len()).rev() {
        let other = roll(u32::try_from(last + 1).unwrap_or(u32::MAX)) as usize;
        rects.swap(last, other);
    }
    rects
}

/// Time to encode a pixel into the picture's file, in seconds, measured on a picture that consists of blocks: nearly a square,
/// because noise is removed with margins.
fn encode(mut picture: PictureSpec, mut blocks: Vec<TilePixels>) -> anyhow::Result<f64> {
    blocks.retain(|block| (block.rect.width, block.rect.height) == (BLOCK_PX, BLOCK_PX));
    if blocks.is_empty() {
        return Ok(0.0);
    }
    let columns = blocks.len().isqrt();
    let rows = blocks.len() / columns;
    blocks.truncate(columns * rows);
    for (index, block) in blocks.iter_mut().enumerate() {
        let [x, y] = [index % columns, index / columns].map(|place| place as u32 * BLOCK_PX);
        block.rect = Rect { x, y, width: BLOCK_PX, height: BLOCK_PX };
    }
    picture.width = columns as u32 * BLOCK_PX;
    picture.height = rows as u32 * BLOCK_PX;
    let start = Instant::now();
    let mut file = Cursor::new(Vec::new());
    Encoders::new(1)?.run(|_| picture.write(&mut TileRows(&blocks), &mut file, &CancelFlag::new()))?;
    Ok(start.elapsed().as_secs_f64() / Rect::full(picture.width, picture.height).pixels() as f64)
}

/// CPU time of this thread, in seconds.
fn thread_seconds() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
}

/// Peak memory of this process, in bytes; 0 if the system does not report it.
fn peak_memory_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kibibytes = peak.and_then(|peak| peak.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    kibibytes.unwrap_or(0) << 10
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_that_blocks_share_are_not_counted_for_each_ray() {
        let (job, rects) = (many_spheres(200), blocks(256, 256));
        let first = CpuRenderer::new(Some(1), Simd::Auto).expect("threads");
        let renderers = [first.sharing(1).expect("threads"), first.sharing(1).expect("threads")];
        assert!(first.has_cells(&job, 0).expect("it compiles"));
        let pass = Pass::render(&job, 0, &renderers, Duration::from_mins(1), &rects).expect("a sample");
        assert_eq!((pass.blocks.len(), pass.rays), (16, 16 * 256 * 4));
        // A second of each three goes into rays, and the rest into cells; a frame has 256 blocks.
        let pass = Pass { seconds: 3.0 * pass.rays as f64, ..pass };
        assert_eq!(pass.shared_seconds(1.0, 256.0), 2.0 * pass.rays as f64 * 2.0);
        assert_eq!(pass.shared_seconds(4.0, 256.0), 0.0);
    }

    /// A job of spheres in a smooth union, row by row in a cube.
    fn many_spheres(count: u32) -> Job {
        let sphere = |number: u32| {
            let at = [number % 10, number / 10 % 10, number / 100].map(|c| f64::from(c) / 5.0 - 0.9);
            format!(r#"{{ "translate": {{ "by": {at:?}, "child": {{ "sphere": {{ "radius": 0.08 }} }} }} }}"#)
        };
        let spheres: Vec<String> = (0..count).map(sphere).collect();
        let job = format!(
            r#"{{ "scene": {{ "camera": {{ "position": [1, 1, 4], "look_at": [0, 0, 0] }}, "objects": [{{ "shape":
                {{ "union": {{ "smooth": 0.05, "of": [{}] }} }} }}] }}, "image": {{ "width": 256, "height": 256 }} }}"#,
            spheres.join(",")
        );
        scene::parse(job.as_bytes()).expect("a valid job")
    }

    #[test]
    fn blocks_cover_a_sixteenth_of_a_large_picture() {
        for (width, height) in [(1, 1), (7, 300), (16, 16), (64, 64), (100, 65), (1920, 1080)] {
            let rects = blocks(width, height);
            assert!(!rects.is_empty());
            for rect in rects {
                assert!(rect.pixels() > 0, "{rect:?}");
                assert!(rect.x + rect.width <= width && rect.y + rect.height <= height, "{rect:?} in {width}×{height}");
            }
        }
        let sampled: u64 = blocks(1920, 1088).into_iter().map(Rect::pixels).sum();
        assert_eq!(sampled * 16, 1920 * 1088);
    }
}
