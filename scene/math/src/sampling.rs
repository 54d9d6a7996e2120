//! Sampler: quasirandom numbers as a pure function of pixel, sample, frame and seed.
//!
//! Every random decision of a sample (its place in the pixel, a point of a light, a scattered direction) has a *purpose*,
//! and takes a point of a two-dimensional Sobol' sequence that belongs to this purpose and bounce alone. The sequence is
//! shuffled and its points are scrambled, both by Owen's nested method, so that the points of any two purposes or bounces
//! are independent of each other, while one purpose's stay as evenly spread as Sobol's: Brent Burley, "Practical
//! hash-based Owen scrambling", Journal of Computer Graphics Techniques 9(4), 2020, <https://jcgt.org/published/0009/04/01/>.
//! Nested permutations are hashes in which a bit depends on higher bits only: Samuli Laine and Tero Karras, "Stratified
//! sampling for stochastic transparency", EGSR 2011, with the constants of Nathan Vegdahl, "Building a better LK hash",
//! 2021, <https://psychopath.io/post/2021_01_30_building_a_better_lk_hash>.
//!
//! Neighboring pixels take neighboring parts of one sequence, along a Z-order curve, so that their errors cancel: Abdalla
//! Ahmed and Peter Wonka, "Screen-space blue-noise diffusion of Monte Carlo sampling error via hierarchical ordering of
//! pixels", ACM Transactions on Graphics 39(6), 2020.

use crate::real::{F32Bits, Real};

/// Key of a frame, the same for all its pixels.
pub fn frame_key(seed: u32, frame: u32) -> u32 {
    let mut key = seed.wrapping_mul(0x9e37_79b9) ^ frame.wrapping_mul(0x85eb_ca6b);
    key = (key ^ (key >> 16)).wrapping_mul(0x7feb_352d);
    key = (key ^ (key >> 15)).wrapping_mul(0x846c_a68b);
    key ^ (key >> 16)
}

/// Pairs of quasirandom numbers for one sample of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct Sampler<R: Real> {
    /// Index of the sample in the sequences, its bits reversed.
    reversed_index: R::Bits,
    /// Part above 32 bits of the index of the pixel's first sample.
    overflow: R::Bits,
    /// Number of bounces so far, an integer.
    bounce: R,
    frame_key: u32,
}

/// The samplers of a pixel's samples.
#[derive(Clone, Copy, Debug)]
pub struct PixelSampler<R: Real> {
    /// Column and row.
    pixel: [R; 2],
    /// Index of the pixel's first sample.
    first: R::Bits,
    overflow: R::Bits,
    frame_key: u32,
}

impl<R: Real> PixelSampler<R> {
    /// Sampler of the pixel (`x`, `y`), integers below 2¹⁶, in a picture with up to `samples` of each pixel.
    pub fn new(x: R, y: R, samples: u32, frame_key: u32) -> Self {
        let index = interleaved::<R>(to_u32(x)) ^ (interleaved::<R>(to_u32(y)) << 1);
        let bits = samples.max(1).next_power_of_two().trailing_zeros();
        let overflow = if bits == 0 { x.uniform_bits(0) } else { index >> (32 - bits) };
        Self { pixel: [x, y], first: index << bits, overflow, frame_key }
    }

    /// Column and row of the pixel.
    pub fn pixel(&self) -> [R; 2] {
        self.pixel
    }

    /// Sampler of a sample, an integer below the number of samples.
    pub fn sample(&self, sample: R) -> Sampler<R> {
        let Self { first, overflow, frame_key, pixel: _ } = *self;
        let reversed_index = reversed::<R>(first ^ to_u32(sample));
        Sampler { reversed_index, overflow, bounce: sample.constant(0.0), frame_key }
    }
}

impl<R: Real> Sampler<R> {
    /// Sampler of the same sample after some bounces, an integer below 2²³.
    pub fn after(&self, bounce: R) -> Self {
        Self { bounce, ..*self }
    }

    /// The bounces before this one.
    pub fn bounce(&self) -> R {
        self.bounce
    }

    /// Two numbers, 0 to 1 excluding 1, for one purpose. The pairs of different purposes and bounces are independent.
    pub fn get_2d(&self, purpose: u32) -> (R, R) {
        let key = self.bounce.uniform_bits(frame_key(self.frame_key, purpose.wrapping_add(1)));
        let [order, first, second] = pcg3d::<R>(to_u32(self.bounce), self.overflow, key);
        let index = reversed::<R>(shuffled::<R>(self.reversed_index, order));
        // The first two dimensions of Sobol's sequence, their bits reversed, are the index and its transform by Pascal's
        // triangle modulo 2.
        let u = nested_permutation::<R>(index, first);
        let v = nested_permutation::<R>(times_pascal::<R>(index), second);
        (to_unit_float(reversed::<R>(u)), to_unit_float(reversed::<R>(v)))
    }
}

