//! Noise: random numbers that change smoothly over space, for displaced shapes, textures and clouds.
//!
//! A noise is one kind of `Basis`, one to twelve octaves of which are summed. Each kind's range and
//! Lipschitz factor are proved where the factor stands; those of the sum follow from them in `Layers`.
//! It depends on the seed and the place alone, and has the same bits everywhere.

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
    /// Its least and greatest value.
    const RANGE: (f32, f32);

    /// Its value at `p`; `seed` is a seed of [`lattice::start`].
    fn at<R: Real>(&self, p: Vec3<R>, seed: R) -> R;

    /// Its Lipschitz factor.
    fn lipschitz(&self) -> f32;
}

impl Noise {
    /// The noise at `p`.
    #[inline(always)]
    pub fn value<R: Real>(&self, p: Vec3<R>) -> R {
        self.with_salt(p, 0)
    }

    /// Three noises at `p` that differ in their seed alone; each is in the noise's range.
    #[inline(always)]
    pub fn vector<R: Real>(&self, p: Vec3<R>) -> Vec3<R> {
        vec3(self.with_salt(p, 1), self.with_salt(p, 2), self.with_salt(p, 3))
    }
}
