//! Splits a render into launches: short enough that a cancel takes effect soon, and long enough to keep a GPU
//! busy. Arithmetic only.

use std::ops::Range;

use proto::Rect;
use scene::sample_count::BATCH;

use super::device::{BlockDim, DeviceTile, LaunchRange};

/// Target duration of a launch, in milliseconds; two are in flight at a time.
const LAUNCH_MS: f64 = 12.0;
/// Maximum growth from one launch to the next while the cost is not well known.
const MAX_GROWTH: f64 = 6.0;
/// Number of neighboring blocks that are launched together.
pub(super) const BLOCK_GROUP: u32 = 64;
/// Samples of a kernel's first launch.
const FIRST_SAMPLES: u32 = 4;

/// A rectangle of a tile's pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    pub(super) rect: Rect,
    pub(super) tile: Rect,
    /// Index of the tile's first number.
    pub(super) start: u64,
}

/// All pixels of some tiles, which are stored consecutively, each as this many planes.
pub(super) fn whole(tiles: &[Rect], planes: usize) -> Vec<Piece> {
    let mut start = 0;
    let piece = |&tile: &Rect| {
        let piece = Piece { rect: tile, tile, start };
        start += tile.pixels() * planes as u64;
        piece
    };
    tiles.iter().map(piece).collect()
}

/// Pieces of tiles divided into blocks.
#[derive(Clone, Debug)]
pub(super) struct LaunchLayout {
    pub(super) tiles: Vec<DeviceTile>,
    /// Number of blocks, rounded up to whole groups.
    pub(super) blocks: u32,
    /// Groups in the order in which they are launched.
    pub(super) groups: Vec<u32>,
}

/// Divides pieces of tiles into blocks. Groups that are launched together are far apart, so that no launch costs much
/// more than another because of the part of the picture it renders.
pub(super) fn lay_out(pieces: &[Piece], block: BlockDim) -> LaunchLayout {
    let mut first_block = 0;
    let tiles = pieces
        .iter()
        .map(|&Piece { rect, tile, start }| {
            let columns = rect.width.div_ceil(block.columns);
            let pitch = u64::from(tile.width);
            let laid_out = DeviceTile {
                x: rect.x,
                y: rect.y,
                width: rect.width,
                height: rect.height,
                first_block,
                columns,
                start: start + u64::from(rect.y - tile.y) * pitch + u64::from(rect.x - tile.x),
                pitch,
                plane: tile.pixels(),
            };
            first_block += columns * rect.height.div_ceil(block.rows);
            laid_out
        })
        .collect();
    let groups = first_block.div_ceil(BLOCK_GROUP);
    LaunchLayout { tiles, blocks: groups * BLOCK_GROUP, groups: spread(groups) }
}

impl LaunchLayout {
    /// Ordering for a single launch, in which similar blocks run together.
    pub(super) fn ordered(self, cost: &CostModel, samples: u32) -> Self {
        if cost.is_one_launch(self.blocks, samples) { self.row_major() } else { self }
    }

    /// The order of rows.
    pub(super) fn row_major(mut self) -> Self {
        self.groups.sort_unstable();
        self
    }
}

/// All numbers below a count, with neighbors far apart: multiples of a number near its golden section, wrapping
/// around.
fn spread(count: u32) -> Vec<u32> {
    const GOLDEN_SECTION: f64 = 0.618_034;
    let common = |a: u32, b: u32| {
        let (mut a, mut b) = (a, b);
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    let near = ((f64::from(count) * GOLDEN_SECTION) as u32).max(1);
    let stride = (near..=count).find(|&stride| common(stride, count) == 1).unwrap_or(1);
    (0..u64::from(count)).map(|turn| (turn * u64::from(stride) % u64::from(count)) as u32).collect()
}

/// Measured cost of rendering with a kernel on a GPU.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CostModel {
    /// Milliseconds for one sample of all pixels of a block.
    block_sample_ms: Option<f64>,
    /// Block samples of the largest launch so far.
    largest: f64,
}

impl CostModel {
    /// Updates the estimate with a measured launch.
    pub(super) fn observe(&mut self, part: LaunchRange, ms: f64) {
        let units = part.block_samples();
        let now = ms / units;
        // An expensive part may occur again, so the estimate decreases slowly.
        self.block_sample_ms = Some(self.block_sample_ms.map_or(now, |before| now.max(0.8 * before)));
        self.largest = self.largest.max(units);
    }

    /// Whether this many blocks are known to fit into one launch.
    fn is_one_launch(&self, blocks: u32, samples: u32) -> bool {
        let units = f64::from(blocks) * f64::from(samples);
        self.block_sample_ms.is_some_and(|ms| units * ms <= LAUNCH_MS && units <= MAX_GROWTH * self.largest)
    }

