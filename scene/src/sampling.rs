//! Sampler: quasirandom numbers as a pure function of pixel, sample, frame and seed.
//!
//! Each pixel has a hashed start, and its samples step from there along the R2 sequence, so that any number of them is
//! spread evenly: Martin Roberts, "The unreasonable effectiveness of quasirandom sequences",
//! <https://extremelearning.com.au/unreasonable-effectiveness-of-quasirandom-sequences/>. Every other random decision
//! (a point of a light, a reflected direction) has its own pair of numbers, which steps along the square roots of two
//! primes, so that all pairs together are spread evenly: R. D. Richtmyer, "The evaluation of definite integrals, and a
//! quasi-Monte-Carlo method based on the properties of algebraic numbers", Los Alamos LA-1342, 1951. The hash is
//! pcg3d: Mark Jarzynski and Marc Olano, "Hash functions for GPU rendering", Journal of Computer Graphics Techniques
//! 9(3), 2020, <https://jcgt.org/published/0009/03/02/>.

use crate::real::{F32Bits, Real};

/// 2³² times the R2 sequence's steps, 1/ρ and 1/ρ² for the plastic number ρ.
const STEP_X: u32 = 0xc13f_a9a9;
const STEP_Y: u32 = 0x91e1_0da5;

/// 2³² times the fractions of the square roots of the first primes, two to a pair of numbers.
const RICHTMYER_STEPS: [(u32, u32); 16] = [
    (0x6a09_e667, 0xbb67_ae85),
    (0x3c6e_f372, 0xa54f_f53a),
    (0x510e_527f, 0x9b05_688c),
    (0x1f83_d9ab, 0x5be0_cd19),
    (0xcbbb_9d5d, 0x629a_292a),
    (0x9159_015a, 0x152f_ecd8),
    (0x6733_2667, 0x8eb4_4a87),
    (0xdb0c_2e0d, 0x47b5_481d),
    (0xae5f_9156, 0xcf6c_85d3),
    (0x2f73_477d, 0x6d18_26ca),
    (0x8b43_d457, 0xe360_b596),
    (0x1c45_6002, 0x6f19_6331),
    (0xd94e_beb1, 0x0cc4_a611),
    (0x261d_c1f2, 0x5815_a7be),
    (0x70b7_ed67, 0xa151_3c69),
    (0x44f9_3635, 0x720d_cdfd),
];

/// Key of a frame, the same for all its pixels.
pub fn frame_key(seed: u32, frame: u32) -> u32 {
    let mut key = seed.wrapping_mul(0x9e37_79b9) ^ frame.wrapping_mul(0x85eb_ca6b);
    key = (key ^ (key >> 16)).wrapping_mul(0x7feb_352d);
    key = (key ^ (key >> 15)).wrapping_mul(0x846c_a68b);
    key ^ (key >> 16)
}

/// Start of a pixel's sample sequence.
#[derive(Clone, Copy, Debug)]
pub struct PixelJitter<R: Real> {
    x: R::Bits,
    y: R::Bits,
}

impl<R: Real> PixelJitter<R> {
    /// Start for the pixel (`x`, `y`), integers below 2²³.
    pub fn new(x: R, y: R, frame_key: u32) -> Self {
        let [x, y, _] = pcg3d::<R>(to_u32(x), to_u32(y), x.uniform_bits(frame_key));
        Self { x, y }
    }

    /// Offset of a sample in the pixel, 0 to 1 excluding 1; the sample is an integer below 2²³.
    pub fn offset(self, sample: R) -> (R, R) {
        self.stepped(sample, (STEP_X, STEP_Y))
    }

    fn stepped(self, sample: R, (step_x, step_y): (u32, u32)) -> (R, R) {
        let sample = to_u32(sample);
        (to_unit_float(self.x + sample * step_x), to_unit_float(self.y + sample * step_y))
    }
}

/// Pairs of quasirandom numbers for one sample of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct Sampler<R> {
    /// Column of the pixel, an integer.
    pub x: R,
    /// Row of the pixel, an integer.
    pub y: R,
    /// Number of the sample, an integer.
    pub sample: R,
    /// Number of bounces so far, an integer.
    pub bounce: R,
    /// See [`frame_key`].
    pub frame_key: u32,
}

