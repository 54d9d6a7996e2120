//! Textures from noise: plain, marble and wood.
//!
//! Bands bent by noise are Ken Perlin's marble ("An image synthesizer", SIGGRAPH 1985) and, as rings,
//! Darwyn Peachey's wood ("Solid texturing of complex surfaces", SIGGRAPH 1985).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::stripes::x_axis;
use super::wave::smooth_wave;
use super::{Pattern, Ramp};
use crate::materials::{ColorParam, ShadingPoint};
use crate::noise::Noise;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Direction, Length, LengthOrZero};

/// A noise mapped to a color ramp: 0 is the minimum of the noise, 1 its maximum.
///
/// Sums of octaves rarely come near the ends: put stops between 0.25 and 0.75 for strong colors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct NoiseRamp {
    /// The noise.
    pub noise: Noise,
    /// The colors.
    #[serde(default = "Ramp::black_to_white")]
    pub ramp: Ramp,
}

/// Bands of a color ramp, to its end and back, distorted by a noise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Marble {
    /// Direction across the bands; of any length.
    #[serde(default = "x_axis")]
    pub direction: Direction,
    /// Width of a band: from the ramp's start to its end and back.
    #[serde(default = "default_width")]
    pub width: Length,
    /// Shift of the bands by a noise value of 1, in bands.
    #[serde(default = "default_strength")]
    pub strength: LengthOrZero,
    /// The noise.
    #[serde(default = "default_marble_noise")]
    pub noise: Noise,
    /// The colors.
    #[serde(default = "default_marble_ramp")]
    pub ramp: Ramp,
}

/// Rings around an axis, distorted by a noise that is elongated along it: slowly through a color ramp, and fast back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Wood {
    /// Direction along the trunk, whose center passes through the origin; of any length.
    #[serde(default = "y_axis")]
    pub direction: Direction,
    /// Width of an annual ring.
    #[serde(default = "default_ring")]
    pub width: Length,
    /// Shift of the rings by a noise value of 1, in rings.
    #[serde(default = "default_strength")]
    pub strength: LengthOrZero,
    /// The noise.
    #[serde(default = "default_wood_noise")]
    pub noise: Noise,
    /// The colors, from a ring's earlywood to its latewood.
    #[serde(default = "default_wood_ramp")]
    pub ramp: Ramp,
}

/// Elongation of the wood noise along the trunk.
const GRAIN_STRETCH: f32 = 6.0;
/// Fraction of an annual ring that is earlywood.
const EARLYWOOD_FRACTION: f32 = 0.85;

impl Pattern for NoiseRamp {
    const EXAMPLE: &'static str = r##"{ "noise": { "perlin": { "scale": 2, "octaves": 5 } },
        "ramp": [[0.3, "#10243f"], [0.48, "#3d7ea6"], [0.5, "#e8d9a8"], [0.56, "#5f8a4a"], [0.7, "#f5f5f2"]] }"##;
    const MORE_EXAMPLES: &'static [&'static str] =
        &[r##"{ "noise": { "cellular": { "scale": 4, "feature": "f2_minus_f1" } },
              "ramp": [[0.02, "#1d1a16"], [0.12, { "noise": { "noise": { "simplex": { "scale": 6 } },
              "ramp": [[0.2, "#8a4b2a"], [0.8, "#d8a060"]] } }]] }"##];

    fn color<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        let (low, high) = self.noise.range();
        let value = self.noise.value(place.local_point);
        let share = (value - value.uniform(low)) * value.uniform(1.0 / (high - low));
        self.ramp.at(share, place)
    }

    fn color_params(&self) -> Vec<&ColorParam> {
        self.ramp.color_params().collect()
    }
}

impl Pattern for Marble {
    const EXAMPLE: &'static str = "{}";
    const MORE_EXAMPLES: &'static [&'static str] = &[r##"{ "direction": [1, 2, 0], "width": 0.5, "strength": 2,
        "noise": { "simplex": { "scale": 1.5, "octaves": 6 } },
        "ramp": [[0, "#0f2a22"], [0.6, "#1f5c46"], [0.92, "#7fb59a"], [1, "#e6f2ea"]] }"##];

    fn color<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        let across = place.local_point.dot_uniform(self.direction.unit());
        let shift = self.noise.value(place.local_point) * across.uniform(self.strength.get());
        let turns = across.mul_add(across.uniform(1.0 / self.width.get()), shift);
        self.ramp.at(smooth_wave(turns), place)
    }

    fn color_params(&self) -> Vec<&ColorParam> {
        self.ramp.color_params().collect()
    }
}

