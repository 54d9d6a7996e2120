//! The blocks of pixels that need more samples, between the rounds of a render.
//!
//! The host decides, by the code that also decides on CPUs.

use proto::Rect;
use rayon::prelude::*;
use scene::sample_count::BLOCK_PX;

use super::launches::{self, Piece};
use crate::rounds::{CHANNELS, Rounds, Sums, mean};

/// A tile with what the host adds to the sums of its pixels.
#[derive(Clone, Debug)]
pub(super) struct FinishedTile {
    tile: Rect,
    /// The number of samples of each block, row by row; 0 while the block is active.
    counts: Vec<u32>,
    /// Number of planes of sums, which come first.
    sum_channels: usize,
    /// The first plane of the sums of batches that have ended, if there are several.
    batches_plane: Option<usize>,
    /// Planes that the host writes, with their numbers.
    extras: Vec<(usize, Vec<f32>)>,
}

/// Blocks that may need more samples.
pub(super) struct ActiveBlocks<'a> {
    rules: Rounds<'a>,
    tiles: Vec<(Piece, FinishedTile)>,
    /// The sums of all samples but the last round's: the channels' planes of each tile.
    before: Vec<Vec<f32>>,
}

impl FinishedTile {
    fn columns(&self) -> u32 {
        self.tile.width.div_ceil(BLOCK_PX)
    }

    /// A block's pixels, in the tile.
    fn pixels(&self, block: u32) -> impl Iterator<Item = usize> {
        let Rect { width, height, .. } = self.tile;
        let (left, top) = (block % self.columns() * BLOCK_PX, block / self.columns() * BLOCK_PX);
        let rows = top..height.min(top + BLOCK_PX);
        rows.flat_map(move |y| (left..width.min(left + BLOCK_PX)).map(move |x| (y * width + x) as usize))
    }

    fn is_active(&self, block: u32) -> bool {
        self.counts[block as usize] == 0
    }

    /// Turns the planes of sums into the tile's planes.
    pub(super) fn finish(&self, planes: &mut [Vec<f32>]) {
        if let Some(first) = self.batches_plane {
            let (batch, batches) = planes.split_at_mut(first);
            batch.iter_mut().zip(batches).for_each(|(batch, batches)| add(batch, batches));
        }
        for (block, &count) in self.counts.iter().enumerate() {
            for pixel in self.pixels(block as u32) {
                for plane in &mut planes[..self.sum_channels] {
                    // A file must not distinguish zeros by their sign.
                    plane[pixel] = mean(count, plane[pixel]) + 0.0;
                }
            }
        }
        for (plane, numbers) in &self.extras {
            planes[*plane].copy_from_slice(numbers);
        }
    }

    /// The active blocks, with neighbors in a row joined.
    fn rects(&self) -> Vec<Rect> {
        if self.counts.iter().all(|&count| count == 0) {
            return vec![self.tile];
        }
        let mut rects: Vec<Rect> = Vec::new();
        for block in (0..self.counts.len() as u32).filter(|&block| self.is_active(block)) {
            let (left, top) = (block % self.columns() * BLOCK_PX, block / self.columns() * BLOCK_PX);
            let (x, y) = (self.tile.x + left, self.tile.y + top);
            let (width, height) = (BLOCK_PX.min(self.tile.width - left), BLOCK_PX.min(self.tile.height - top));
            match rects.last_mut().filter(|last| last.y == y && last.x + last.width == x) {
                Some(last) => last.width += width,
                None => rects.push(Rect { x, y, width, height }),
            }
        }
        rects
    }
}

impl<'a> ActiveBlocks<'a> {
    /// All blocks of some tiles, which are stored as [`launches::whole`] stores them.
    pub(super) fn new(rules: Rounds<'a>, tiles: &[Rect], planes: usize, batches_plane: Option<usize>) -> Self {
        let of_tile = |piece: Piece| {
            let Rect { width, height, .. } = piece.tile;
            let count = width.div_ceil(BLOCK_PX) * height.div_ceil(BLOCK_PX);
            let extra = |(plane, _)| (plane, vec![0.0; piece.tile.pixels() as usize]);
            let extras = rules.extras(2, [0.0; CHANNELS], [0.0; CHANNELS]).map(extra).collect();
            let (counts, sum_channels) = (vec![0; count as usize], rules.sum_channels());
            (piece, FinishedTile { tile: piece.tile, counts, sum_channels, batches_plane, extras })
        };
        let tiles: Vec<_> = launches::whole(tiles, planes).into_iter().map(of_tile).collect();
        let before = tiles.iter().map(|(piece, _)| vec![0.0; CHANNELS * piece.tile.pixels() as usize]).collect();
        Self { rules, tiles, before }
    }

