//! Rings, open and closed: a tube or a ribbon along an arc.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{closed_hole_error, hypot};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::nodes::{Precompute, Precomputed, Primitive};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{ArcAngle, Length, LengthOrZero, sin_cos_degrees};

/// A part of a ring around the y axis, with round ends. The center of its arc is at +z.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename = "CappedTorus", deny_unknown_fields)]
pub struct CappedTorusParams {
    /// Radius of the circle at the center of the tube.
    pub radius: Length,
    /// Radius of the tube.
    pub tube: Length,
    /// The full arc, from end to end.
    pub degrees: ArcAngle,
}

/// `CappedTorusParams` with its derived values.
pub type CappedTorus = Precomputed<CappedTorusParams>;

impl Precompute for CappedTorusParams {
    /// End of the arc at x above 0: its x and z.
    type Derived = (f32, f32);

    fn derive(&self) -> (f32, f32) {
        let (sine, cosine) = sin_cos_degrees(self.degrees.in_frame() / 2.0);
        (sine * self.radius.in_frame(), cosine * self.radius.in_frame())
    }
}

impl Primitive for CappedTorus {
    const EXAMPLE: &str = r#"{ "radius": 0.85, "tube": 0.22, "degrees": 250 }"#;

    const MORE_EXAMPLES: &[&str] = &[
        r#"{ "radius": 0.9, "tube": 0.15, "degrees": 100 }"#,
        r#"{ "radius": 0.8, "tube": 0.3, "degrees": 345 }"#,
        r#"{ "radius": 0.8, "tube": 0.2, "degrees": 360 }"#,
    ];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let (end_x, end_z) = *self.derive();
        let (end_x, end_z) = (p.x.uniform(end_x), p.x.uniform(end_z));
        let x = p.x.abs();
        let past_end = (p.z * end_x).lt(x * end_z);
        let off_circle = hypot(x, p.z) - p.x.uniform(self.radius.get());
        let to_end = (x - end_x).square_add((p.z - end_z).square());
        let in_plane = R::select(past_end, to_end, off_circle.square());
        p.y.square_add(in_plane).sqrt() - p.x.uniform(self.tube.get())
    }

    fn exactness(&self) -> Exactness {
        // If the two ends overlap, the depth inside exceeds the formula's value.
        let (end_x, end_z) = *self.derive();
        let apart = end_z >= 0.0 || end_x >= self.tube.in_frame() || self.degrees.in_frame() == 360.0;
        if apart { Exactness::Exact } else { Exactness::Bound }
    }

    fn validate(&self) -> Option<NodeError> {
        closed_hole_error("tube", self.tube.in_frame(), "radius", self.radius.in_frame())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let radius = self.radius.in_frame();
        let (end_x, end_z) = *self.derive();
        let across = if end_z < 0.0 { radius } else { end_x };
        Bounds { min: vec3(-across, 0.0, end_z), max: vec3(across, 0.0, radius) }
            .expanded(self.tube.in_frame() + isolevel)
    }
}

/// A link of a chain in the plane z = 0: a ring elongated along y.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Link {
    /// Full height.
    pub height: Length,
    /// Radius of its bends, to the center of the tube.
    pub radius: Length,
    /// Radius of the tube.
    pub tube: Length,
}

impl Link {
    /// Half the length of its straight sides.
    fn half_side(&self) -> f32 {
        (self.height.in_frame() / 2.0 - self.radius.in_frame() - self.tube.in_frame()).max(0.0)
    }
}

impl Primitive for Link {
    const EXAMPLE: &str = r#"{ "height": 2.1, "radius": 0.45, "tube": 0.16 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let past_side = (p.y.abs() - p.x.uniform(self.half_side())).at_least(0.0);
        let off_line = hypot(p.x, past_side) - p.x.uniform(self.radius.get());
        hypot(off_line, p.z) - p.x.uniform(self.tube.get())
    }

    fn validate(&self) -> Option<NodeError> {
        let least = 2.0 * (self.radius.in_frame() + self.tube.in_frame());
        closed_hole_error("tube", self.tube.in_frame(), "radius", self.radius.in_frame()).or_else(|| {
            (self.height.in_frame() < least).then(|| {
                NodeError::new(
                    "height",
                    format!("must leave room for two bends of radius and tube: make height {least} or more"),
                )
            })
        })
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (radius, tube) = (self.radius.in_frame(), self.tube.in_frame());
        Bounds::symmetric(radius + tube, self.half_side() + radius + tube, tube).expanded(isolevel)
    }
}

/// A ribbon in the plane z = 0 that follows an arc around the origin and continues straight, with round ends. The
/// arc's center is at the bottom, its legs go up.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename = "Horseshoe", deny_unknown_fields)]
pub struct HorseshoeParams {
    /// Radius of the arc, to the center of the ribbon.
    pub radius: Length,
    /// The full arc, from leg to leg.
    pub degrees: ArcAngle,
    /// Length of the straight legs, to the center of their round ends.
    pub leg: LengthOrZero,
    /// Full width of the ribbon, across its path.
    pub width: Length,
    /// Full extent along z.
    pub thickness: Length,
}

