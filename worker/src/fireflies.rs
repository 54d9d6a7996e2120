//! Fireflies: light of few samples that are much brighter than others around them counts less, after Tobias Zirr, Johannes
//! Hanika and Carsten Dachsbacher, "Re-weighting firefly samples for improved finite-sample Monte Carlo estimates", Computer
//! Graphics Forum 37(6), 2018.
//!
//! A level's light over its brightness is the number of samples that it comes from. A pixel's light of a level counts as
//! far as its neighborhood has samples of that level and the two beside it: a single one proves nothing. The more samples
//! a pixel has, the more are of every level, and the picture approaches that of all light.
//!
//! A pixel depends on its direct neighbors and on nothing else, and on IEEE-754 arithmetic in a fixed order.

use rayon::prelude::*;
use scene::film::BRIGHTNESS_LEVELS;
use scene::integrator::{LEAST_BRIGHTNESS, LEVEL_RATIO};

/// Distance to the farthest pixel that a pixel depends on, in pixels.
pub(crate) const MARGIN_PX: u32 = 1;
/// Samples beyond the first one for which all light of a level counts.
const TRUSTED_SAMPLES: f32 = 32.0;

/// A rectangle of pixels to reweight, as planes of `width` numbers a row.
#[derive(Clone, Debug)]
pub(crate) struct Region<'a> {
    pub(crate) width: usize,
    /// Light, linear.
    pub(crate) color: &'a [Vec<f32>; 3],
    /// The part of the light in each level above level 0: red, green and blue of each.
    pub(crate) levels: &'a [Vec<f32>],
    /// Number of samples of each pixel.
    pub(crate) counts: &'a [f32],
}

