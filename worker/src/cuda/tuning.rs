//! Chooses the block dimensions of a kernel by measuring each.

use proto::Rect;

use super::cells::{Cells, Made};
use super::device::{self, BLOCK_DIMS, BlockDim, Buffer, LoadedModule};
use super::source::MAX_SAMPLES_TOGETHER;
use super::{CudaError, CudaRenderer, KernelSource, launches};
use crate::renderer::{CancelFlag, TileRequest};

impl CudaRenderer {
    /// Measures each of the block dimensions on a part of a tile that is large enough for a meaningful time. If that
    /// takes too long, the fastest so far is chosen.
    pub(super) fn tune_block_dim(
        &self,
        loaded: &LoadedModule,
        source: &KernelSource,
        run: &TileRequest<'_>,
        cancel: &CancelFlag,
    ) -> Result<BlockDim, CudaError> {
        const MIN_TIMED_MS: f64 = 0.5;
        const MAX_TOTAL_MS: f64 = 500.0;
        const ROUNDS: usize = 3;
        let mut total_ms = 0.0;
        self.device.set_uniforms(loaded, &source.parameters)?;
        let mut table = Cells::upload(&self.device, loaded, source, cancel)?;
        let mut best = [f64::INFINITY; BLOCK_DIMS.len()];
        let mut edge = 128;
        loop {
            let (width, height) = (run.rect.width.min(edge), run.rect.height.min(edge));
            let (x, y) = (run.rect.x + (run.rect.width - width) / 2, run.rect.y + (run.rect.height - height) / 2);
            let piece = Rect { x, y, width, height };
            // A launch that is the first and the last stores no sums of batches.
            let mut buffer =
                self.device.buffer(piece.pixels() as usize * run.job.image.film().rendered_channels().len())?;
            // The first run warms up, and shows whether the part is large enough.
            let mut ms = self.time_block_dim(loaded, BLOCK_DIMS[0], piece, run, &mut buffer)?;
            while let Some(cells) = &mut table
                && cells.has_asked(&self.device)?
            {
                if cells.make_asked(&self.device, loaded, cancel)? == Made::NotAll {
                    return Ok(BLOCK_DIMS[0]);
                }
                ms = self.time_block_dim(loaded, BLOCK_DIMS[0], piece, run, &mut buffer)?;
            }
            total_ms += ms;
            if ms < MIN_TIMED_MS && piece != run.rect {
                edge *= 2;
                continue;
            }
            for _ in 0..ROUNDS {
                for (best, block) in best.iter_mut().zip(BLOCK_DIMS) {
                    if cancel.is_cancelled() {
                        return Err(CudaError::Cancelled);
                    }
                    if total_ms < MAX_TOTAL_MS {
                        let ms = self.time_block_dim(loaded, block, piece, run, &mut buffer)?;
                        total_ms += ms;
                        *best = best.min(ms);
                    }
                }
            }
            tracing::debug!(?best, edge, "chose block dimensions");
            let fastest = (0..BLOCK_DIMS.len()).min_by(|&a, &b| best[a].total_cmp(&best[b]));
            return Ok(BLOCK_DIMS[fastest.unwrap_or(0)]);
        }
    }

    /// Time of a part with one choice of block dimensions, in milliseconds.
    fn time_block_dim(
        &self,
        loaded: &LoadedModule,
        block: BlockDim,
        piece: Rect,
        run: &TileRequest<'_>,
        buffer: &mut Buffer,
    ) -> Result<f64, CudaError> {
        let layout =
            launches::lay_out(&launches::whole(&[piece], run.job.image.film().rendered_channels().len()), block)
                .row_major();
        let laid_out = self.device.lay_out(&layout)?;
        let end_sample = run.job.image.samples.max().min(MAX_SAMPLES_TOGETHER);
        let part = device::LaunchRange {
            first_block: 0,
            blocks: layout.blocks,
            first_sample: 0,
            end_sample,
            is_last: true,
            has_layers: true,
        };
        self.device.launch(loaded, block, &laid_out, part, buffer)?.wait()
    }
}
