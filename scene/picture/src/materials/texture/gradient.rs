//! A color ramp by position, normal, distance or view angle.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Pattern, Ramp};
use crate::materials::{ColorParam, ShadingPoint};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Direction, LengthOrZero, Point};

/// A color ramp by position, normal, distance or view angle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Gradient {
    /// Quantity that decides the position on the ramp.
    pub by: GradientBy,
    /// The colors.
    #[serde(default = "Ramp::black_to_white")]
    pub ramp: Ramp,
}

/// Quantity that a gradient follows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum GradientBy {
    /// Position between two points.
    Position {
        /// Point where the ramp starts.
        from: Point,
        /// Point where it ends.
        to: Point,
    },
    /// The distance from a point.
    Radius {
        /// The point.
        #[serde(default = "default_center")]
        center: Point,
        /// Distance where the ramp starts.
        #[serde(default = "default_from")]
        from: LengthOrZero,
        /// Distance where it ends.
        to: LengthOrZero,
    },
    /// The normal: the ramp starts where it points opposite to a direction and ends where it points along it.
    Normal {
        /// The direction; of any length.
        direction: Direction,
    },
    /// The distance from the camera, along the ray.
    Distance {
        /// Distance where the ramp starts.
        from: LengthOrZero,
        /// Distance where it ends.
        to: LengthOrZero,
    },
    /// The view angle: the ramp starts where the surface is seen edge-on and ends where it faces the viewer.
    Facing {},
}

/// Slope of a fraction that rises between two distances, which may be in either order.
fn slope(from: f32, to: f32) -> f32 {
    let way = to - from;
    if way < 0.0 { 1.0 / way.min(-1e-6) } else { 1.0 / way.max(1e-6) }
}

/// 0 if `x` is `from`, 1 if it is `to`.
fn between<R: Real>(x: R, from: &LengthOrZero, to: &LengthOrZero) -> R {
    (x - x.uniform(from.get())) * x.uniform(slope(from.in_frame(), to.in_frame()))
}

impl GradientBy {
    /// Position on the ramp.
    fn position<R: Real>(&self, place: &ShadingPoint<R>) -> R {
        let like = place.normal.x;
        match self {
            Self::Position { from, to } => {
                let (from, to) = (from.in_frame(), to.in_frame());
                let way = vec3(to.x - from.x, to.y - from.y, to.z - from.z);
                let scale = 1.0 / way.length_squared().max(1e-12);
                let way = vec3(way.x * scale, way.y * scale, way.z * scale);
                (place.local_point - Vec3::uniform(like, from)).dot_uniform(way)
            }
            Self::Radius { center, from, to } => {
                between((place.local_point - Vec3::uniform(like, center.get())).length(), from, to)
            }
            Self::Normal { direction } => {
                place.local_normal.dot_uniform(direction.unit()).mul_add(like.constant(0.5), like.constant(0.5))
            }
            Self::Distance { from, to } => between(place.camera_t, from, to),
            Self::Facing {} => place.normal.dot(place.to_viewer),
        }
    }
}

impl Pattern for Gradient {
    const EXAMPLE: &'static str = r##"{ "by": { "position": { "from": [0, -1, 0], "to": [0, 1, 0] } },
        "ramp": [[0, "#20304a"], [0.45, "#b9545c"], [0.7, "#f2b36b"], [1, "#fff2c8"]] }"##;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r##"{ "by": { "normal": { "direction": [0, 1, 0] } },
              "ramp": [[0, "#3a2c22"], [0.6, "#7b5a3c"], [0.75, "#f5f7fa"], [1, "#ffffff"]] }"##,
        r##"{ "by": { "radius": { "center": [0.5, 0.4, 0.7], "from": 0.2, "to": 1.2 } },
              "ramp": [[0, "#fff6d0"], [0.5, "#e05a2a"], [1, "#38141f"]] }"##,
        r##"{ "by": { "distance": { "from": 4.4, "to": 5.6 } }, "ramp": [[0, "#f0e0b0"], [1, "#204060"]] }"##,
        r##"{ "by": { "facing": {} }, "ramp": [[0, "#bfe8ff"], [0.5, "#2d5f9e"], [1, "#0d1b33"]] }"##,
    ];

    fn color<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        self.ramp.at(self.by.position(place), place)
    }

    fn color_params(&self) -> Vec<&ColorParam> {
        self.ramp.color_params().collect()
    }

    fn uses_local_normal(&self) -> bool {
        matches!(self.by, GradientBy::Normal { .. })
    }
}

fn default_center() -> Point {
    serde_json::from_str("[0, 0, 0]").expect("a point")
}

fn default_from() -> LengthOrZero {
    LengthOrZero::new(0.0).expect("0 is in range")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::materials::texture::tests::at;

    fn brightness(by: &str, place: &ShadingPoint<f32>) -> f32 {
        let gradient: Gradient = serde_json::from_str(&format!(r#"{{ "by": {by} }}"#)).unwrap();
        gradient.color(place).x
    }

    #[test]
    fn each_kind_goes_from_its_start_to_its_end() {
        let position = r#"{ "position": { "from": [1, 0, 0], "to": [3, 0, 0] } }"#;
        assert!((brightness(position, &at(1.5, 9.0, 9.0)) - 0.25).abs() < 1e-6);
        let radius = r#"{ "radius": { "from": 1, "to": 3 } }"#;
        assert!((brightness(radius, &at(0.0, 0.0, -2.5)) - 0.75).abs() < 1e-6);
        let normal = |x, y| {
            brightness(
                r#"{ "normal": { "direction": [0, 2, 0] } }"#,
                &ShadingPoint { local_normal: vec3(x, y, 0.0), ..at(0.0, 0.0, 0.0) },
            )
        };
        assert_eq!([normal(0.0, -1.0), normal(1.0, 0.0), normal(0.0, 1.0)], [0.0, 0.5, 1.0]);
        let distance = r#"{ "distance": { "from": 6, "to": 2 } }"#;
        assert!((brightness(distance, &ShadingPoint { camera_t: 3.0, ..at(0.0, 0.0, 0.0) }) - 0.75).abs() < 1e-6);
        let side = ShadingPoint { to_viewer: vec3(1.0, 0.0, 0.0), ..at(0.0, 0.0, 0.0) };
        assert_eq!(brightness(r#"{ "facing": {} }"#, &side), 0.0);
    }

    #[test]
    fn a_gradient_of_length_0_has_two_colors() {
        let distance = r#"{ "distance": { "from": 2, "to": 2 } }"#;
        let away = |distance_away| brightness(distance, &ShadingPoint { camera_t: distance_away, ..at(0.0, 0.0, 0.0) });
        assert_eq!([away(1.9), away(2.1)], [0.0, 1.0]);
    }
}
