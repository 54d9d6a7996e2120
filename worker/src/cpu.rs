//! The CPU renderer: rayon over small blocks of a tile, one packet of pixels at a time.

mod packets;

use std::sync::Arc;

use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use scene::Integrator;

use crate::interrupt::interruptible;
use crate::simd::Simd;
use crate::{CancelFlag, RenderError, Renderer, TilePixels, TileRequest};

pub(crate) use packets::Packets;

/// Renders on the cores of this machine.
#[derive(Clone, Debug)]
pub struct CpuRenderer {
    threads: Arc<ThreadPool>,
    packets: Packets,
}

impl CpuRenderer {
    /// Renderer with this many threads (all cores if `None`) and these vector instructions.
    pub fn new(threads: Option<usize>, simd: Simd) -> Result<Self, RenderError> {
        let packets = Packets::new(simd)?;
        let threads = ThreadPoolBuilder::new()
            .num_threads(threads.unwrap_or(0))
            .thread_name(|index| format!("render-{index}"))
            .build()
            .map_err(RenderError::Threads)?;
        Ok(Self { threads: Arc::new(threads), packets })
    }

    /// Number of threads.
    pub fn threads(&self) -> usize {
        self.threads.current_num_threads()
    }

    /// Number of evaluations of the scene's distance for the pixels of a tile, without its layers.
    pub fn evaluations(&self, run: &TileRequest<'_>) -> Result<u64, RenderError> {
        let still = run.job.at(run.frame)?;
        let program = Integrator::new(&still);
        let rows = run.rect.y..run.rect.y + run.rect.height;
        let of_row = |row| self.packets.evaluations(&program, run.rect.x, row, run.rect.width as usize);
        Ok(self.threads.install(|| rows.into_par_iter().map(of_row).sum()))
    }
}

impl Renderer for CpuRenderer {
    fn device(&self) -> String {
        "cpu".to_owned()
    }

    fn encoder_threads(&self) -> usize {
        self.threads()
    }

    fn render(
        &self,
        run: &TileRequest<'_>,
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<TilePixels, RenderError> {
        let still = run.job.at(run.frame)?;
        let program = Integrator::new(&still);
        let image = &run.job.image;
        let mut pixels = TilePixels::zeroed(run.rect, image.channels().len());
        let height = self.packets.block_rows() as usize;
        let width = run.rect.width as usize;
        let rendered = self.threads.install(|| {
            bands(&mut pixels.planes, width * height).into_par_iter().enumerate().try_for_each(|(index, band)| {
                let top = run.rect.y + (index * height) as u32;
                interruptible(cancel, || self.packets.band(&program, image, run.rect.x, top, width, band, progress))
            })
        });
        rendered.map(|()| pixels).ok_or(RenderError::Cancelled)
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
