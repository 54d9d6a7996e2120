//! Solids around the y axis with straight sides: cones and parts of cones. All are exact.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{distance_from_y_axis, hypot};
use crate::bounds::Bounds;
use crate::kinds::NodeError;
use crate::nodes::{Precompute, Precomputed, Primitive};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{AcuteHalfAngle, HalfAngle, Length, LengthOrZero, sin_cos_degrees};

/// A cone around the y axis, centered at the origin: the base at y = −height/2, the apex at y = height/2.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Cone {
    /// Radius of the base.
    pub radius: Length,
    /// Full height.
    pub height: Length,
}

impl Primitive for Cone {
    const EXAMPLE: &str = r#"{ "radius": 0.8, "height": 1.8 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        to_capped_cone(p, self.radius.in_frame(), 0.0, self.height.in_frame())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let radius = self.radius.in_frame();
        Bounds::symmetric(radius, self.height.in_frame() / 2.0, radius).expanded(isolevel)
    }
}

/// A cone without its tip, around the y axis, centered at the origin.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct CappedCone {
    /// Radius at y = −height/2.
    pub bottom_radius: LengthOrZero,
    /// Radius at y = height/2.
    pub top_radius: LengthOrZero,
    /// Full height.
    pub height: Length,
}

impl Primitive for CappedCone {
    const EXAMPLE: &str = r#"{ "bottom_radius": 0.9, "top_radius": 0.4, "height": 1.4 }"#;

    const MORE_EXAMPLES: &[&str] = &[r#"{ "bottom_radius": 0, "top_radius": 0.8, "height": 1.2 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        to_capped_cone(p, self.bottom_radius.in_frame(), self.top_radius.in_frame(), self.height.in_frame())
    }

    fn validate(&self) -> Option<NodeError> {
        let (bottom, top) = (self.bottom_radius.in_frame(), self.top_radius.in_frame());
        (bottom.max(top) == 0.0).then(|| {
            NodeError::new(
                "bottom_radius",
                "and top_radius are both 0, so the cone is empty: make one of them larger than 0",
            )
        })
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let radius = self.bottom_radius.in_frame().max(self.top_radius.in_frame());
        Bounds::symmetric(radius, self.height.in_frame() / 2.0, radius).expanded(isolevel)
    }
}

/// Distance to a cone between two disks around the y axis: the lesser of the distances to a disk and to the side.
fn to_capped_cone<R: Real>(p: Vec3<R>, bottom: f32, top: f32, height: f32) -> R {
    let half = height / 2.0;
    // In the half-plane of (away from the axis, up), the side runs from (bottom, −half) by `side`.
    let side = (top - bottom, height);
    let per_square = 1.0 / (side.0 * side.0 + side.1 * side.1);
    let across = distance_from_y_axis(p);
    let radius = R::select(p.y.below(0.0), across.uniform(bottom), across.uniform(top));
    let (past_disc, past_cap) = ((across - radius).at_least(0.0), p.y.abs() - across.uniform(half));
    let from_bottom = (across - across.uniform(bottom), p.y + across.uniform(half));
    let share = from_bottom
        .0
        .mul_add(across.uniform(side.0 * per_square), from_bottom.1 * across.uniform(side.1 * per_square))
        .at_least(0.0)
        .at_most(1.0);
    let off_side = share.mul_add(across.uniform(-side.0), from_bottom.0);
    let up_side = share.mul_add(across.uniform(-side.1), from_bottom.1);
    let to_disc = past_disc.square_add(past_cap.square());
    let to_side = off_side.square_add(up_side.square());
    let distance = to_disc.min(to_side).sqrt();
    R::select(off_side.below(0.0) & past_cap.below(0.0), -distance, distance)
}

/// An infinite cone: its apex at the origin, opening downward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename = "InfiniteCone", deny_unknown_fields)]
pub struct InfiniteConeParams {
    /// Half the cone's opening angle: between the axis and the side.
    pub degrees: AcuteHalfAngle,
}

/// `InfiniteConeParams` with its derived values.
pub type InfiniteCone = Precomputed<InfiniteConeParams>;

impl Precompute for InfiniteConeParams {
    /// Sine and cosine of the angle.
    type Derived = (f32, f32);

    fn derive(&self) -> (f32, f32) {
        sin_cos_degrees(self.degrees.in_frame())
    }
}