/// Dither thresholds, 0 to 1 excluding 1, for the red, green and blue of the pixel (`x`, `y`), integers below 2²³.
/// Neighboring pixels have different thresholds.
pub fn thresholds<R: Real>(x: R, y: R) -> [R; 3] {
    pcg3d::<R>(to_u32(x), to_u32(y), x.uniform_bits(0)).map(to_unit_float)
}

/// Three numbers, 0 to 1 excluding 1, that follow from a seed, an index and a dimension.
pub fn hashed_numbers(seed: u32, index: u32, dimension: u32) -> [f32; 3] {
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

/// A bijection in which each bit depends on itself and lower ones only: on a number with reversed bits, Owen's nested
/// permutation.
fn nested_permutation<R: Real>(word: R::Bits, seed: R::Bits) -> R::Bits {
    let word = word ^ (word * 0x3d20_adea);
    let word = (word + seed) * ((seed >> 16) | 1);
    let word = word ^ (word * 0x0552_6c56);
    word ^ (word * 0x53a2_2864)
}

/// A [`nested_permutation`] of indices. Orders decide which points of two purposes meet, so they need a stronger hash: one
/// of a single round leaves pairs with four times the usual deviation.
fn shuffled<R: Real>(word: R::Bits, seed: R::Bits) -> R::Bits {
    let word = nested_permutation::<R>(word, seed);
    let seed = (seed * 0x9e37_79b9) ^ (seed >> 15);
    let word = (word + seed) * ((seed >> 16) | 1);
    let word = word ^ (word * 0x6c50_b47c);
    word ^ (word * 0xb82f_1e52)
}

/// The word with its 32 bits in the opposite order.
fn reversed<R: Real>(word: R::Bits) -> R::Bits {
    let swapped = |word: R::Bits, by: u32, mask: u32| ((word >> by) & mask) ^ ((word & mask) << by);
    let word = swapped(word, 1, 0x5555_5555);
    let word = swapped(word, 2, 0x3333_3333);
    let word = swapped(word, 4, 0x0f0f_0f0f);
    let word = swapped(word, 8, 0x00ff_00ff);
    (word >> 16) ^ (word << 16)
}

/// Product modulo 2 with Pascal's triangle: bit k of the result is the sum of those bits j for which C(j, k) is odd, that
/// is, for which j has all bits that k has (Lucas' theorem).
fn times_pascal<R: Real>(word: R::Bits) -> R::Bits {
    let word = word ^ ((word >> 1) & 0x5555_5555);
    let word = word ^ ((word >> 2) & 0x3333_3333);
    let word = word ^ ((word >> 4) & 0x0f0f_0f0f);
    let word = word ^ ((word >> 8) & 0x00ff_00ff);
    word ^ (word >> 16)
}

/// The lower 16 bits of a word, with a 0 above each.
fn interleaved<R: Real>(word: R::Bits) -> R::Bits {
    let word = word & 0x0000_ffff;
    let word = (word ^ (word << 8)) & 0x00ff_00ff;
    let word = (word ^ (word << 4)) & 0x0f0f_0f0f;
    let word = (word ^ (word << 2)) & 0x3333_3333;
    (word ^ (word << 1)) & 0x5555_5555
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "expected values are computed by std's functions")]
mod tests {
    use std::f32::consts::PI;

    use super::*;

    /// Samples of the tests: many enough that points on a line show.
    const SAMPLES: u32 = 4096;

    fn samplers(x: f32, y: f32) -> impl Iterator<Item = Sampler<f32>> {
        let pixel = PixelSampler::new(x, y, SAMPLES, frame_key(0, 0));
        (0..SAMPLES).map(move |sample| pixel.sample(sample as f32))
    }

    #[test]
    fn samples_of_each_pixel_are_a_net() {
        for (x, y) in [(0.0, 0.0), (17.0, 3.0), (65_534.0, 40_000.0)] {
            for columns in [1, 8, 64, 512, 4096] {
                let rows = SAMPLES / columns;
                let mut cells = vec![0; SAMPLES as usize];
                for sampler in samplers(x, y) {
                    let (u, v) = sampler.get_2d(7);
                    assert!((0.0..1.0).contains(&u) && (0.0..1.0).contains(&v));
                    cells[(u * columns as f32) as usize + (columns as usize) * (v * rows as f32) as usize] += 1;
                }
                assert!(cells.iter().all(|&n| n == 1), "one sample in each of {columns} × {rows} parts");
            }
        }
    }

    #[test]
    fn samples_of_neighboring_pixels_are_a_net_together() {
        let mut cells = [0; 256];
        for pixel in 0..64 {
            let (x, y) = ((pixel % 8) as f32 + 24.0, (pixel / 8) as f32 + 40.0);
            let sampler = PixelSampler::new(x, y, 4, frame_key(3, 4));
            for sample in 0..4 {
                let (u, v) = sampler.sample(sample as f32).get_2d(1);
                cells[(u * 16.0) as usize + 16 * (v * 16.0) as usize] += 1;
            }
        }
        assert_eq!(cells, [1; 256]);
    }

