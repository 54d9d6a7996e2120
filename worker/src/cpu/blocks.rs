//! Blocks of pixels whose samples are taken in rounds, after which they may be done.

use std::ops::Range;

use scene::sample_count::{BATCH, BLOCK_PX, within_batches};

use super::kernels::Thread;
use super::packets::{Band, SAMPLES_PER_RUN, end_batch};
use crate::picture_tape::{ACCUMULATE, LAYERS};
use crate::rounds::{CHANNELS, Rounds, Sums, mean};

const EDGE: usize = BLOCK_PX as usize;

/// Columns of the blocks that are rendered together, so that their pixels fill a packet.
pub(super) fn columns(lanes: usize) -> usize {
    lanes.div_ceil(EDGE * EDGE) * EDGE
}

/// Pixels with the same number of samples.
struct Block {
    pixels: Vec<Pixel>,
    samples: u32,
}

/// A pixel of a band.
struct Pixel {
    x: usize,
    y: usize,
    /// Sums of the samples of all rounds but the last.
    before: Sums,
    /// Sums of all batches that have ended, and of the one that has not.
    batches: Vec<f32>,
    batch: Vec<f32>,
}

impl Pixel {
    /// Sums of all samples, with the sums of the parts of light.
    fn sums(&self) -> impl Iterator<Item = f32> {
        self.batches.iter().zip(&self.batch).map(|(batches, batch)| batches + batch)
    }

    /// Sums of all samples.
    fn sum(&self) -> Sums {
        std::array::from_fn(|channel| self.batches[channel] + self.batch[channel])
    }
}

impl Band<'_, '_> {
    /// Renders the blocks that start in `column` of the band, which is as high as a block.
    pub(super) fn blocks(&mut self, thread: &mut Thread<'_>, lanes: usize, column: usize, rules: &Rounds<'_>) {
        let mut blocks = self.empty_blocks(column, lanes);
        let mut active: Vec<&mut Block> = blocks.iter_mut().collect();
        for (index, round) in self.samples.iter().enumerate() {
            let mut pixels: Vec<&mut Pixel> = active.iter_mut().flat_map(|block| &mut block.pixels).collect();
            for pixel in &mut pixels {
                pixel.before = pixel.sum();
            }
            for (instant, samples) in round.iter().enumerate() {
                for run in within_batches(samples.clone(), SAMPLES_PER_RUN) {
                    for packet in pixels.chunks_mut(lanes) {
                        self.accumulate(thread, lanes, &run, instant, packet);
                        self.progress.add(packet.len() as u64 * run.len() as u64);
                    }
                }
            }
            let count = round.last().map_or(0, |samples| samples.end);
            active.retain_mut(|block| {
                block.samples = count;
                let is_done = rules.is_done(index, count, block.pixels.iter().map(|pixel| (pixel.before, pixel.sum())));
                if is_done {
                    // The samples that it does not need.
                    self.progress.add(block.pixels.len() as u64 * u64::from(rules.max_samples() - count));
                }
                !is_done
            });
        }
        self.store(thread, lanes, &blocks, rules);
    }

    /// The blocks that start in `column` of the band.
    fn empty_blocks(&self, column: usize, lanes: usize) -> Vec<Block> {
        let end = self.width.min(column + columns(lanes));
        let block = |left: usize| {
            let pixels = (0..self.rows()).flat_map(|y| (left..end.min(left + EDGE)).map(move |x| (x, y)));
            let pixel = |(x, y)| Pixel {
                x,
                y,
                before: [0.0; CHANNELS],
                batches: vec![0.0; self.sum_channels],
                batch: vec![0.0; self.sum_channels],
            };
            let pixels = pixels.map(pixel);
            Block { pixels: pixels.collect(), samples: 0 }
        };
        (column..end).step_by(EDGE).map(block).collect()
    }

    /// Adds samples to the pixels of a packet.
    fn accumulate(
        &self,
        thread: &mut Thread<'_>,
        lanes: usize,
        samples: &Range<u32>,
        instant: usize,
        packet: &mut [&mut Pixel],
    ) {
        let mut arguments = vec![0.0; (4 + self.sum_channels) * lanes];
        let mut sums = vec![0.0; self.sum_channels * lanes];
        for lane in 0..lanes {
            // Lanes beyond the last pixel repeat it.
            let pixel = &packet[lane.min(packet.len() - 1)];
            let [x, y] = self.position(pixel);
            let place = [x, y, samples.start as f32, samples.end as f32];
            let numbers = place.iter().chain(&pixel.batch).copied();
            for (row, number) in numbers.enumerate() {
                arguments[row * lanes + lane] = number;
            }
        }
        thread.run(instant, ACCUMULATE, self.cancel, &arguments, &mut sums);
        for (lane, pixel) in packet.iter_mut().enumerate() {
            let of_lane = sums.iter().skip(lane).step_by(lanes);
            pixel.batch.iter_mut().zip(of_lane).for_each(|(to, sum)| *to = *sum);
            if samples.end.is_multiple_of(BATCH) {
                end_batch(&mut pixel.batches, &mut pixel.batch);
            }
        }
    }

    /// Stores the pixels of blocks that are done, and their layers.
    fn store(&mut self, thread: &mut Thread<'_>, lanes: usize, blocks: &[Block], rules: &Rounds<'_>) {
        let pixels: Vec<(&Pixel, u32)> =
            blocks.iter().flat_map(|block| block.pixels.iter().map(|pixel| (pixel, block.samples))).collect();
        for packet in pixels.chunks(lanes) {
            let mut layers = vec![0.0; (self.planes.len() - self.sum_channels) * lanes];
            if !layers.is_empty() {
                let mut arguments = vec![0.0; 2 * lanes];
                for lane in 0..lanes {
                    let [x, y] = self.position(packet[lane.min(packet.len() - 1)].0);
                    (arguments[lane], arguments[lanes + lane]) = (x, y);
                }
                thread.run(self.last_instant(), LAYERS, self.cancel, &arguments, &mut layers);
            }
            for (lane, &(pixel, samples)) in packet.iter().enumerate() {
                let place = pixel.y * self.width + pixel.x;
                let light = pixel.sums().map(|sum| mean(samples, sum));
                let layers = layers.iter().skip(lane).step_by(lanes).copied();
                for (plane, value) in self.planes.iter_mut().zip(light.chain(layers)) {
                    // A file must not distinguish zeros by their sign.
                    plane[place] = value + 0.0;
                }
                for (plane, value) in rules.extras(samples, pixel.before, pixel.sum()) {
                    self.planes[plane][place] = value;
                }
            }
        }
    }

    /// Column and row of a pixel in the picture.
    fn position(&self, pixel: &Pixel) -> [f32; 2] {
        [(self.left as usize + pixel.x) as f32, (self.top as usize + pixel.y) as f32]
    }
}