/// `HorseshoeParams` with its derived values.
pub type Horseshoe = Precomputed<HorseshoeParams>;

impl Precompute for HorseshoeParams {
    type Derived = Ribbon;

    fn derive(&self) -> Ribbon {
        Ribbon {
            radius: self.radius.in_frame(),
            turn: sin_cos_degrees(self.degrees.in_frame() / 2.0),
            leg: self.leg.in_frame(),
            width: self.width.in_frame(),
            thickness: self.thickness.in_frame(),
        }
    }
}

impl Primitive for Horseshoe {
    const EXAMPLE: &str = r#"{ "radius": 0.7, "degrees": 230, "leg": 0.35, "width": 0.3, "thickness": 0.25 }"#;

    const MORE_EXAMPLES: &[&str] = &[
        r#"{ "radius": 0.9, "degrees": 80, "leg": 0.4, "width": 0.2, "thickness": 0.6 }"#,
        r#"{ "radius": 0.9, "degrees": 300, "leg": 0, "width": 0.3, "thickness": 0.1 }"#,
    ];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.derive().distance(p)
    }

    fn validate(&self) -> Option<NodeError> {
        self.derive().fault()
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.derive().bounds(isolevel)
    }
}

/// A ribbon in the plane z = 0, shaped like the letter U: half a circle around the origin, and two legs that go up.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct U {
    /// Radius of the bend, to the center of the ribbon.
    pub radius: Length,
    /// Length of the straight legs, to the center of their round ends.
    pub leg: LengthOrZero,
    /// Full width of the ribbon, across its path.
    pub width: Length,
    /// Full extent along z.
    pub thickness: Length,
}

impl Primitive for U {
    const EXAMPLE: &str = r#"{ "radius": 0.55, "leg": 0.8, "width": 0.28, "thickness": 0.4 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.band().distance(p)
    }

    fn validate(&self) -> Option<NodeError> {
        self.band().fault()
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.band().bounds(isolevel)
    }
}

impl U {
    fn band(&self) -> Ribbon {
        Ribbon {
            radius: self.radius.in_frame(),
            turn: (1.0, 0.0),
            leg: self.leg.in_frame(),
            width: self.width.in_frame(),
            thickness: self.thickness.in_frame(),
        }
    }
}

/// A bent ribbon: the shape of [`Horseshoe`] and [`U`].
#[derive(Clone, Debug)]
pub struct Ribbon {
    radius: f32,
    /// Sine and cosine of half the arc.
    turn: (f32, f32),
    leg: f32,
    width: f32,
    thickness: f32,
}

impl Ribbon {
    /// End of a leg at x above 0: its x and y.
    fn end(&self) -> (f32, f32) {
        let (sine, cosine) = self.turn;
        (self.radius * sine + self.leg * cosine, self.leg * sine - self.radius * cosine)
    }

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let (sine, cosine) = (p.x.uniform(self.turn.0), p.x.uniform(self.turn.1));
        let (radius, x) = (p.x.uniform(self.radius), p.x.abs());
        // Along a leg, from the end of the arc, and away from the origin.
        let along = x.mul_add(cosine, p.y * sine);
        let out = x.mul_add(sine, -(p.y * cosine));
        let on_leg = along.above(0.0);
        let past_end = (along - p.x.uniform(self.leg)).at_least(0.0);
        let to_leg = past_end.square_add((out - radius).square());
        let to_center = x.square_add(p.y.square());
        let length = R::select(on_leg, to_leg, to_center).sqrt();
        let to_line = (length - R::select(on_leg, p.x.constant(0.0), radius)).abs();
        let past_side = to_line - p.x.uniform(self.width / 2.0);
        let past_face = p.z.abs() - p.x.uniform(self.thickness / 2.0);
        hypot(past_side.at_least(0.0), past_face.at_least(0.0)) + past_side.max(past_face).at_most(0.0)
    }

    fn fault(&self) -> Option<NodeError> {
        let meets = self.turn.1 < 0.0 && self.end().0 < self.width / 2.0;
        closed_hole_error("width", self.width, "twice the radius", 2.0 * self.radius).or_else(|| {
            meets.then(|| {
                NodeError::new("leg", "runs into the other one: make degrees, leg or width less, or radius larger")
            })
        })
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (end_x, end_y) = self.end();
        let arc_x = if self.turn.1 < 0.0 { self.radius } else { self.radius * self.turn.0 };
        let across = arc_x.max(end_x) + self.width / 2.0;
        let (low, high) = (-self.radius - self.width / 2.0, end_y.max(-self.radius * self.turn.1) + self.width / 2.0);
        let half = self.thickness / 2.0;
        Bounds { min: vec3(-across, low, -half), max: vec3(across, high, half) }.expanded(isolevel)
    }
}