    /// Number of block samples for the next launch.
    fn next_size(&self, wave: u32) -> f64 {
        let first = f64::from(wave) * f64::from(FIRST_SAMPLES);
        self.block_sample_ms.map_or(first, |ms| (LAUNCH_MS / ms).min(MAX_GROWTH * self.largest.max(first)))
    }
}

/// Time that launches took, in milliseconds.
#[derive(Clone, Copy, Debug, Default)]
pub struct KernelTimes {
    /// Total.
    pub total_ms: f64,
    /// Longest launch.
    pub longest_ms: f64,
}

impl KernelTimes {
    pub(super) fn add(&mut self, ms: f64) {
        self.total_ms += ms;
        self.longest_ms = self.longest_ms.max(ms);
    }
}

/// Work of the last launch of each pixel, beside adding samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ends {
    /// Divides the sums by the number of samples.
    pub(super) mean: bool,
    /// Renders the layers.
    pub(super) layers: bool,
}

/// Launches of a render, in order.
#[derive(Clone, Copy, Debug)]
pub(super) struct Launches {
    blocks: u32,
    first_sample: u32,
    end_sample: u32,
    ends: Ends,
    /// Blocks that fill the GPU once.
    resident_blocks: u32,
    /// Blocks in progress, and the sample they have reached.
    first_block: u32,
    end_block: u32,
    sample: u32,
    /// Maximum number of blocks of a launch.
    max_blocks: u32,
    /// Samples of a pixel that are rendered together: the number of samples is a multiple.
    together: u32,
}

impl LaunchRange {
    fn block_samples(self) -> f64 {
        f64::from(self.blocks) * f64::from(self.end_sample - self.first_sample)
    }
}

impl Launches {
    /// Launches for some samples of all blocks.
    pub(super) fn new(blocks: u32, samples: Range<u32>, ends: Ends, wave: u32, together: u32) -> Self {
        Self {
            blocks,
            first_sample: samples.start,
            end_sample: samples.end,
            ends,
            resident_blocks: wave.max(1),
            first_block: 0,
            end_block: 0,
            sample: samples.start,
            max_blocks: blocks,
            together,
        }
    }

    /// Begins again with all samples at a block, which has been launched before.
    pub(super) fn restart(&mut self, first_block: u32) {
        (self.first_block, self.sample) = (first_block, self.first_sample);
    }

    /// Begins again with a launch, whose pixels have the samples before it.
    pub(super) fn repeat(&mut self, part: LaunchRange) {
        (self.first_block, self.end_block) = (part.first_block, part.first_block + part.blocks);
        self.sample = part.first_sample;
    }

    /// Limits all further launches to this many blocks.
    pub(super) fn limit(&mut self, blocks: u32) {
        self.max_blocks = blocks;
    }

    /// Samples of a launch in which about `fitting` of a batch's `left` ones fit, so that the launches of all of them have about
    /// as many.
    fn evenly(&self, left: u32, fitting: f64) -> u32 {
        let launches = (f64::from(left) / fitting.max(1.0)).round().max(1.0);
        ((f64::from(left) / launches) as u32).next_multiple_of(self.together).clamp(1, left)
    }

