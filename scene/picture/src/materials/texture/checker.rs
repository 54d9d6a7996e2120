//! Alternating cubes or squares of two colors.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::wave::square_wave;
use super::{Pattern, default_colors};
use crate::materials::param::lerp_colors;
use crate::materials::{ColorParam, ShadingPoint};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Length, LengthOrZero};

/// Alternating cubes of two colors, or squares if only two axes are selected.
///
/// A flat face in a border between cubes shows both colors: remove its axis, or translate the cubes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Checker {
    /// Edge of a cube or square; corners are at multiples of it.
    pub cell: Length,
    /// The two colors.
    #[serde(default = "default_colors")]
    pub colors: [ColorParam; 2],
    /// Width of the transition at a border.
    #[serde(default = "default_softness")]
    pub softness: LengthOrZero,
    /// Axes along which colors change.
    #[serde(default)]
    pub axes: Axes,
}

/// Axes along which a pattern changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum Axes {
    /// All three: cubes.
    #[default]
    Xyz,
    /// Squares on the floor.
    Xz,
    /// Squares on a wall that faces z.
    Xy,
    /// Squares on a wall that faces x.
    Yz,
}

impl Checker {
    /// Parity of a coordinate's cell: 1 or −1, and in between on a border.
    fn parity<R: Real>(&self, x: R, seen: R) -> R {
        square_wave(x, self.cell.in_frame(), self.softness.in_frame(), seen)
    }
}

impl Pattern for Checker {
    const ALIASES: &'static [&'static str] = &["checkerboard", "chequer"];
    const EXAMPLE: &'static str = r##"{ "cell": 0.35, "colors": ["#2b3a55", "#e9e2d0"] }"##;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r##"{ "cell": 0.5, "softness": 0.2, "axes": "xz", "colors": ["#7a2330", "#f0c987"] }"##,
        r##"{ "cell": 0.6, "axes": "xy", "colors": ["#d9d4c7",
              { "checker": { "cell": 0.1, "axes": "xy", "colors": ["#3d6b66", "#9cc5b0"] } }] }"##,
        r##"{ "cell": 0.4, "axes": "yz", "colors": ["#444444", "#cc8844"] }"##,
    ];

    fn color<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        let p = place.local_point;
        let x = || self.parity(p.x, place.width_along(vec3(1.0, 0.0, 0.0)));
        let y = || self.parity(p.y, place.width_along(vec3(0.0, 1.0, 0.0)));
        let z = || self.parity(p.z, place.width_along(vec3(0.0, 0.0, 1.0)));
        let sides = match self.axes {
            Axes::Xyz => x() * y() * z(),
            Axes::Xz => x() * z(),
            Axes::Xy => x() * y(),
            Axes::Yz => y() * z(),
        };
        let (first, second) = (self.colors[0].at(place), self.colors[1].at(place));
        lerp_colors(first, second, sides.mul_add(sides.constant(-0.5), sides.constant(0.5)))
    }

    fn color_params(&self) -> Vec<&ColorParam> {
        self.colors.iter().collect()
    }

    fn looks_at_footprint(&self) -> bool {
        true
    }
}

pub(super) fn default_softness() -> LengthOrZero {
    LengthOrZero::new(0.0).expect("0 is in range")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::materials::texture::tests::at;

    #[test]
    fn colors_change_from_cube_to_cube() {
        let checker: Checker = serde_json::from_str(r#"{ "cell": 0.5 }"#).unwrap();
        let brightness = |x: f32, y: f32, z: f32| checker.color(&at(x, y, z)).x;
        assert_eq!(brightness(0.25, 0.25, 0.25), 0.0);
        assert_eq!(brightness(0.75, 0.25, 0.25), 1.0);
        assert_eq!(brightness(0.75, 0.75, 0.25), 0.0);
        assert_eq!(brightness(-0.25, 0.25, 0.25), 1.0);
        assert_eq!(brightness(1.25, 0.75, -0.25), 0.0);
    }

    #[test]
    fn a_soft_border_is_linear_over_its_width() {
        let checker: Checker = serde_json::from_str(r#"{ "cell": 1, "softness": 0.2, "axes": "xz" }"#).unwrap();
        let brightness = |x: f32| checker.color(&at(x, 7.3, 0.5)).x;
        for (x, want) in [(0.5, 0.0), (0.89, 0.0), (0.95, 0.25), (1.0, 0.5), (1.05, 0.75), (1.11, 1.0)] {
            assert!((brightness(x) - want).abs() < 1e-5, "{} at {x}", brightness(x));
        }
    }
}