    /// Ends a round, after which the active blocks have `count` samples, with these sums.
    pub(super) fn end_round(&mut self, round: usize, count: u32, sums: &[f32]) {
        let rules = self.rules;
        let tiles = self.tiles.par_iter_mut().zip(&mut self.before);
        tiles.for_each(|((piece, tile), before)| {
            let plane = piece.tile.pixels() as usize;
            let of_planes = |first: usize| &sums[piece.start as usize + first * plane..][..before.len()];
            let mut sums = of_planes(0).to_vec();
            if let Some(first) = tile.batches_plane {
                add(&mut sums, of_planes(first));
            }
            let of_pixel =
                |sums: &[f32], pixel: usize| -> Sums { std::array::from_fn(|channel| sums[channel * plane + pixel]) };
            for block in 0..tile.counts.len() as u32 {
                let both = |pixel: usize| (of_pixel(before, pixel), of_pixel(&sums, pixel));
                if !tile.is_active(block) || !rules.is_done(round, count, tile.pixels(block).map(both)) {
                    continue;
                }
                tile.counts[block as usize] = count;
                for pixel in tile.pixels(block).collect::<Vec<_>>() {
                    let (before, sum) = both(pixel);
                    for ((_, numbers), (_, number)) in tile.extras.iter_mut().zip(rules.extras(count, before, sum)) {
                        numbers[pixel] = number;
                    }
                }
            }
            *before = sums;
        });
    }

    /// The pixels of the active blocks.
    pub(super) fn pieces(&self) -> Vec<Piece> {
        let of_tile = |(piece, tile): &(Piece, FinishedTile)| {
            let piece = *piece;
            tile.rects().into_iter().map(move |rect| Piece { rect, ..piece })
        };
        self.tiles.iter().flat_map(of_tile).collect()
    }

    /// The tiles, once no block is active.
    pub(super) fn finish(self) -> Vec<FinishedTile> {
        self.tiles.into_iter().map(|(_, tile)| tile).collect()
    }
}

fn add(sums: &mut [f32], others: &[f32]) {
    sums.iter_mut().zip(others).for_each(|(sum, other)| *sum += other);
}

#[cfg(test)]
mod tests {
    use scene::ImageSpec;

    use super::*;

    const TILE: Rect = Rect { x: 64, y: 32, width: 33, height: 20 };

    #[test]
    fn blocks_of_a_row_are_joined() {
        let mut blocks = FinishedTile {
            tile: TILE,
            counts: vec![0; 15],
            sum_channels: CHANNELS,
            batches_plane: None,
            extras: Vec::new(),
        };
        assert_eq!(blocks.rects(), [TILE]);
        for done in [2, 5, 6, 7, 8, 9, 10] {
            blocks.counts[done] = 16;
        }
        let rect = |x, y, width, height| Rect { x, y, width, height };
        assert_eq!(blocks.rects(), [rect(64, 32, 16, 8), rect(88, 32, 9, 8), rect(72, 48, 25, 4)]);
        assert_eq!(blocks.pixels(14).collect::<Vec<_>>(), [16 * 33 + 32, 17 * 33 + 32, 18 * 33 + 32, 19 * 33 + 32]);
    }

    #[test]
    fn only_noisy_blocks_go_on() {
        let image = serde_json::json!({ "width": 200, "height": 100, "format": "exr", "layers": ["samples"], "denoise": true,
            "samples": { "adaptive": { "min": 4, "max": 8 } } });
        let image: ImageSpec = serde_json::from_value(image).expect("an image");
        let channels = image.film().rendered_channels().len();
        let rules = Rounds::of(&image).expect("it has rounds");
        let mut blocks = ActiveBlocks::new(rules, &[TILE], channels, None);
        let pixels = TILE.pixels() as usize;
        // The red of the first pixel of the tile differs between the halves of its samples.
        let sums = |of_first: f32, of_others: f32| {
            let mut sums = vec![of_others; channels * pixels];
            sums[0] = of_first;
            sums
        };
        blocks.end_round(0, 2, &sums(2.0, 1.0));
        assert_eq!(blocks.pieces().len(), 1);
        blocks.end_round(1, 4, &sums(2.0, 2.0));
        let pieces = blocks.pieces();
        assert_eq!(pieces.iter().map(|piece| piece.rect).collect::<Vec<_>>(), [Rect { width: 8, height: 8, ..TILE }]);
        blocks.end_round(2, 8, &sums(9.0, 4.0));
        assert!(blocks.pieces().is_empty());
        let [finished] = &blocks.finish()[..] else { panic!("one tile") };
        let mut planes = vec![vec![8.0; pixels]; channels];
        finished.finish(&mut planes);
        let last = pixels - 1;
        let [samples, _] = image.film().samples_planes();
        let samples = samples.expect("it has the layer");
        assert_eq!((planes[0][0], planes[samples][0]), (1.0, 8.0));
        assert_eq!((planes[3][last], planes[samples][last]), (2.0, 4.0));
        // The means of the first pixel's halves are (2 + 2 + 2)/3/4 and (7 + 2 + 2)/3/4.
        let errors = &planes[image.film().error_plane().expect("it is denoised")];
        assert!((errors[0] - 5.0 / 3.0 / 4.0 / 2.0).abs() < 1e-6 && errors[last] == 0.0, "{}", errors[0]);
    }
}