impl Region<'_> {
    /// The light of the region without the fireflies'. Pixels nearer than [`MARGIN_PX`] to its edge belong to the
    /// picture only if that edge is the picture's.
    pub(crate) fn reweighted(&self) -> [Vec<f32>; 3] {
        let pixels = self.counts.len();
        let samples: Vec<[f32; BRIGHTNESS_LEVELS + 1]> =
            (0..pixels).into_par_iter().map(|pixel| self.samples_of_levels(pixel)).collect();
        let light: Vec<[f32; 3]> =
            (0..pixels).into_par_iter().map(|pixel| self.light(pixel, &self.samples_around(pixel, &samples))).collect();
        std::array::from_fn(|channel| light.iter().map(|color| color[channel]).collect())
    }

    /// Light of a pixel in a level, in level 0 what is left by the others.
    fn light_of_level(&self, pixel: usize, level: usize) -> [f32; 3] {
        std::array::from_fn(|channel| {
            let stored = |level: usize| self.levels[3 * (level - 1) + channel][pixel];
            if level > 0 {
                return stored(level);
            }
            (1..=BRIGHTNESS_LEVELS).fold(self.color[channel][pixel], |rest, level| rest - stored(level)).max(0.0)
        })
    }

    /// Number of samples of a pixel in each level.
    fn samples_of_levels(&self, pixel: usize) -> [f32; BRIGHTNESS_LEVELS + 1] {
        let mut limit = LEAST_BRIGHTNESS;
        std::array::from_fn(|level| {
            let [red, green, blue] = self.light_of_level(pixel, level);
            let samples = red.max(green).max(blue) * self.counts[pixel] / limit;
            limit *= LEVEL_RATIO;
            samples
        })
    }

    /// Number of samples in each level of a pixel and its neighbors.
    fn samples_around(&self, pixel: usize, samples: &[[f32; BRIGHTNESS_LEVELS + 1]]) -> [f32; BRIGHTNESS_LEVELS + 1] {
        let (width, height) = (self.width, samples.len() / self.width);
        let (x, y) = (pixel % width, pixel / width);
        let mut sums = [0.0; BRIGHTNESS_LEVELS + 1];
        for row in y.saturating_sub(1)..height.min(y + 2) {
            for of_pixel in &samples[row * width + x.saturating_sub(1)..row * width + width.min(x + 2)] {
                sums.iter_mut().zip(of_pixel).for_each(|(sum, own)| *sum += own);
            }
        }
        sums
    }

    /// Light of a pixel whose neighborhood has these samples.
    fn light(&self, pixel: usize, around: &[f32; BRIGHTNESS_LEVELS + 1]) -> [f32; 3] {
        let mut sum = self.light_of_level(pixel, 0);
        for level in 1..=BRIGHTNESS_LEVELS {
            let above = around.get(level + 1).copied().unwrap_or(0.0);
            let others = around[level - 1] + around[level] + above - 1.0;
            let weight = (others * (1.0 / TRUSTED_SAMPLES)).clamp(0.0, 1.0);
            let light = self.light_of_level(pixel, level);
            sum.iter_mut().zip(light).for_each(|(sum, light)| *sum += weight * light);
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::{BRIGHTNESS_LEVELS, Region};

    const WIDTH: usize = 12;
    const HEIGHT: usize = 10;
    const PIXELS: usize = WIDTH * HEIGHT;

    /// Even light, as `counts` samples of brightness 1/16 and, in some pixels, a number of samples of brightness 64.
    struct Picture {
        color: [Vec<f32>; 3],
        levels: Vec<Vec<f32>>,
        counts: Vec<f32>,
    }

    impl Picture {
        fn new(count: f32, bright: impl Fn(usize, usize) -> f32) -> Self {
            let of_bright: Vec<f32> =
                (0..PIXELS).map(|pixel| 64.0 * bright(pixel % WIDTH, pixel / WIDTH) / count).collect();
            let color = std::array::from_fn(|_| of_bright.iter().map(|light| light + 1.0 / 16.0).collect());
            let mut levels = vec![vec![0.0; PIXELS]; 3 * BRIGHTNESS_LEVELS];
            // 64 is the brightness of level 3.
            levels[6..9].fill(of_bright);
            Self { color, levels, counts: vec![count; PIXELS] }
        }

        fn reweighted(&self) -> Vec<f32> {
            let Self { color, levels, counts } = self;
            let [red, ..] = Region { width: WIDTH, color, levels, counts }.reweighted();
            red
        }
    }

    #[test]
    fn a_single_bright_sample_goes_and_the_rest_stays() {
        let is_alone = |x: usize, y: usize| f32::from(u8::from((x, y) == (5, 5)));
        let light = Picture::new(64.0, is_alone).reweighted();
        assert!(light.iter().all(|light| (light - 1.0 / 16.0).abs() < 1e-6), "{light:?}");
    }

    #[test]
    fn light_of_many_samples_stays() {
        // Few samples of each pixel of a part of the picture, as of a bright edge.
        let picture = Picture::new(64.0, |x, y| if x < 2 && y < 4 { 8.0 } else { 0.0 });
        let light = picture.reweighted();
        for y in 1..3 {
            assert_eq!(light[y * WIDTH], picture.color[0][y * WIDTH], "row {y}");
        }
        // And what a pixel has enough of by itself.
        let picture = Picture::new(4096.0, |x, y| if (x, y) == (5, 5) { 40.0 } else { 0.0 });
        assert_eq!(picture.reweighted()[5 * WIDTH + 5], picture.color[0][5 * WIDTH + 5]);
    }

    #[test]
    fn a_pixel_depends_on_its_neighbors_alone() {
        let bright = |x: usize, y: usize| ((x * 7 + y * 5) % 3) as f32 * 0.5;
        let want = Picture::new(16.0, bright).reweighted();
        let other = Picture::new(16.0, |x, y| if x < 9 { bright(x, y) } else { 20.0 }).reweighted();
        for pixel in (0..PIXELS).filter(|pixel| pixel % WIDTH < 8) {
            assert_eq!(want[pixel].to_bits(), other[pixel].to_bits(), "pixel {pixel}");
        }
        assert_ne!(want[8], other[8]);
    }
}
