//! The CPU renderer: rayon over small blocks of a tile, one packet of pixels at a time.

mod blocks;
mod kernels;
mod packets;

use std::sync::Arc;

use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use scene::sample_count::{BLOCK_PX, within_batches};
use scene::visits::Visited;
use scene::{Exposure, Integrator, Job};
use tape::{Evaluator, Simd};

use crate::cells::FastBuilder;
use crate::picture_tape::{EVALUATIONS, record_evaluations};
use crate::rounds::Rounds;
use crate::{CancelFlag, RenderError, Renderer, TilePixels, TileRequest};
use kernels::{Kernel, KernelCache};
use packets::{Band, Progress, SAMPLES_PER_RUN, block};

/// Renders on the cores of this machine.
#[derive(Clone, Debug)]
pub struct CpuRenderer {
    threads: Arc<ThreadPool>,
    simd: Simd,
    cells: FastBuilder,
    kernels: Arc<KernelCache>,
}

impl CpuRenderer {
    /// Renderer with this many threads (all cores if `None`) and these vector instructions.
    pub fn new(threads: Option<usize>, simd: Simd) -> Result<Self, RenderError> {
        simd.check()?;
        let threads = ThreadPoolBuilder::new()
            .num_threads(threads.unwrap_or(0))
            .thread_name(|index| format!("render-{index}"))
            .build()
            .map_err(RenderError::Threads)?;
        Ok(Self { threads: Arc::new(threads), simd, cells: FastBuilder::UNLIMITED, kernels: Arc::default() })
    }

    /// Limits the cells of a frame to this many bytes. Those that do not fit are made again when they are needed, so the
    /// picture is the same.
    pub fn with_cell_memory(self, bytes: usize) -> Self {
        Self { cells: FastBuilder::with_memory(bytes), kernels: Arc::default(), ..self }
    }

    /// A renderer with this many threads of its own, which shares compiled scenes and cells with this one.
    pub fn sharing(&self, threads: usize) -> Result<Self, RenderError> {
        Ok(Self { cells: self.cells, kernels: self.kernels.clone(), ..Self::new(Some(threads), self.simd)? })
    }

    /// Compiles a frame, if that has not been done; returns whether it has cells, which are made as rays enter them.
    pub fn has_cells(&self, job: &Job, frame: u32) -> Result<bool, RenderError> {
        Ok(!self.kernel(&job.exposure(frame)?)?.tables().is_empty())
    }