    /// The error of an integral is that of independent numbers at most; points on lines never get there.
    #[test]
    fn no_two_purposes_or_bounces_are_correlated() {
        const PURPOSES: u32 = 24;
        const BOUNCES: u32 = 9;
        let streams: Vec<Vec<f32>> = (0..BOUNCES)
            .flat_map(|bounce| (0..PURPOSES).map(move |purpose| (bounce, purpose)))
            .flat_map(|(bounce, purpose)| {
                let pairs = samplers(5.0, 9.0).map(move |sampler| sampler.after(bounce as f32).get_2d(purpose));
                let (u, v): (Vec<f32>, Vec<f32>) = pairs.unzip();
                [u, v]
            })
            .collect();
        for (index, one) in streams.iter().enumerate() {
            for other in &streams[index + 1 - index % 2..] {
                if std::ptr::eq(one, other) {
                    continue;
                }
                let mut cells = [0_u32; 64];
                let (mut below, mut gaussian) = (0_u32, 0.0_f64);
                for (&u, &v) in one.iter().zip(other) {
                    cells[(u * 8.0) as usize + 8 * (v * 8.0) as usize] += 1;
                    below += u32::from(u + v < 1.0);
                    gaussian += f64::from((-((u - 0.5).powi(2) + (v - 0.5).powi(2)) * 8.0).exp());
                }
                // 64 expected in each. Two samples in succession are in opposite halves of both, so that the sum is 56 ± 20
                // with independent nested permutations, at most 250 in a hundred thousand. Points on lines give thousands.
                let chi_squared: f64 = cells.iter().map(|&n| (f64::from(n) - 64.0).powi(2) / 64.0).sum();
                assert!(chi_squared < 350.0, "{index}: {chi_squared} {cells:?}");
                let share = f64::from(below) / f64::from(SAMPLES);
                assert!((share - 0.5).abs() < 7.0 * 0.5 / f64::from(SAMPLES).sqrt(), "{index}: {share}");
                // π/8·erf(√2)².
                let (mean, wanted) = (gaussian / f64::from(SAMPLES), f64::from(PI) / 8.0 * 0.911_07);
                assert!((mean / wanted - 1.0).abs() < 0.06, "{index}: {mean} {wanted}");
            }
        }
    }

    #[test]
    fn integrals_over_two_bounces_converge() {
        let error_of = |samples: u32| {
            let pixels = (0..64).map(|pixel| {
                let sampler = PixelSampler::new(pixel as f32, 3.0, samples, frame_key(0, 0));
                let inside = (0..samples).filter(|&sample| {
                    let sampler = sampler.sample(sample as f32);
                    sampler.after(1.0).get_2d(0).0 * sampler.after(2.0).get_2d(0).0 < 0.25
                });
                // ∫ of [u·v < ¼] is ¼·(1 + ln 4).
                let wanted = 0.25 * (1.0 + 4.0_f64.ln());
                (inside.count() as f64 / f64::from(samples) / wanted - 1.0).powi(2)
            });
            (pixels.sum::<f64>() / 64.0).sqrt()
        };
        let (few, many) = (error_of(64), error_of(16_384));
        assert!(many < 0.01 && many < few / 12.0, "relative errors {few} and {many}");
    }

    #[test]
    fn pixels_frames_and_seeds_differ() {
        let first = |x: f32, y: f32, key| PixelSampler::new(x, y, 16, key).sample(0.0).get_2d(0);
        let here = first(5.0, 7.0, frame_key(1, 2));
        assert_ne!(here, first(6.0, 7.0, frame_key(1, 2)));
        assert_ne!(here, first(5.0, 8.0, frame_key(1, 2)));
        assert_ne!(here, first(5.0, 7.0, frame_key(2, 1)));
        assert_eq!(here, first(5.0, 7.0, frame_key(1, 2)));
        // Pixels whose indices agree in their lower 32 bits.
        let of_many = |x: f32| PixelSampler::new(x, 0.0, 65_536, 9).sample(0.0).get_2d(0);
        assert_ne!(of_many(1.0), of_many(257.0));
    }

    #[test]
    fn bits_are_reversed_and_interleaved() {
        for word in [0, 1, 0x8000_0001, 0x1234_5678, 0xdead_beef, u32::MAX] {
            assert_eq!(reversed::<f32>(F32Bits(word)).0, word.reverse_bits());
            let low = (0..16).fold(0, |sum, bit| sum | ((word >> bit) & 1) << (2 * bit));
            assert_eq!(interleaved::<f32>(F32Bits(word)).0, low);
            // The direction numbers of Sobol's second dimension: each is the last, xor half of it.
            let mut direction = 1_u32 << 31;
            let mut second = 0;
            for bit in 0..32 {
                second ^= if (word >> bit) & 1 == 1 { direction } else { 0 };
                direction ^= direction >> 1;
            }
            assert_eq!(times_pascal::<f32>(F32Bits(word)).0.reverse_bits(), second);
        }
    }
}
