//! Packets: a block of neighboring pixels rendered together, one per lane.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use scene::sample_count::{BATCH, within_batches};

use super::blocks;
use super::kernels::{Kernel, Thread};
use crate::picture_tape::{ACCUMULATE, LAYERS, MEAN};
use crate::rounds::Rounds;

/// Samples of a packet's pixels that are summed between two reports of progress; it divides a batch.
pub(super) const SAMPLES_PER_RUN: u32 = 64;

/// Columns and rows of a packet's block: as square as its lanes allow.
pub(super) fn block(lanes: usize) -> (usize, usize) {
    let columns = 1 << lanes.ilog2().div_ceil(2);
    (columns, lanes / columns)
}

/// Adds the sums of a batch to the earlier batches' sums; the next begins with none.
pub(super) fn end_batch(batches: &mut [f32], batch: &mut [f32]) {
    for (sum, own) in batches.iter_mut().zip(batch) {
        *sum += std::mem::take(own);
    }
}

/// Rows of a tile, as high as a packet's block.
pub(super) struct Band<'a, 'b> {
    /// Samples of each round, at each instant of the frame.
    pub(super) samples: &'a [Vec<Range<u32>>],
    /// The rules of the rounds; `None` if there is one.
    pub(super) rounds: Option<Rounds<'a>>,
    pub(super) left: u32,
    pub(super) top: u32,
    pub(super) width: usize,
    pub(super) planes: Vec<&'b mut [f32]>,
    /// Number of planes of light, see [`scene::Film::sum_channels`].
    pub(super) sum_channels: usize,
    pub(super) progress: Progress<'a>,
    pub(super) cancel: &'a AtomicBool,
}

/// Counts finished rays, and reports each once, even if a band is rendered again.
pub(super) struct Progress<'a> {
    report: &'a (dyn Fn(u64) + Sync),
    finished: u64,
    reported: u64,
}

impl<'a> Progress<'a> {
    pub(super) fn new(report: &'a (dyn Fn(u64) + Sync)) -> Self {
        Self { report, finished: 0, reported: 0 }
    }

    pub(super) fn add(&mut self, rays: u64) {
        self.finished += rays;
        if self.finished > self.reported {
            (self.report)(self.finished - self.reported);
            self.reported = self.finished;
        }
    }
}

impl Band<'_, '_> {
    /// Renders the band. Returns it if its pixels are not the picture's: because the render is cancelled, or cells
    /// had no room.
    pub(super) fn render(mut self, kernel: &Kernel<'_>) -> Option<Self> {
        let lanes = kernel.lanes();
        let mut thread = kernel.thread();
        let tables = kernel.tables();
        self.progress.finished = 0;
        let step = if self.rounds.is_some() { blocks::columns(lanes) } else { block(lanes).0 };
        for column in (0..self.width).step_by(step) {
            if self.cancel.load(Ordering::Relaxed) {
                return Some(self);
            }
            match self.rounds {
                None => self.packet(&mut thread, lanes, column),
                Some(rules) => self.blocks(&mut thread, lanes, column, &rules),
            }
            if tables.iter().any(|table| table.is_full()) {
                return Some(self);
            }
        }
        None
    }

    /// Renders the block that starts in `column` of the band.
    fn packet(&mut self, thread: &mut Thread<'_>, lanes: usize, column: usize) {
        let mut arguments = vec![0.0; (4 + self.sum_channels) * lanes];
        for lane in 0..lanes {
            let (x, y) = self.lane_position(lanes, column, lane);
            arguments[lane] = (self.left as usize + x) as f32;
            arguments[lanes + lane] = (self.top as usize + y) as f32;
        }
        let mut channels = vec![0.0; self.planes.len() * lanes];
        let (color, layers) = channels.split_at_mut(self.sum_channels * lanes);
        self.radiance(thread, lanes, column, &mut arguments, color);
        if !layers.is_empty() {
            thread.run(self.last_instant(), LAYERS, self.cancel, &arguments[..2 * lanes], layers);
        }
        for (plane, values) in channels.chunks_exact(lanes).enumerate() {
            for (lane, value) in values.iter().enumerate() {
                let (x, y) = self.lane_position(lanes, column, lane);
                // A file must not distinguish zeros by their sign.
                self.planes[plane][y * self.width + x] = value + 0.0;
            }
        }
    }

    /// The color of a packet's pixels. The samples of a batch are summed in runs, which does not change their sum.
    fn radiance(
        &mut self,
        thread: &mut Thread<'_>,
        lanes: usize,
        column: usize,
        arguments: &mut [f32],
        color: &mut [f32],
    ) {
        let pixels = block(lanes).0.min(self.width - column) * self.rows();
        let mut batches = vec![0.0; color.len()];
        for (instant, samples) in self.samples[0].iter().enumerate() {
            for run in within_batches(samples.clone(), SAMPLES_PER_RUN) {
                arguments[2 * lanes..3 * lanes].fill(run.start as f32);
                arguments[3 * lanes..4 * lanes].fill(run.end as f32);
                thread.run(instant, ACCUMULATE, self.cancel, arguments, color);
                arguments[4 * lanes..].copy_from_slice(color);
                if run.end.is_multiple_of(BATCH) {
                    end_batch(&mut batches, &mut arguments[4 * lanes..]);
                }
                self.progress.add(pixels as u64 * run.len() as u64);
            }
        }
        end_batch(&mut batches, &mut arguments[4 * lanes..]);
        thread.run(0, MEAN, self.cancel, &batches, color);
    }

    /// The instant of the layers.
    pub(super) fn last_instant(&self) -> usize {
        self.samples[0].len() - 1
    }

    /// Rows of the band.
    pub(super) fn rows(&self) -> usize {
        self.planes[0].len() / self.width
    }

    /// Column and row in the band of a packet's lane. Lanes beyond the band's edge repeat its last pixels.
    fn lane_position(&self, lanes: usize, column: usize, lane: usize) -> (usize, usize) {
        let (columns, _) = block(lanes);
        ((column + lane % columns).min(self.width - 1), (lane / columns).min(self.rows() - 1))
    }
}
