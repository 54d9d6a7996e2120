//! Stripes of two colors.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::checker::default_softness;
use super::wave::square_wave;
use super::{Pattern, default_colors};
use crate::materials::param::lerp_colors;
use crate::materials::{ColorParam, ShadingPoint};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Direction, Length, LengthOrZero};

/// Flat layers of two alternating colors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Stripes {
    /// Direction across the stripes; of any length.
    #[serde(default = "x_axis")]
    pub direction: Direction,
    /// Width of one stripe; one starts at the origin.
    pub width: Length,
    /// The two colors.
    #[serde(default = "default_colors")]
    pub colors: [ColorParam; 2],
    /// Width of the transition at a border.
    #[serde(default = "default_softness")]
    pub softness: LengthOrZero,
}

impl Pattern for Stripes {
    const EXAMPLE: &'static str = r##"{ "direction": [1, 1, 0], "width": 0.15, "colors": ["#b8322a", "#f3ead8"] }"##;
    const MORE_EXAMPLES: &'static [&'static str] =
        &[r##"{ "direction": [0, 1, 0], "width": 0.25, "softness": 0.25, "colors": ["#16324f",
              { "stripes": { "width": 0.04, "colors": ["#e8b04a", "#d97f2b"] } }] }"##];

    fn color<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        let along = place.local_point.dot_uniform(self.direction.unit());
        let seen = place.width_along(self.direction.unit());
        let wave = square_wave(along, self.width.in_frame(), self.softness.in_frame(), seen);
        let share = wave.mul_add(along.constant(0.5), along.constant(0.5));
        lerp_colors(self.colors[1].at(place), self.colors[0].at(place), share)
    }

    fn color_params(&self) -> Vec<&ColorParam> {
        self.colors.iter().collect()
    }

    fn looks_at_footprint(&self) -> bool {
        true
    }
}

pub(super) fn x_axis() -> Direction {
    serde_json::from_str("[1, 0, 0]").expect("a direction")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::materials::texture::tests::at;

    #[test]
    fn the_first_stripe_starts_at_the_origin() {
        let stripes: Stripes = serde_json::from_str(r#"{ "width": 0.5, "colors": [[1, 0, 0], [0, 1, 0]] }"#).unwrap();
        let red = |x: f32| stripes.color(&at(x, 3.0, -2.0)).x;
        assert_eq!([red(0.1), red(0.4), red(0.6), red(0.9), red(1.1), red(-0.1)], [1.0, 1.0, 0.0, 0.0, 1.0, 0.0]);
    }
}