impl<R: Real> Sampler<R> {
    /// Two numbers, 0 to 1 excluding 1, for one dimension; each decision has its own dimension.
    pub fn get_2d(&self, dimension: u32) -> (R, R) {
        let key = frame_key(self.frame_key, dimension.wrapping_add(1));
        // Bounces offset the pixel by more than the width of any picture.
        let start = PixelJitter::new(self.bounce.mul_add(self.bounce.constant(65_536.0), self.x), self.y, key);
        start.stepped(self.sample, RICHTMYER_STEPS[dimension as usize % RICHTMYER_STEPS.len()])
    }
}

/// Dither thresholds, 0 to 1 excluding 1, for the red, green and blue of the pixel (`x`, `y`), integers below 2²³.
/// Neighboring pixels have different thresholds.
pub fn thresholds<R: Real>(x: R, y: R) -> [R; 3] {
    pcg3d::<R>(to_u32(x), to_u32(y), x.uniform_bits(0)).map(to_unit_float)
}

/// Three numbers, 0 to 1 excluding 1, that follow from a seed, an index and a dimension.
pub(crate) fn hashed_numbers(seed: u32, index: u32, dimension: u32) -> [f32; 3] {
    pcg3d::<f32>(F32Bits(seed), F32Bits(index), F32Bits(dimension)).map(to_unit_float)
}

/// The pcg3d hash of Jarzynski and Olano.
fn pcg3d<R: Real>(a: R::Bits, b: R::Bits, c: R::Bits) -> [R::Bits; 3] {
    let (mut a, mut b, mut c) = (lcg_step::<R>(a), lcg_step::<R>(b), lcg_step::<R>(c));
    for _ in 0..2 {
        a = a + b * c;
        b = b + c * a;
        c = c + a * b;
        (a, b, c) = (a ^ (a >> 16), b ^ (b >> 16), c ^ (c >> 16));
    }
    [a, b, c]
}

/// Converts a number with an integer value below 2²³ to an integer.
fn to_u32<R: Real>(number: R) -> R::Bits {
    (number + 8_388_608.0).to_bits() & 0x007f_ffff
}

/// One step of a linear congruential generator.
fn lcg_step<R: Real>(word: R::Bits) -> R::Bits {
    word * 1_664_525 + 1_013_904_223
}

/// Number from 0 to 1, excluding 1, from the upper 23 bits: combined with the exponent of 1, less 1.
fn to_unit_float<R: Real>(word: R::Bits) -> R {
    R::from_bits((word >> 9) | 0x3f80_0000) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_fill_the_pixel_evenly() {
        for (x, y) in [(0.0, 0.0), (17.0, 3.0), (4095.0, 2159.0_f32)] {
            let jitter = PixelJitter::new(x, y, frame_key(0, 0));
            let mut cells = [0; 16];
            for sample in 0..256 {
                let (jx, jy) = jitter.offset(sample as f32);
                assert!((0.0..1.0).contains(&jx) && (0.0..1.0).contains(&jy));
                cells[(jx * 4.0) as usize + 4 * (jy * 4.0) as usize] += 1;
            }
            assert!(cells.iter().all(|&n| (12..=20).contains(&n)), "{cells:?}");
        }
    }

    #[test]
    fn pairs_of_two_dimensions_are_spread_evenly_together() {
        let dice = |sample: f32| Sampler { x: 3.0, y: 5.0, sample, bounce: 0.0, frame_key: frame_key(0, 0) };
        for (one, other) in [(0, 1), (0, 5), (2, 7)] {
            let mut cells = [0; 256];
            for sample in 0..4096 {
                let ((a, b), (c, d)) = (dice(sample as f32).get_2d(one), dice(sample as f32).get_2d(other));
                let cell = [a, b, c, d].iter().fold(0, |cell, &u| 4 * cell + (u * 4.0) as usize);
                cells[cell] += 1;
            }
            assert!(cells.iter().all(|&n| (8..=26).contains(&n)), "{one} and {other}: {cells:?}");
        }
    }

    #[test]
    fn pixels_frames_and_seeds_differ() {
        let first = |x: f32, y: f32, key| PixelJitter::new(x, y, key).offset(0.0);
        let here = first(5.0, 7.0, frame_key(1, 2));
        assert_ne!(here, first(6.0, 7.0, frame_key(1, 2)));
        assert_ne!(here, first(5.0, 8.0, frame_key(1, 2)));
        assert_ne!(here, first(5.0, 7.0, frame_key(2, 1)));
        assert_eq!(here, first(5.0, 7.0, frame_key(1, 2)));
    }
}