impl Primitive for InfiniteCone {
    const EXAMPLE: &str = r#"{ "degrees": 30 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let (sine, cosine) = *self.derive();
        let across = distance_from_y_axis(p);
        let (sine, cosine) = (across.uniform(sine), across.uniform(cosine));
        let down_side = across.mul_add(sine, -(p.y * cosine));
        let off_side = across.mul_add(cosine, p.y * sine);
        R::select(down_side.above(0.0), off_side, p.length())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        Bounds { max: vec3(f32::INFINITY, isolevel, f32::INFINITY), ..Bounds::INFINITE }
    }
}

/// Two balls on the y axis and the cone that touches both; the center of its height is at the origin.
///
/// The union of a ball at each point between the ends of the axis, whose radius changes linearly; the value is the
/// least distance to any of them. The shape is Inigo Quilez's, "Distance functions":
/// <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct RoundCone {
    /// Radius of the lower ball.
    pub bottom_radius: Length,
    /// Radius of the upper ball.
    pub top_radius: Length,
    /// Full height, including the balls.
    pub height: Length,
}

impl Primitive for RoundCone {
    const EXAMPLE: &str = r#"{ "bottom_radius": 0.7, "top_radius": 0.3, "height": 2 }"#;

    const MORE_EXAMPLES: &[&str] = &[r#"{ "bottom_radius": 0.3, "top_radius": 0.6, "height": 1.7 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let (bottom, top, height) = (self.bottom_radius.in_frame(), self.top_radius.in_frame(), self.height.in_frame());
        let apart = (height - bottom - top).max(0.0);
        // Growth of the radius along the axis: the sine of the angle between axis and side.
        let growth = ((top - bottom) / apart.max(1e-12)).clamp(-1.0, 1.0);
        let slope = growth / Real::sqrt((1.0 - growth) * (1.0 + growth)).max(1e-6);
        let across = distance_from_y_axis(p);
        let up = p.y + across.uniform(height / 2.0 - bottom);
        let along = across.mul_add(across.uniform(slope), up).at_least(0.0).min(across.uniform(apart));
        let to_center = hypot(across, up - along);
        along.mul_add(across.uniform(-growth), to_center - across.uniform(bottom))
    }

    fn validate(&self) -> Option<NodeError> {
        let least = 2.0 * self.bottom_radius.in_frame().max(self.top_radius.in_frame());
        (self.height.in_frame() < least).then(|| {
            NodeError::new(
                "height",
                format!("must be at least twice the larger radius, to contain that ball: make height {least} or more"),
            )
        })
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let radius = self.bottom_radius.in_frame().max(self.top_radius.in_frame());
        Bounds::symmetric(radius, self.height.in_frame() / 2.0, radius).expanded(isolevel)
    }
}

/// The part of a ball inside a cone with its apex at the ball's center, opening upward.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename = "SolidAngle", deny_unknown_fields)]
pub struct SolidAngleParams {
    /// Half the cone's opening angle: between the axis and the side. Above 90 the shape is a ball minus a cone.
    pub degrees: HalfAngle,
    /// Radius of the ball.
    pub radius: Length,
}

/// `SolidAngleParams` with its derived values.
pub type SolidAngle = Precomputed<SolidAngleParams>;

impl Precompute for SolidAngleParams {
    /// Sine and cosine of the angle.
    type Derived = (f32, f32);

    fn derive(&self) -> (f32, f32) {
        sin_cos_degrees(self.degrees.in_frame())
    }
}

impl Primitive for SolidAngle {
    const EXAMPLE: &str = r#"{ "degrees": 40, "radius": 1.1 }"#;

    const MORE_EXAMPLES: &[&str] = &[r#"{ "degrees": 130, "radius": 0.9 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let (sine, cosine) = *self.derive();
        let across = distance_from_y_axis(p);
        let (sine, cosine, radius) = (across.uniform(sine), across.uniform(cosine), across.uniform(self.radius.get()));
        let past_ball = p.length() - radius;
        let along = across.mul_add(sine, p.y * cosine).at_least(0.0).min(radius);
        let to_side = hypot(across - sine * along, p.y - cosine * along);
        let outside = across.mul_add(cosine, -(p.y * sine)).above(0.0);
        past_ball.max(R::select(outside, to_side, -to_side))
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let radius = self.radius.in_frame();
        let (sine, cosine) = *self.derive();
        let across = if cosine < 0.0 { radius } else { radius * sine };
        let low = (radius * cosine).min(0.0);
        Bounds { min: vec3(-across, low, -across), max: vec3(across, radius, across) }.expanded(isolevel)
    }
}