impl Pattern for Wood {
    const EXAMPLE: &'static str = "{}";
    const MORE_EXAMPLES: &'static [&'static str] =
        &[r##"{ "direction": [1, 0.15, 0.1], "width": 0.09, "strength": 2.5,
        "ramp": [[0, "#5b3420"], [1, "#25130c"]] }"##];

    fn color<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        let p = place.local_point;
        let axis = Vec3::uniform(p.x, self.direction.unit());
        let along = p.dot(axis);
        let radial = axis.mul_add(-along, p);
        let shift =
            self.noise.value(axis.mul_add(along * (1.0 / GRAIN_STRETCH), radial)) * p.x.uniform(self.strength.get());
        let turns = radial.length().mul_add(p.x.uniform(1.0 / self.width.get()), shift);
        let part = turns - turns.floor();
        let late = (part.constant(1.0) - part) * (1.0 / (1.0 - EARLYWOOD_FRACTION));
        self.ramp.at((part * (1.0 / EARLYWOOD_FRACTION)).min(late), place)
    }

    fn color_params(&self) -> Vec<&ColorParam> {
        self.ramp.color_params().collect()
    }
}

fn y_axis() -> Direction {
    serde_json::from_str("[0, 1, 0]").expect("a direction")
}

fn default_width() -> Length {
    Length::new(0.6).expect("a size in range")
}

fn default_ring() -> Length {
    Length::new(0.12).expect("a size in range")
}

fn default_strength() -> LengthOrZero {
    LengthOrZero::new(1.0).expect("1 is in range")
}

fn default_marble_noise() -> Noise {
    serde_json::from_str(r#"{ "perlin": { "scale": 1.6, "octaves": 6, "fractal": "turbulence" } }"#).expect("a noise")
}

fn default_marble_ramp() -> Ramp {
    serde_json::from_str(r##"[[0, "#3c3f4a"], [0.12, "#8b8f99"], [0.4, "#dedcd6"], [1, "#f4f2ee"]]"##).expect("a ramp")
}

fn default_wood_noise() -> Noise {
    serde_json::from_str(r#"{ "perlin": { "scale": 1.2, "octaves": 4 } }"#).expect("a noise")
}

fn default_wood_ramp() -> Ramp {
    serde_json::from_str(r##"[[0, "#d9a566"], [0.6, "#c48a4a"], [1, "#7a4520"]]"##).expect("a ramp")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::materials::texture::tests::at;

    #[test]
    fn marble_without_strength_is_straight_bands() {
        let text = r#"{ "strength": 0, "width": 2, "ramp": [[0, [0, 0, 0]], [1, [1, 1, 1]]] }"#;
        let marble: Marble = serde_json::from_str(text).unwrap();
        let brightness = |x: f32| marble.color(&at(x, 0.7, -0.3)).x;
        assert_eq!([brightness(0.0), brightness(0.5), brightness(1.0), brightness(2.0)], [0.0, 0.5, 1.0, 0.0]);
    }

    #[test]
    fn wood_without_strength_is_rings_around_its_axis() {
        let text = r#"{ "strength": 0, "width": 1, "ramp": [[0, [0, 0, 0]], [1, [1, 1, 1]]] }"#;
        let wood: Wood = serde_json::from_str(text).unwrap();
        let brightness = |x: f32, y: f32, z: f32| wood.color(&at(x, y, z)).x;
        assert!((brightness(0.3, 0.0, 0.4) - brightness(0.0, 9.0, 0.5)).abs() < 1e-6);
        assert!(brightness(0.8, 1.0, 0.0) > 0.9 && brightness(0.999, 1.0, 0.0) < 0.01);
    }

    #[test]
    fn the_range_of_a_noise_spans_its_ramp() {
        let text = r#"{ "noise": { "cellular": {} }, "ramp": [[0, [1, 0, 0]], [1, [0, 1, 0]]] }"#;
        let texture: NoiseRamp = serde_json::from_str(text).unwrap();
        let colors = (0..4_000).map(|i| texture.color(&at(i as f32 * 0.173, i as f32 * 0.041, 0.0)));
        let (mut least, mut greatest) = (1.0_f32, 0.0_f32);
        for color in colors {
            assert!((color.x + color.y - 1.0).abs() < 1e-6);
            (least, greatest) = (least.min(color.y), greatest.max(color.y));
        }
        assert!(least < 0.1 && greatest > 0.6, "{least} to {greatest}");
    }
}
