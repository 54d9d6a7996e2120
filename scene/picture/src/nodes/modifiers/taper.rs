//! Shapes that narrow or widen upward.
//!
//! With f(y) the factor of the cross-section, the value is f·d(x/f, y, z/f). If the shape's radius about the y axis is
//! at most r, f times the map's derivative is the matrix (1, r·f'; 0, f) of the directions outwards and up. Its
//! greatest singular value, ½(√((1+f)² + r²f'²) + √((1−f)² + r²f'²)), is a Lipschitz factor; d itself, clamped to
//! ±r/2, adds f'·r/2. Outside the bounding frustum, the shape is evaluated at the nearest point of its own cylinder,
//! and the distance to the frustum, times the factor, is used if it is greater.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::cached::Cached;
use super::nearest_copy::ended;
use super::twist::{radius_about_y, require_bounded};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::nodes::carried::carries_child;
use crate::nodes::transforms::around_child;
use crate::nodes::{Child, Node, Sdf, SdfValue};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Coordinate, ScaleFactor};

/// Multiplies a shape's width along x and z by a factor that changes linearly from `bottom` to `top`, and is constant
/// outside them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Taper {
    /// The y at which the factor is `bottom_factor`.
    pub bottom: Coordinate,
    /// The y at which the factor is `top_factor`.
    pub top: Coordinate,
    /// Factor at the bottom.
    #[serde(default = "default_bottom_factor")]
    pub bottom_factor: ScaleFactor,
    /// Factor at the top.
    pub top_factor: ScaleFactor,
    /// The shape, which must be bounded along x and z.
    pub child: Child,
    /// Values derived from the fields above.
    #[serde(skip)]
    #[schemars(skip)]
    frustum: Cached<BoundingFrustum>,
}

/// Frustum that contains the shape.
#[derive(Clone, Debug)]
struct BoundingFrustum {
    /// Radius of the shape without the taper.
    radius: f32,
    low: f32,
    high: f32,
    /// Change of the factor per unit upward.
    slope: f32,
    /// Cosine of the angle between its side and the y axis: distance to the side per unit of horizontal distance.
    slant: f32,
    /// One over the greatest factor if that is above 1, else 1: factor of the value.
    value_scale: f32,
    /// The Lipschitz factor.
    lipschitz: f32,
}

impl Taper {
    /// Factor at a height.
    fn factor<R: Real>(&self, y: R) -> R {
        let (bottom, top) = (self.bottom_factor.in_frame(), self.top_factor.in_frame());
        let factor = (y - y.uniform(self.bottom.get())).mul_add(y.uniform(self.frustum().slope), y.uniform(bottom));
        factor.max(y.uniform(bottom.min(top))).min(y.uniform(bottom.max(top)))
    }

    fn outward<R: Real>(&self, q: Vec3<R>) -> Vec3<R> {
        let factor = self.factor(q.y);
        vec3(q.x * factor, q.y, q.z * factor)
    }

    fn frustum(&self) -> &BoundingFrustum {
        self.frustum.get(|| {
            let bounds = ended(self.child.bounds(0.0));
            let radius = radius_about_y(bounds);
            let (bottom, top) = (self.bottom_factor.in_frame(), self.top_factor.in_frame());
            let slope = (top - bottom) / (self.top.in_frame() - self.bottom.in_frame()).max(1e-6);
            let widest = bottom.max(top);
            let shrink = 1.0 / widest.max(1.0);
            let shear = radius * slope.abs();
            let beside = |widest: f32| Real::sqrt((1.0 + widest) * (1.0 + widest) + shear * shear);
            let drawn_apart = 0.5 * (beside(widest) + beside(-widest));
            let child = self.child.lipschitz();
            let lipschitz = (child * drawn_apart + 0.5 * shear) * shrink * (1.0 + 1e-6);
            let slant = 1.0 / Real::sqrt(1.0 + shear * shear);
            BoundingFrustum {
                radius,
                low: bounds.min.y,
                high: bounds.max.y,
                slope,
                slant,
                value_scale: shrink,
                lipschitz,
            }
        })
    }
}

impl Sdf for Taper {
    const EXAMPLE: &'static str = r#"{ "bottom": -0.9, "top": 0.9, "top_factor": 0.3, "child": {
        "box": { "size": [1.4, 1.8, 1.4], "round": 0.05 }
    } }"#;
    const MORE_EXAMPLES: &'static [&'static str] =
        &[r#"{ "bottom": -0.5, "top": 0.6, "bottom_factor": 0.4, "top_factor": 1.5, "child": {
        "translate": { "by": [0.1, 0, 0], "child": { "cylinder": { "radius": 0.5, "height": 1.9 } } }
    } }"#];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let BoundingFrustum { radius, low, high, slope: _, slant, value_scale: shrink, lipschitz } = *self.frustum();
        let y = p.y.max(p.x.uniform(low)).min(p.x.uniform(high));
        let factor = self.factor(y);
        let away = p.x.square_add(p.z.square()).sqrt();
        let inwards = p.x.constant(1.0) / factor.max(away * p.x.uniform(1.0 / radius));
        let child: V = sample(0, vec3(p.x * inwards, y, p.z * inwards));
        let held = child.distance().max(p.x.uniform(-0.5 * radius)).min(p.x.uniform(0.5 * radius))
            * (factor * p.x.uniform(shrink));
        let beyond = (away - factor * p.x.uniform(radius)) * p.x.uniform(slant);
        let beyond = beyond.max(p.y - p.x.uniform(high)).max(p.x.uniform(low) - p.y);
        child.with_distance(held.max(beyond * p.x.uniform(lipschitz)))
    }

    around_child!();

    carries_child!(|self| {
        let heights = [&self.bottom, &self.top];
        let factors = [&self.bottom_factor, &self.top_factor];
        heights.into_iter().any(Coordinate::is_animated) || factors.into_iter().any(ScaleFactor::is_animated)
    });

    fn lipschitz(&self) -> f32 {
        self.frustum().lipschitz
    }

    fn own_exactness(&self) -> Exactness {
        self.child.exactness().max(Exactness::Bound)
    }

    fn validate(&self) -> Option<NodeError> {
        if self.top.in_frame() - self.bottom.in_frame() < 1e-6 {
            let message = format!("must be above bottom: make top more than {}", self.bottom.in_frame());
            return Some(NodeError::new("top", message));
        }
        require_bounded(&self.child, &['x', 'z'], "so a taper would move it without limit")
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let BoundingFrustum { radius, low, high, slant, lipschitz, .. } = *self.frustum();
        let beyond = isolevel / lipschitz;
        let radius = radius * self.bottom_factor.in_frame().max(self.top_factor.in_frame());
        let radius = radius + beyond / slant;
        Bounds { min: vec3(-radius, low - beyond, -radius), max: vec3(radius, high + beyond, radius) }
    }

    fn lipschitz_advice(&self) -> &'static str {
        "taper it less"
    }
}

fn default_bottom_factor() -> ScaleFactor {
    ScaleFactor::new(1.0).expect("1 is in range")
}
