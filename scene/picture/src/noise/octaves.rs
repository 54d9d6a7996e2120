//! Sums of a noise's octaves: F. Kenton Musgrave's fractal sums (Ebert et al., "Texturing and Modeling: A Procedural
//! Approach", 3rd edition, 2003, chapter 16), and domain warping (Inigo Quilez,
//! <https://iquilezles.org/articles/warp/>).
//!
//! The weights of the octaves are 1, gain, gain² … over their sum, so the range does not grow with their number.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Basis;
use super::lattice::octave_seed;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::LengthOrZero;

/// Maximum number of octaves of a noise.
pub(super) const MAX_OCTAVES: u32 = 12;
/// Salt by which the seeds of an octave and of the warp differ.
const WARP_SALT: u32 = 8;

/// Contribution of each octave to the sum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum Fractal {
    /// The noise unchanged: fractional Brownian motion.
    #[default]
    Fbm,
    /// Distance of the noise from the center of its range, 0 to 1: creases where it crosses the center.
    Turbulence,
    /// 1 minus that: sharp ridges there.
    Ridged,
}

/// Combination of a noise's octaves.
#[derive(Clone, Copy, Debug)]
pub(super) struct FractalSum<'a> {
    pub(super) scale: f32,
    pub(super) seed: u32,
    pub(super) octaves: u32,
    pub(super) lacunarity: f32,
    pub(super) gain: f32,
    pub(super) fractal: Fractal,
    pub(super) warp: &'a LengthOrZero,
}

/// One octave: its frequency relative to the first, and its weight in the sum.
struct Octave {
    frequency: f32,
    weight: f32,
    seed: u32,
}

impl FractalSum<'_> {
    /// The octaves, coarsest first.
    fn octaves(self, salt: u32) -> impl Iterator<Item = Octave> {
        let mut sum = 0.0;
        let mut weight = 1.0;
        for _ in 0..self.octaves {
            sum += weight;
            weight *= self.gain;
        }
        let first = Octave { frequency: 1.0, weight: 1.0 / sum, seed: salt << 8 };
        std::iter::successors(Some(first), move |octave| {
            Some(Octave {
                frequency: octave.frequency * self.lacunarity,
                weight: octave.weight * self.gain,
                seed: octave.seed + 1,
            })
        })
        .take(self.octaves as usize)
    }

    /// The sum at `p`.
    pub(super) fn sum<R: Real, B: Basis>(self, basis: &B, p: Vec3<R>, salt: u32) -> R {
        let like = p.x;
        let (low, high) = B::RANGE;
        let mut p = p * like.uniform(self.scale);
        if !self.warp.is_zero() {
            let [x, y, z] = [1, 2, 3]
                .map(|axis| octave_at(self.seed, (salt + WARP_SALT + axis) << 8, 1.0, basis, p) - (low + high) * 0.5);
            p = vec3(x, y, z).mul_add(like.uniform(self.warp.get()), p);
        }
        let mut sum = like.constant(0.0);
        for Octave { frequency, weight, seed } in self.octaves(salt) {
            let noise = octave_at(self.seed, seed, frequency, basis, p);
            let term = match self.fractal {
                Fractal::Fbm => noise,
                Fractal::Turbulence => normalized_deviation::<R, B>(noise),
                Fractal::Ridged => like.constant(1.0) - normalized_deviation::<R, B>(noise),
            };
            sum = term.mul_add(like.uniform(weight), sum);
        }
        // The result stays in range to the last bit, even for an interval in which a cell's random hashes are unknown.
        let (low, high) = self.range(basis);
        sum.at_least(low).at_most(high)
    }

    /// Minimum and maximum of the sum.
    pub(super) fn range<B: Basis>(self, _: &B) -> (f32, f32) {
        match self.fractal {
            Fractal::Fbm => B::RANGE,
            Fractal::Turbulence | Fractal::Ridged => (0.0, 1.0),
        }
    }

    /// The sum's Lipschitz factor: each octave's is that of the basis times its frequency and weight. The warp adds
    /// three noises of one octave, whose Jacobian has a norm of at most √3 times their factor.
    pub(super) fn lipschitz<B: Basis>(self, basis: &B) -> f32 {
        // More than all rounding errors add.
        const MARGIN: f32 = 1.000_1;
        let (low, high) = B::RANGE;
        let folded = match self.fractal {
            Fractal::Fbm => 1.0,
            Fractal::Turbulence | Fractal::Ridged => 2.0 / (high - low),
        };
        let of_octaves: f32 = self.octaves(0).map(|octave| octave.frequency * octave.weight).sum();
        let warped = 1.0 + self.warp.in_frame() * Real::sqrt(3.0_f32) * basis.lipschitz();
        basis.lipschitz() * folded * of_octaves * warped * self.scale * MARGIN
    }
}

/// Distance of a noise from the center of its range, 0 to 1.
fn normalized_deviation<R: Real, B: Basis>(noise: R) -> R {
    let (low, high) = B::RANGE;
    noise.mul_add(noise.constant(2.0 / (high - low)), noise.constant((low + high) / (low - high))).abs()
}

/// One octave, with its own seed and offset.
fn octave_at<R: Real, B: Basis>(seed: u32, salt: u32, frequency: f32, basis: &B, p: Vec3<R>) -> R {
    let like = p.x;
    let (seed, offset) = octave_seed(seed, salt);
    basis.at(p.mul_add(like.uniform(frequency), Vec3::uniform(like, offset)), like.uniform(seed))
}