    /// Next launch, if any is left.
    pub(super) fn next(&mut self, cost: &CostModel) -> Option<LaunchRange> {
        if self.sample == self.first_sample {
            if self.first_block == self.blocks {
                return None;
            }
            // Otherwise all samples of a batch of some blocks, at least as many as fill the GPU.
            let samples = (self.end_sample - self.first_sample).min(BATCH);
            let fitting = (cost.next_size(self.resident_blocks) / f64::from(samples)) as u32;
            let count = fitting.max(self.resident_blocks).min(self.max_blocks);
            self.end_block = self.first_block.saturating_add(count).min(self.blocks);
        }
        let blocks = self.end_block - self.first_block;
        let fitting = cost.next_size(self.resident_blocks) / f64::from(blocks);
        let end_of_batch = ((self.sample / BATCH + 1) * BATCH).min(self.end_sample);
        let end_sample = self.sample + self.evenly(end_of_batch - self.sample, fitting);
        let (first_block, first_sample) = (self.first_block, self.sample);
        let is_end = end_sample == self.end_sample;
        if is_end {
            self.restart(self.end_block);
        } else {
            self.sample = end_sample;
        }
        let Ends { mean, layers } = self.ends;
        let (is_last, has_layers) = (is_end && mean, is_end && layers);
        Some(LaunchRange { first_block, blocks, first_sample, end_sample, is_last, has_layers })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: Ends = Ends { mean: true, layers: true };

    /// Simulates all launches on a GPU that takes `ms` for a sample of a block; returns the longest launch.
    fn longest_launch(blocks: u32, samples: u32, ms: impl Fn(u32) -> f64) -> f64 {
        let together = (1 << samples.trailing_zeros()).min(4);
        let blocks = blocks.next_multiple_of(BLOCK_GROUP);
        let groups = spread(blocks / BLOCK_GROUP);
        let order = |turn: u32| groups[(turn / BLOCK_GROUP) as usize] * BLOCK_GROUP + turn % BLOCK_GROUP;
        let mut cost = CostModel::default();
        let mut launches = Launches::new(blocks, 0..samples, ALL, 1000, together);
        let mut rendered = vec![0; blocks as usize];
        let mut longest = 0.0_f64;
        while let Some(part) = launches.next(&cost) {
            let mut took = 0.0;
            for block in (part.first_block..part.first_block + part.blocks).map(order) {
                assert_eq!(rendered[block as usize], part.first_sample, "samples are rendered in order");
                rendered[block as usize] = part.end_sample;
                took += ms(block) * f64::from(part.end_sample - part.first_sample);
            }
            assert_eq!(part.is_last, part.end_sample == samples);
            assert!((part.end_sample - part.first_sample).is_multiple_of(together));
            assert_eq!(part.first_sample / BATCH, (part.end_sample - 1) / BATCH, "a launch is in one batch");
            cost.observe(part, took);
            longest = longest.max(took);
        }
        assert!(rendered.iter().all(|&done| done == samples), "every sample of every block is rendered");
        longest
    }

    #[test]
    fn every_sample_is_rendered_once_and_in_order() {
        for (blocks, samples) in [(1, 1), (7, 65_536), (8_100, 4), (500_000, 1), (3_000, 1_000)] {
            assert!(longest_launch(blocks, samples, |_| 1e-5) <= 50.0);
        }
    }

    #[test]
    fn repeated_launches_render_every_sample_once_more_and_no_other() {
        let (blocks, samples) = (512, 40);
        let (mut launches, mut cost) = (Launches::new(blocks, 0..samples, ALL, 64, 1), CostModel::default());
        let mut rendered = vec![0; blocks as usize];
        let (mut turn, mut repeated) = (0_u32, 0);
        while let Some(part) = launches.next(&cost) {
            let own = part.first_block as usize..(part.first_block + part.blocks) as usize;
            assert!(rendered[own.clone()].iter().all(|&done| done == part.first_sample));
            cost.observe(part, 12.0);
            turn = turn.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            if turn >> 30 == 0 {
                // It asked for cells: its sums are those before it.
                repeated += 1;
                launches.repeat(part);
                continue;
            }
            rendered[own].fill(part.end_sample);
        }
        assert!(repeated > 10, "{repeated} launches were repeated");
        assert!(rendered.iter().all(|&done| done == samples));
    }

    #[test]
    fn a_picture_with_an_expensive_part_is_split_evenly() {
        let sky_then_fractal = |block: u32| if block < 30_000 { 2e-6 } else { 4e-5 };
        assert!(longest_launch(60_000, 256, sky_then_fractal) <= 50.0);
    }

    #[test]
    fn a_kernel_of_known_cost_needs_one_launch() {
        let mut cost = CostModel::default();
        cost.observe(
            LaunchRange {
                first_block: 0,
                blocks: 8_100,
                first_sample: 0,
                end_sample: 4,
                is_last: true,
                has_layers: true,
            },
            1.0,
        );
        let part = Launches::new(8_100, 0..4, ALL, 1056, 4).next(&cost).expect("there is work");
        assert_eq!((part.blocks, part.end_sample, part.is_last), (8_100, 4, true));
    }

    #[test]
    fn samples_of_an_instant_begin_where_those_of_the_one_before_ended() {
        let mut launches = Launches::new(64, 5..8, Ends { mean: false, layers: true }, 1000, 1);
        let part = launches.next(&CostModel::default()).expect("there is work");
        assert_eq!((part.first_sample, part.end_sample, part.is_last, part.has_layers), (5, 8, false, true));
        assert!(launches.next(&CostModel::default()).is_none());
    }

    #[test]
    fn tiles_are_consecutive_in_blocks_and_numbers() {
        let rects = [Rect { x: 0, y: 0, width: 33, height: 9 }, Rect { x: 64, y: 32, width: 32, height: 32 }];
        let LaunchLayout { tiles, blocks, .. } = lay_out(&whole(&rects, 5), BlockDim { columns: 16, rows: 8 });
        assert_eq!((tiles[0].columns, tiles[1].first_block, tiles[1].start), (3, 6, 33 * 9 * 5));
        assert_eq!(blocks, BLOCK_GROUP, "6 and 8 blocks are less than a group");
    }

    #[test]
    fn a_piece_is_stored_in_its_tile() {
        let tile = Rect { x: 64, y: 32, width: 33, height: 20 };
        let piece = Piece { rect: Rect { x: 72, y: 48, width: 16, height: 4 }, tile, start: 1000 };
        let laid_out = lay_out(&[piece], BlockDim { columns: 8, rows: 8 }).tiles[0];
        assert_eq!((laid_out.start, laid_out.pitch, laid_out.plane), (1000 + 16 * 33 + 8, 33, 660));
        assert_eq!((laid_out.x, laid_out.width, laid_out.columns), (72, 16, 2));
    }
}