    /// Runs work on a thread of its own pool, where its renders run too: with one thread, all on that one.
    pub fn on_thread<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        self.threads.install(work)
    }

    /// Number of threads.
    pub fn threads(&self) -> usize {
        self.threads.current_num_threads()
    }

    /// Number of evaluations of the scene's distance for the pixels of a tile, without its layers: only the evaluations of lanes
    /// that need them. Pixels are summed in runs of samples, because an `f32` counts to 2²⁴.
    pub fn evaluations(&self, run: &TileRequest<'_>) -> Result<u64, RenderError> {
        let tape = record_evaluations(&run.job.at(run.frame)?, &FastBuilder::UNLIMITED);
        let evaluator = Evaluator::new(&tape, self.simd)?;
        let (inputs, lanes) = (evaluator.inputs(&tape), evaluator.lanes());
        let (cancel, samples) = (CancelFlag::new(), run.job.image.samples.max());
        let of_row = |row: u32| {
            let (mut frame, mut sum) = (evaluator.frame(), 0);
            let (mut place, mut counts) = (vec![row as f32; 4 * lanes], vec![0.0; lanes]);
            for column in (0..run.rect.width).step_by(lanes) {
                let columns = (run.rect.x + column..).map(|x| x as f32);
                place.iter_mut().take(lanes).zip(columns).for_each(|(to, x)| *to = x);
                let inside = lanes.min((run.rect.width - column) as usize);
                for part in within_batches(0..samples, SAMPLES_PER_RUN) {
                    place[2 * lanes..3 * lanes].fill(part.start as f32);
                    place[3 * lanes..].fill(part.end as f32);
                    evaluator.run(EVALUATIONS, &mut frame, &inputs, cancel.flag(), &place, &mut counts);
                    sum += counts[..inside].iter().map(|&count| count as u64).sum::<u64>();
                }
            }
            sum
        };
        let rows = run.rect.y..run.rect.y + run.rect.height;
        let sum = self.threads.install(|| rows.into_par_iter().map(of_row).sum());
        match inputs.table() {
            Some(table) if table.is_full() => Err(RenderError::many_cells(table)),
            _ => Ok(sum),
        }
    }

    /// Renders bands. When the cells have no room, those that are left begin with none: all together, and one after
    /// another once not even one of them had room so.
    fn render_bands<'a>(
        &self,
        exposure: &'a Exposure<'_>,
        mut kernel: Kernel<'a>,
        mut bands: Vec<Band<'_, '_>>,
        cancel: &CancelFlag,
    ) -> Result<(), RenderError> {
        let mut is_parallel = true;
        loop {
            let count = bands.len();
            bands = self.threads.install(|| {
                if is_parallel {
                    bands.into_par_iter().filter_map(|band| band.render(&kernel)).collect()
                } else {
                    bands.into_iter().filter_map(|band| band.render(&kernel)).collect()
                }
            });
            if cancel.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            let tables = kernel.tables();
            let Some(full) = tables.iter().find(|table| table.is_full()).filter(|_| !bands.is_empty()) else {
                return Ok(());
            };
            if bands.len() == count && !std::mem::take(&mut is_parallel) {
                return Err(RenderError::many_cells(full));
            }
            tracing::debug!(rendered = count - bands.len(), left = bands.len(), "the cells had no room: drop them");
            for table in tables {
                self.kernels.forget_cells(table);
            }
            kernel = cancel.ends(|| self.kernel(exposure))??;
        }
    }

    /// Renders a tile by a kernel.
    fn render_by<'a>(
        &self,
        exposure: &'a Exposure<'_>,
        run: &TileRequest<'_>,
        kernel: Kernel<'a>,
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<TilePixels, RenderError> {
        let (left, width) = (run.rect.x, run.rect.width as usize);
        let mut pixels = TilePixels::zeroed(run.rect, run.job.image.film().rendered_channels().len());
        let sum_channels = run.job.image.film().sum_channels();
        progress(0);
        let (rounds, samples) = (Rounds::of(exposure.last().image()), exposure.samples());
        let height = if rounds.is_some() { BLOCK_PX as usize } else { block(kernel.lanes()).1 };
        let band = |(index, planes)| {
            let top = run.rect.y + (index * height) as u32;
            let (progress, cancel) = (Progress::new(progress), cancel.flag());
            Band { samples: &samples, rounds, left, top, width, planes, sum_channels, progress, cancel }
        };
        let bands = bands(&mut pixels.planes, width * height).into_iter().enumerate().map(band).collect();
        self.render_bands(exposure, kernel, bands, cancel)?;
        Ok(pixels)
    }

    fn kernel<'a>(&self, exposure: &'a Exposure<'_>) -> Result<Kernel<'a>, RenderError> {
        let reference = |instant| Integrator::of_picture(instant, &self.cells);
        Ok(match self.simd {
            Simd::Scalar => {
                Kernel::Reference(exposure.instants.iter().map(reference).collect(), exposure.last().image())
            }
            simd => Kernel::Prepared(self.kernels.prepare(exposure, simd, self.cells)?),
        })
    }
}

impl Renderer for CpuRenderer {
    fn device(&self) -> String {
        "cpu".to_owned()
    }

    fn encoder_threads(&self) -> usize {
        self.threads()
    }

    fn beside(&self) -> Result<Option<Arc<dyn Renderer>>, RenderError> {
        Ok(Some(Arc::new(self.sharing(self.threads())?)))
    }

    fn render(
        &self,
        run: &TileRequest<'_>,
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<TilePixels, RenderError> {
        let exposure = run.job.exposure(run.frame)?;
        let kernel = cancel.ends(|| self.kernel(&exposure))??;
        self.render_by(&exposure, run, kernel, cancel, progress)
    }

    fn can_record(&self) -> bool {
        true
    }

    fn render_recorded(
        &self,
        run: &TileRequest<'_>,
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<(TilePixels, Option<Visited>), RenderError> {
        let exposure = run.job.exposure(run.frame)?;
        let at_frame = exposure.last();
        let Some(program) = Integrator::recording(at_frame) else {
            return Ok((self.render(run, cancel, progress)?, None));
        };
        let visits = program.visits().expect("it records").clone();
        let (kernel, visits) = match self.simd {
            Simd::Scalar => (Kernel::Reference(vec![program], at_frame.image()), visits),
            simd => {
                let recordable = cancel.ends(|| self.kernels.recordable(at_frame, &program, &visits, simd))??;
                let (prepared, visits) = recordable.kernel();
                (Kernel::Prepared(prepared), visits)
            }
        };
        let pixels = self.render_by(&exposure, run, kernel, cancel, progress)?;
        Ok((pixels, Some(visits.read())))
    }
}

/// Divides all planes into bands of `length` numbers: a list of slices per band, one slice per plane.
fn bands(planes: &mut [Vec<f32>], length: usize) -> Vec<Vec<&mut [f32]>> {
    let count = planes.first().map_or(0, |plane| plane.len().div_ceil(length));
    let mut bands: Vec<Vec<&mut [f32]>> = (0..count).map(|_| Vec::with_capacity(planes.len())).collect();
    for plane in planes {
        for (band, slice) in bands.iter_mut().zip(plane.chunks_mut(length)) {
            band.push(slice);
        }
    }
    bands
}

#[cfg(test)]
mod tests;
