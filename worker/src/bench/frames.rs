//! Complete frames on CPUs.

use std::time::Instant;

use proto::Rect;
use scene::Job;
use serde::Serialize;

use super::Spread;
use crate::{CancelFlag, CpuRenderer, RenderError, Renderer, Simd, TileRequest};

/// Time and figures of rendering a frame on CPUs.
#[derive(Clone, Debug, Serialize)]
pub struct RenderReport {
    /// The job's name.
    pub job: String,
    /// The vector instructions.
    pub simd: &'static str,
    /// Threads.
    pub threads: usize,
    /// Number of runs.
    pub runs: usize,
    /// Camera rays of the frame.
    pub rays: u64,
    /// Distances of the whole scene evaluated for the frame: marches, searches for roots, normals, shadows, ambient
    /// occlusion and nearest objects. Only lanes that need a distance are counted.
    pub evaluations: u64,
    /// Shortest run, in milliseconds.
    pub least_ms: f64,
    /// Median time of the runs, in milliseconds.
    pub median_ms: f64,
    /// Longest run, in milliseconds.
    pub greatest_ms: f64,
    /// Camera rays a second, at the median.
    pub rays_per_second: f64,
    /// Evaluations a second, at the median.
    pub evaluations_per_second: f64,
}

/// A way to render, and the seconds of each of its runs.
struct Row {
    renderer: CpuRenderer,
    simd: Simd,
    seconds: Vec<f64>,
}

/// Renders a frame of `job` several times in one way, with all cores if `threads` is `None`.
pub fn render(job: &Job, simd: Simd, threads: Option<usize>, runs: usize) -> Result<RenderReport, RenderError> {
    frames(job, &[(simd, threads)], runs).remove(0)
}

/// Renders a frame of `job` several times in each of several ways, which take turns, so that a change in the machine's
/// speed affects all of them.
pub fn frames(job: &Job, ways: &[(Simd, Option<usize>)], runs: usize) -> Vec<Result<RenderReport, RenderError>> {
    let mut rows: Vec<Result<Row, RenderError>> =
        ways.iter().map(|&(simd, threads)| Row::new(job, simd, threads)).collect();
    for _ in 0..runs.max(1) {
        for place in &mut rows {
            if let Ok(row) = place
                && let Err(error) = row.run(job)
            {
                *place = Err(error);
            }
        }
    }
    rows.into_iter().map(|row| row?.report(job)).collect()
}

fn whole_frame(job: &Job) -> TileRequest<'_> {
    TileRequest { job, frame: 0, rect: Rect::full(job.image.film().width, job.image.film().height) }
}

impl Row {
    /// Renders a pixel, which compiles the scene.
    fn new(job: &Job, simd: Simd, threads: Option<usize>) -> Result<Self, RenderError> {
        let renderer = CpuRenderer::new(threads, simd)?;
        let pixel = TileRequest { rect: Rect::full(1, 1), ..whole_frame(job) };
        renderer.render(&pixel, &CancelFlag::new(), &|_| ())?;
        Ok(Self { renderer, simd, seconds: Vec::new() })
    }

    fn run(&mut self, job: &Job) -> Result<(), RenderError> {
        let start = Instant::now();
        std::hint::black_box(self.renderer.render(&whole_frame(job), &CancelFlag::new(), &|_| ())?);
        self.seconds.push(start.elapsed().as_secs_f64());
        Ok(())
    }

    fn report(self, job: &Job) -> Result<RenderReport, RenderError> {
        let (rays, evaluations) = (job.rays_per_frame(), self.renderer.evaluations(&whole_frame(job))?);
        let runs = self.seconds.len();
        let Spread { least, median, greatest } = Spread::new(self.seconds);
        Ok(RenderReport {
            job: job.name.clone(),
            simd: self.simd.resolve_auto().name(),
            threads: self.renderer.threads(),
            runs,
            rays,
            evaluations,
            least_ms: least * 1e3,
            median_ms: median * 1e3,
            greatest_ms: greatest * 1e3,
            rays_per_second: rays as f64 / median,
            evaluations_per_second: evaluations as f64 / median,
        })
    }
}
