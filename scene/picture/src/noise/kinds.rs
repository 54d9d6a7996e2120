//! The registry of noises: their parameters, and the formula of each.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use super::cellular::{Feature, cellular};
use super::gardner::{MAX_WAVES, MIN_WAVES, gardner};
use super::octaves::{Fractal, FractalSum, MAX_OCTAVES};
use super::{Basis, gradient};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Gain, Lacunarity, LengthOrZero, ScaleFactor, integer_in_range};

/// Defines the struct of each kind, with the common and its own parameters, and the enum of all kinds.
macro_rules! noises {
    ($(
        $(#[$doc:meta])* $Kind:ident { $($(#[$about:meta])* $field:ident: $Type:ty),* $(,)? }
    )*) => {
        $(
            $(#[$doc])*
            #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
            #[serde(deny_unknown_fields)]
            pub struct $Kind {
                $($(#[$about])* pub $field: $Type,)*
                /// Number of cells or waves per scene unit.
                #[serde(default = "default_scale")]
                pub scale: ScaleFactor,
                /// Seed: another seed gives another noise of this kind.
                #[serde(default, deserialize_with = "seed")]
                pub seed: u32,
                /// Number of summed octaves, each finer than the previous one.
                #[serde(default = "default_octaves", deserialize_with = "octaves")]
                #[schemars(range(min = 1, max = MAX_OCTAVES))]
                pub octaves: u32,
                /// Ratio of the frequencies of successive octaves.
                #[serde(default = "default_lacunarity")]
                pub lacunarity: Lacunarity,
                /// Ratio of the weights of successive octaves.
                #[serde(default = "default_gain")]
                pub gain: Gain,
                /// Contribution of each octave to the sum.
                #[serde(default)]
                pub fractal: Fractal,
                /// Distance by which the noise is shifted by another noise of its kind, in cells or waves of the
                /// noise.
                #[serde(default = "default_warp")]
                pub warp: LengthOrZero,
            }

            impl $Kind {
                /// Combination of its octaves.
                pub(super) fn layers(&self) -> FractalSum<'_> {
                    FractalSum {
                        scale: self.scale.in_frame(),
                        seed: self.seed,
                        octaves: self.octaves,
                        lacunarity: self.lacunarity.in_frame(),
                        gain: self.gain.in_frame(),
                        fractal: self.fractal,
                        warp: &self.warp,
                    }
                }
            }
        )*

        /// Pseudorandom values that vary smoothly over space: an object whose member is the noise's kind.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
        #[serde(rename_all = "snake_case")]
        pub enum Noise {
            $(#[doc = concat!("See [`", stringify!($Kind), "`].")] $Kind($Kind)),*
        }

        impl Noise {
            /// Minimum and maximum value.
            pub fn range(&self) -> (f32, f32) {
                match self {
                    $(Self::$Kind(noise) => noise.layers().range(noise)),*
                }
            }

            /// Its Lipschitz factor: |n(p) − n(q)| ≤ lipschitz · |p − q|, p and q in scene units.
            pub fn lipschitz(&self) -> f32 {
                match self {
                    $(Self::$Kind(noise) => noise.layers().lipschitz(noise)),*
                }
            }

            /// Another noise for each salt.
            pub(super) fn with_salt<R: Real>(&self, p: Vec3<R>, salt: u32) -> R {
                match self {
                        $(Self::$Kind(noise) => noise.layers().sum(noise, p, salt)),*
                    }
            }
        }
    };
}

noises! {
    /// Perlin's gradient noise: smooth hills and hollows, 0 at the corners of its cells.
    Perlin {}

    /// Value noise: random values at the corners of cells, interpolated smoothly; softer and blockier than Perlin's.
    Value {}

    /// Simplex noise: like Perlin's, on a lattice of tetrahedra that shows its axes less.
    Simplex {}

    /// Worley's cellular noise: distance to the nearest of points scattered one per cell.
    Cellular {
        /// Value computed from the distances to the nearest points.
        #[serde(default)]
        feature: Feature,
    }

    /// Gardner's noise: a product of two sums of sine waves that shift each other's phases; used for clouds and trees
    /// in 1985.
    Gardner {
        /// Number of waves in each sum.
        #[serde(default = "default_waves", deserialize_with = "waves")]
        #[schemars(range(min = MIN_WAVES, max = MAX_WAVES))]
        waves: u32,
    }
}

impl Basis for Perlin {
    const RANGE: (f32, f32) = (-1.036_354, 1.036_354);

    fn at<R: Real>(&self, p: Vec3<R>, seed: R) -> R {
        gradient::perlin(p, seed)
    }

    fn lipschitz(&self) -> f32 {
        gradient::PERLIN_LIPSCHITZ
    }
}

impl Basis for Value {
    const RANGE: (f32, f32) = (-1.0, 1.0);

    fn at<R: Real>(&self, p: Vec3<R>, seed: R) -> R {
        gradient::value(p, seed)
    }

    fn lipschitz(&self) -> f32 {
        gradient::VALUE_LIPSCHITZ
    }
}

impl Basis for Simplex {
    const RANGE: (f32, f32) = (-1.0, 1.0);

    fn at<R: Real>(&self, p: Vec3<R>, seed: R) -> R {
        gradient::simplex(p, seed)
    }

    fn lipschitz(&self) -> f32 {
        gradient::SIMPLEX_LIPSCHITZ
    }
}

impl Basis for Cellular {
    const RANGE: (f32, f32) = (0.0, 1.0);

    fn at<R: Real>(&self, p: Vec3<R>, seed: R) -> R {
        cellular(p, seed, self.feature)
    }

    fn lipschitz(&self) -> f32 {
        // A distance has the Lipschitz factor 1.
        match self.feature {
            Feature::F1 => 1.0,
            Feature::F2MinusF1 => 2.0,
        }
    }
}

impl Basis for Gardner {
    const RANGE: (f32, f32) = (0.0, 1.0);

    fn at<R: Real>(&self, p: Vec3<R>, seed: R) -> R {
        gardner(p, seed, self.waves)
    }

    fn lipschitz(&self) -> f32 {
        super::gardner::lipschitz(self.waves)
    }
}

fn default_scale() -> ScaleFactor {
    ScaleFactor::new(1.0).expect("1 is in range")
}

fn default_lacunarity() -> Lacunarity {
    Lacunarity::new(2.0).expect("2 is in range")
}

fn default_gain() -> Gain {
    Gain::new(0.5).expect("0.5 is in range")
}

fn default_warp() -> LengthOrZero {
    LengthOrZero::new(0.0).expect("0 is in range")
}

fn default_octaves() -> u32 {
    1
}

fn default_waves() -> u32 {
    5
}

fn seed<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 0, u32::MAX, "as a seed")
}

fn octaves<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 1, MAX_OCTAVES, "octaves")
}

fn waves<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, MIN_WAVES, MAX_WAVES, "waves")
}
