//! Where in a pixel its rays pass: a pure function of pixel, sample, frame and seed.
//!
//! Each pixel has a hashed start, and its samples step from there along the R2 sequence, so that
//! any number of them is spread evenly: Martin Roberts, "The unreasonable effectiveness of
//! quasirandom sequences", <https://extremelearning.com.au/unreasonable-effectiveness-of-quasirandom-sequences/>.
//! The hash is pcg3d: Mark Jarzynski and Marc Olano, "Hash functions for GPU rendering",
//! Journal of Computer Graphics Techniques 9(3), 2020, <https://jcgt.org/published/0009/03/02/>.

use crate::real::Real;

/// 2³² times the R2 sequence's steps, 1/ρ and 1/ρ² for the plastic number ρ.
const STEP_X: u32 = 0xc13f_a9a9;
const STEP_Y: u32 = 0x91e1_0da5;

/// One number for all pixels of a frame.
pub fn frame_key(seed: u32, frame: u32) -> u32 {
    let mut key = seed.wrapping_mul(0x9e37_79b9) ^ frame.wrapping_mul(0x85eb_ca6b);
    key = (key ^ (key >> 16)).wrapping_mul(0x7feb_352d);
    key = (key ^ (key >> 15)).wrapping_mul(0x846c_a68b);
    key ^ (key >> 16)
}

/// Where a pixel's samples start.
#[derive(Clone, Copy, Debug)]
pub struct Jitter<R: Real> {
    x: R::Bits,
    y: R::Bits,
}

impl<R: Real> Jitter<R> {
    /// Of the pixel (`x`, `y`), whole numbers below 2²³.
    #[inline(always)]
    pub fn new(x: R, y: R, frame_key: u32) -> Self {
        let (mut a, mut b) = (stir::<R>(whole(x)), stir::<R>(whole(y)));
        let mut c = stir::<R>(x.given_bits(frame_key));
        for _ in 0..2 {
            a = a + b * c;
            b = b + c * a;
            c = c + a * b;
            (a, b, c) = (a ^ (a >> 16), b ^ (b >> 16), c ^ (c >> 16));
        }
        Self { x: a, y: b }
    }

    /// The offset in the pixel, 0 to 1 without 1, of a sample: a whole number below 2²³.
    #[inline(always)]
    pub fn offset(self, sample: R) -> (R, R) {
        let sample = whole(sample);
        (unit(self.x + sample * STEP_X), unit(self.y + sample * STEP_Y))
    }
}

/// The integer of a whole number below 2²³.
#[inline(always)]
fn whole<R: Real>(number: R) -> R::Bits {
    (number + 8_388_608.0).to_bits() & 0x007f_ffff
}

/// One step of a linear congruential generator.
#[inline(always)]
fn stir<R: Real>(word: R::Bits) -> R::Bits {
    word * 1_664_525 + 1_013_904_223
}

/// A number from 0 to 1, without 1, from the upper 23 bits: put under the exponent of 1, less 1.
#[inline(always)]
fn unit<R: Real>(word: R::Bits) -> R {
    R::from_bits((word >> 9) | 0x3f80_0000) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_fill_the_pixel_evenly() {
        for (x, y) in [(0.0, 0.0), (17.0, 3.0), (4095.0, 2159.0_f32)] {
            let jitter = Jitter::new(x, y, frame_key(0, 0));
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
    fn pixels_frames_and_seeds_differ() {
        let first = |x: f32, y: f32, key| Jitter::new(x, y, key).offset(0.0);
        let here = first(5.0, 7.0, frame_key(1, 2));
        assert_ne!(here, first(6.0, 7.0, frame_key(1, 2)));
        assert_ne!(here, first(5.0, 8.0, frame_key(1, 2)));
        assert_ne!(here, first(5.0, 7.0, frame_key(2, 1)));
        assert_eq!(here, first(5.0, 7.0, frame_key(1, 2)));
    }
}
