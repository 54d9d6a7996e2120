//! Noise: pseudorandom values that vary smoothly over space, for displacement, textures and clouds.
//!
//! A noise is a sum of one to twelve octaves of one `Basis`. The range and the Lipschitz factor of each kind are
//! derived next to the factor; `FractalSum` derives the sum's from them. A noise depends on the seed and the
//! point alone, and is bit-identical in every arithmetic.

mod cellular;
mod gardner;
mod gradient;
mod kinds;
mod lattice;
mod octaves;

pub use cellular::Feature;
pub use kinds::{Cellular, Gardner, Noise, Perlin, Simplex, Value};
pub use octaves::Fractal;

use crate::real::{Real, Vec3, vec3};

/// One octave of a noise.
trait Basis {
    /// Minimum and maximum value.
    const RANGE: (f32, f32);

    /// Value at `p`; `seed` is an [`octave_seed`](lattice::octave_seed).
    fn at<R: Real>(&self, p: Vec3<R>, seed: R) -> R;

    /// Its Lipschitz factor.
    fn lipschitz(&self) -> f32;
}

impl Noise {
    /// The noise at `p`.
    pub fn value<R: Real>(&self, p: Vec3<R>) -> R {
        self.with_salt(p, 0)
    }

    /// Three noises at `p` that differ only in their seed; each is in the noise's range.
    pub fn vector<R: Real>(&self, p: Vec3<R>) -> Vec3<R> {
        vec3(self.with_salt(p, 1), self.with_salt(p, 2), self.with_salt(p, 3))
    }
}
