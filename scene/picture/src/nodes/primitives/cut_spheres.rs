//! Parts of balls. All are exact.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{distance_from_y_axis, hypot};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::nodes::Primitive;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Coordinate, Length};

/// The part of a ball around the origin above a horizontal plane.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct CutSphere {
    /// Radius of the ball.
    pub radius: Length,
    /// Height of the plane.
    pub cut: Coordinate,
}

impl Primitive for CutSphere {
    const EXAMPLE: &str = r#"{ "radius": 1.1, "cut": -0.3 }"#;

    const MORE_EXAMPLES: &[&str] = &[r#"{ "radius": 1.2, "cut": 0.4 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let across = distance_from_y_axis(p);
        let radius = p.x.uniform(self.radius.get());
        let (cut, rim) = (p.x.uniform(self.cut.get()), p.x.uniform(rim(&self.radius, &self.cut)));
        // Below the cone of the origin and the rim, the sphere is never nearest.
        let below_rim = (p.y * rim).lt(across * cut);
        let to_rim = (across - rim).square_add((p.y - cut).square());
        let to_center = across.square_add(p.y.square());
        let distance = R::select(below_rim, to_rim, to_center).sqrt();
        let past_cut = cut - p.y;
        let below = R::select(across.lt(rim), past_cut, distance);
        R::select(below_rim, below, past_cut.max(distance - radius))
    }

    fn validate(&self) -> Option<NodeError> {
        plane_misses_sphere(&self.radius, &self.cut)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (radius, cut) = (self.radius.in_frame(), self.cut.in_frame());
        let across = if cut > 0.0 { rim(&self.radius, &self.cut) } else { radius };
        Bounds { min: vec3(-across, cut, -across), max: vec3(across, radius, across) }.expanded(isolevel)
    }
}

/// A bowl: the part of a spherical shell around the origin below a horizontal plane, with a round brim.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct CutHollowSphere {
    /// Radius of the sphere at the center of the shell.
    pub radius: Length,
    /// Height of the plane.
    pub cut: Coordinate,
    /// Full thickness of the shell.
    pub thickness: Length,
}

impl CutHollowSphere {
    /// Whether the brim leaves a hole at its center.
    fn is_open(&self) -> bool {
        self.cut.in_frame() <= 0.0 || rim(&self.radius, &self.cut) * 2.0 >= self.thickness.in_frame()
    }
}

impl Primitive for CutHollowSphere {
    const EXAMPLE: &str = r#"{ "radius": 1, "cut": 0.2, "thickness": 0.15 }"#;

    const MORE_EXAMPLES: &[&str] =
        &[r#"{ "radius": 1.1, "cut": -0.3, "thickness": 0.1 }"#, r#"{ "radius": 0.9, "cut": 0.85, "thickness": 0.7 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let across = distance_from_y_axis(p);
        let (cut, rim) = (p.x.uniform(self.cut.get()), p.x.uniform(rim(&self.radius, &self.cut)));
        let above_rim = (across * cut).lt(p.y * rim);
        let to_rim = (across - rim).square_add((p.y - cut).square());
        let to_center = across.square_add(p.y.square());
        let distance = R::select(above_rim, to_rim, to_center).sqrt();
        let radius = R::select(above_rim, p.x.constant(0.0), p.x.uniform(self.radius.get()));
        (distance - radius).abs() - p.x.uniform(self.thickness.get() / 2.0)
    }

    fn exactness(&self) -> Exactness {
        // If the brim has closed, the depth inside exceeds the formula's value.
        if self.is_open() { Exactness::Exact } else { Exactness::Bound }
    }

    fn validate(&self) -> Option<NodeError> {
        let most = 2.0 * self.radius.in_frame();
        let swallowed = self.thickness.in_frame() >= most;
        plane_misses_sphere(&self.radius, &self.cut).or_else(|| {
            swallowed.then(|| {
                NodeError::new(
                    "thickness",
                    format!("must be less than twice the radius, to leave a hollow: make thickness less than {most}"),
                )
            })
        })
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (radius, cut) = (self.radius.in_frame(), self.cut.in_frame());
        let across = if cut < 0.0 { rim(&self.radius, &self.cut) } else { radius };
        let middle = Bounds { min: vec3(-across, -radius, -across), max: vec3(across, cut, across) };
        middle.expanded(self.thickness.in_frame() / 2.0 + isolevel)
    }
}

/// Radius of the circle that a plane cuts out of a sphere.
fn rim(radius: &Length, cut: &Coordinate) -> f32 {
    let (radius, cut) = (radius.in_frame(), cut.in_frame());
    Real::sqrt((radius - cut) * (radius + cut))
}

/// Error for a plane that does not intersect the ball that it should cut.
fn plane_misses_sphere(radius: &Length, cut: &Coordinate) -> Option<NodeError> {
    let radius = radius.in_frame();
    (cut.in_frame().abs() >= radius)
        .then(|| NodeError::new("cut", format!("must pass through the ball: put it between {} and {radius}", -radius)))
}

/// A ball around the origin minus a smaller or larger ball at its top.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct DeathStar {
    /// Radius of the ball.
    pub radius: Length,
    /// Radius of the ball that is subtracted.
    pub bite: Length,
    /// Height of the subtracted ball's center above the other.
    pub distance: Length,
}

impl DeathStar {
    /// Circle where the surfaces of ball and bite intersect: its radius and its height.
    fn rim(&self) -> (f32, f32) {
        let (radius, bite, distance) = (self.radius.in_frame(), self.bite.in_frame(), self.distance.in_frame());
        let height = ((radius - bite) * (radius + bite) / distance + distance) * 0.5;
        (Real::sqrt((radius - height) * (radius + height)), height)
    }
}

impl Primitive for DeathStar {
    const EXAMPLE: &str = r#"{ "radius": 1.1, "bite": 0.7, "distance": 1.2 }"#;

    const MORE_EXAMPLES: &[&str] = &[r#"{ "radius": 1, "bite": 1.2, "distance": 0.8 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let (rim, height) = self.rim();
        let across = distance_from_y_axis(p);
        let above = p.y - p.x.uniform(self.distance.get());
        let over_ball = p.y.mul_add(p.x.uniform(rim), across * p.x.uniform(-height));
        let over_bite = above.mul_add(p.x.uniform(rim), across * p.x.uniform(self.distance.get() - height));
        let past_ball = hypot(across, p.y) - p.x.uniform(self.radius.get());
        let past_bite = p.x.uniform(self.bite.get()) - hypot(across, above);
        let to_rim = hypot(across - p.x.uniform(rim), p.y - p.x.uniform(height));
        R::select(over_ball.above(0.0) & over_bite.above(0.0), to_rim, past_ball.max(past_bite))
    }

    fn validate(&self) -> Option<NodeError> {
        let (radius, bite, distance) = (self.radius.in_frame(), self.bite.in_frame(), self.distance.in_frame());
        let (low, high) = ((radius - bite).abs(), radius + bite);
        (distance <= low || distance >= high).then(|| {
            NodeError::new("distance", format!("must make the two surfaces intersect: put it between {low} and {high}"))
        })
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let ((rim, height), radius) = (self.rim(), self.radius.in_frame());
        let across = if height < 0.0 { rim } else { radius };
        Bounds { min: vec3(-across, -radius, -across), max: vec3(across, height, across) }.expanded(isolevel)
    }
}
