//! A shape twisted about the y axis.
//!
//! A twist of k radians per unit shears a point at radius r by k·r, which increases distances by a factor of up to
//! (k·r + √(k²r² + 4))/2, the greatest singular value of that shear. So the shape is evaluated only inside its
//! bounding cylinder, at the nearest point there. Farther out, the distance to the cylinder times that factor is used.
//! Both have that Lipschitz factor, and so does the greater of them.

use std::f32::consts::TAU;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::cached::Cached;
use super::nearest_copy::ended;
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::nodes::carried::carries_child;
use crate::nodes::transforms::around_child;
use crate::nodes::{Child, Node, Sdf, SdfValue};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Degrees;

/// A shape twisted about the y axis: points are rotated in proportion to their height, from z to x.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Twist {
    /// Rotation per scene unit of height above the origin.
    pub degrees_per_unit: Degrees,
    /// The shape, which must be bounded along x and z.
    pub child: Child,
    /// Values derived from the fields above.
    #[serde(skip)]
    #[schemars(skip)]
    cylinder: Cached<BoundingCylinder>,
}

/// Cylinder that contains the shape.
#[derive(Clone, Debug)]
struct BoundingCylinder {
    radius: f32,
    low: f32,
    high: f32,
    /// The Lipschitz factor inside.
    lipschitz: f32,
}

impl Twist {
    /// Sine and cosine of the rotation at a height.
    fn turn<R: Real>(&self, y: R) -> (R, R) {
        let turns = y * y.uniform(self.degrees_per_unit.get() / 360.0);
        ((turns - turns.floor()) * TAU).sin_cos()
    }

    fn outward<R: Real>(&self, q: Vec3<R>) -> Vec3<R> {
        let (sin, cos) = self.turn(q.y);
        vec3(q.x.mul_add(cos, q.z * sin), q.y, q.z.mul_add(cos, -(q.x * sin)))
    }

    fn cylinder(&self) -> &BoundingCylinder {
        self.cylinder.get(|| {
            let bounds = ended(self.child.bounds(0.0));
            let radius = radius_about_y(bounds);
            let shear = radius * self.degrees_per_unit.in_frame().to_radians().abs();
            let drawn_apart = 0.5 * (shear + Real::sqrt(shear * shear + 4.0));
            // Slightly more than rounding could reduce it.
            let lipschitz = self.child.lipschitz() * drawn_apart * (1.0 + 1e-6);
            BoundingCylinder { radius, low: bounds.min.y, high: bounds.max.y, lipschitz }
        })
    }
}

/// Radius of a cylinder about the y axis that contains a box; not 0.
pub(super) fn radius_about_y(Bounds { min: low, max: high }: Bounds) -> f32 {
    let (x, z) = (low.x.abs().max(high.x.abs()), low.z.abs().max(high.z.abs()));
    Real::sqrt(x * x + z * z).max(1e-6)
}

/// Error for a shape that is unbounded along one of `axes`, if it is.
pub(super) fn require_bounded(child: &Node, axes: &[char], what: &str) -> Option<NodeError> {
    let Bounds { min: low, max: high } = child.bounds(0.0);
    let endless = axes.iter().find(|axis| {
        let (low, high) = match axis {
            'x' => (low.x, high.x),
            'y' => (low.y, high.y),
            _ => (low.z, high.z),
        };
        !(low.is_finite() && high.is_finite())
    })?;
    let message = format!("is unbounded along {endless}, {what}: bound it by an intersection, inside");
    Some(NodeError::new("child", message))
}

impl Sdf for Twist {
    const EXAMPLE: &'static str = r#"{ "degrees_per_unit": 60, "child": {
        "box": { "size": [0.9, 1.9, 0.9], "round": 0.05 }
    } }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[r#"{ "degrees_per_unit": -90, "child": { "union": { "of": [
        { "translate": { "by": [0.35, 0, 0], "child": { "cylinder": { "radius": 0.2, "height": 1.9 } } } },
        { "translate": { "by": [-0.35, 0, 0], "child": { "cylinder": { "radius": 0.2, "height": 1.9 } } } }
    ] } } }"#];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let BoundingCylinder { radius, low, high, lipschitz } = *self.cylinder();
        let away = p.x.square_add(p.z.square()).sqrt();
        let y = p.y.max(p.x.uniform(low)).min(p.x.uniform(high));
        let inwards = p.x.uniform(radius) / away.max(p.x.uniform(radius));
        let (sin, cos) = self.turn(y);
        let (x, z) = (p.x * inwards, p.z * inwards);
        let child: V = sample(0, vec3(x.mul_add(cos, -(z * sin)), y, x.mul_add(sin, z * cos)));
        let beyond = (away - p.x.uniform(radius)).max(p.y - p.x.uniform(high)).max(p.x.uniform(low) - p.y);
        let distance = child.distance().max(beyond * p.x.uniform(lipschitz));
        child.with_distance(distance)
    }

    around_child!();

    carries_child!(|self| self.degrees_per_unit.is_animated());

    fn lipschitz(&self) -> f32 {
        self.cylinder().lipschitz
    }

    fn own_exactness(&self) -> Exactness {
        self.child.exactness().max(Exactness::Bound)
    }

    fn validate(&self) -> Option<NodeError> {
        require_bounded(&self.child, &['x', 'z'], "so a twist would wind it without limit")
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let BoundingCylinder { radius, low, high, lipschitz } = *self.cylinder();
        Bounds { min: vec3(-radius, low, -radius), max: vec3(radius, high, radius) }.expanded(isolevel / lipschitz)
    }

    fn lipschitz_advice(&self) -> &'static str {
        "lower degrees_per_unit, or make its child narrower"
    }
}
