//! A shape bent upwards: the x axis becomes a circle through the origin.
//!
//! With a curvature of k radians per unit the circle's center is (0, 1/k). A point at the angle a from straight down,
//! at distance r from the center, comes from (a/k, 1/k − r): points at the same height r are stretched by 1/(k·r)
//! horizontally, and not at all vertically. If the shape is below y, all of it is farther than 1/k − y from the
//! center, and L = (1 + g)/(1 − k·y), or 1, is a Lipschitz factor for every r ≥ (1/k − y)/(1 + g).
//!
//! The half-plane above the center remains, where the two ends of the angle coincide. Let `beyond` be a lower bound of
//! the distance to the bent shape's bounds, and s the distance to that half-plane. The value is max(L·beyond, min(d,
//! L·g·s)). At the half-plane, and nearer to the center than assumed, it is L·beyond on both sides. In the shape s is
//! not 0, so the surface does not change.

use std::f32::consts::{FRAC_PI_2, PI};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::cached::Cached;
use super::nearest_copy::ended;
use super::twist::require_bounded;
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::nodes::carried::carries_child;
use crate::nodes::transforms::around_child;
use crate::nodes::{Child, Node, Sdf, SdfValue};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Degrees;

/// g: how far beyond the shape the factor is valid, and how soon the half-plane has an effect.
const GUARD_FRACTION: f32 = 0.125;
/// Minimum distance of the shape from the circle's center, as a fraction of the radius.
const MIN_RADIUS_FRACTION: f32 = 0.1;
/// Curvature below which a shape is not bent, in radians per unit.
const MIN_CURVATURE: f32 = 1e-6;

/// Bends a shape in the plane of x and y: its x axis becomes a circle through the origin, its ends go up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Bend {
    /// Curvature per scene unit along x; below 0 the ends go down.
    pub degrees_per_unit: Degrees,
    /// The shape, which must be bounded along x and y and must not extend to the circle's center.
    pub child: Child,
    /// Values derived from the fields above.
    #[serde(skip)]
    #[schemars(skip)]
    arc: Cached<BentBounds>,
}

/// Piece of a ring that contains the bent shape. Up is toward the circle's center.
#[derive(Clone, Debug)]
struct BentBounds {
    /// −1 if the shape is bent down.
    up: f32,
    curvature: f32,
    /// Vertical range of the shape before bending.
    low: f32,
    high: f32,
    /// Center and half of its extent along z.
    middle_z: f32,
    half_z: f32,
    /// Sine and cosine of the angle at its end.
    end: (f32, f32),
    /// Extent along x, and vertically, after bending.
    reach: f32,
    top: f32,
    lipschitz: f32,
}

impl Bend {
    fn outward<R: Real>(&self, q: Vec3<R>) -> Vec3<R> {
        let &BentBounds { up, curvature, .. } = self.arc();
        let (height, radius) = (q.y * q.x.uniform(up), q.x.uniform(1.0 / curvature));
        let half_angle = q.x * q.x.uniform(0.5 * curvature);
        let (half_sin, half_cos) = half_angle.sin_cos();
        // 1 − cos, in a form that stays accurate if the angle is close to 0.
        let fall = half_sin.square() * 2.0;
        let x = half_sin * half_cos * 2.0 * (radius - height);
        let y = fall.mul_add(radius - height, height);
        vec3(x, y * q.x.uniform(up), q.z)
    }

    fn arc(&self) -> &BentBounds {
        self.arc.get(|| {
            let Bounds { min: low, max: high } = ended(self.child.bounds(0.0));
            let curvature = self.degrees_per_unit.in_frame().to_radians();
            let up = if curvature < 0.0 { -1.0 } else { 1.0 };
            let curvature = curvature.abs().max(MIN_CURVATURE);
            let (low_y, high_y) = if up < 0.0 { (-high.y, -low.y) } else { (low.y, high.y) };
            let angle = (curvature * low.x.abs().max(high.x.abs())).min(PI);
            let (sin, cos) = Real::sin_cos(angle);
            // (1 − cos a)/k, by half the angle, because a may be close to 0.
            let half_sin = Real::sin(0.5 * angle);
            let rise = 2.0 * half_sin * half_sin / curvature;
            let widest = if angle < FRAC_PI_2 { sin } else { 1.0 };
            let nearest = (1.0 - curvature * high_y).max(0.5 * MIN_RADIUS_FRACTION);
            let lipschitz = self.child.lipschitz() * ((1.0 + GUARD_FRACTION) / nearest).max(1.0) * (1.0 + 1e-6);
            BentBounds {
                up,
                curvature,
                low: low_y,
                high: high_y,
                middle_z: 0.5 * (low.z + high.z),
                half_z: 0.5 * (high.z - low.z),
                end: (sin, cos),
                reach: widest / curvature - low_y * widest,
                top: rise + (low_y * cos).max(high_y * cos),
                lipschitz,
            }
        })
    }
}

impl Sdf for Bend {
    const EXAMPLE: &'static str = r#"{ "degrees_per_unit": 70, "child": {
        "box": { "size": [2.2, 0.4, 0.7], "round": 0.05 }
    } }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "degrees_per_unit": -100, "child": { "translate": { "by": [0.2, 0.1, 0], "child": {
            "capsule": { "a": [-1.3, 0, 0], "b": [1.3, 0, 0], "radius": 0.15 }
        } } } }"#,
        r#"{ "degrees_per_unit": 0, "child": { "box": { "size": [1.6, 0.4, 0.7] } } }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let BentBounds { up, curvature, low, high, middle_z, half_z, end: (sin, cos), reach, top, lipschitz } =
            *self.arc();
        let (x, y) = (p.x, p.y * p.x.uniform(up));
        // All in radii of the circle, relative to its center.
        let (across, down) = (x * p.x.uniform(curvature), y.mul_add(p.x.uniform(-curvature), p.x.uniform(1.0)));
        let away = across.square_add(down.square()).sqrt();
        // 1/k − r, in a form that stays accurate if k is close to 0.
        let height = (y + y - x.square_add(y.square()) * p.x.uniform(curvature)) / (away + 1.0);
        let along = across.atan2(down) * p.x.uniform(1.0 / curvature);
        let child: V = sample(0, vec3(along, height * p.x.uniform(up), p.z));
        let past_end = x.abs().mul_add(p.x.uniform(cos), y.mul_add(p.x.uniform(sin), p.x.uniform(-sin / curvature)));
        let beyond = (p.x.uniform(low) - height)
            .max(height - p.x.uniform(high))
            .max((p.z - p.x.uniform(middle_z)).abs() - p.x.uniform(half_z))
            .max(past_end)
            .max(x.abs() - p.x.uniform(reach))
            .max(y - p.x.uniform(top));
        let to_half_plane =
            R::select(down.below(0.0), across.abs(), away) * p.x.uniform(lipschitz * GUARD_FRACTION / curvature);
        let distance = child.distance().min(to_half_plane).max(beyond * p.x.uniform(lipschitz));
        child.with_distance(distance)
    }

    around_child!();

    carries_child!(|self| self.degrees_per_unit.is_animated());

    fn lipschitz(&self) -> f32 {
        self.arc().lipschitz
    }

    fn own_exactness(&self) -> Exactness {
        self.child.exactness().max(Exactness::Bound)
    }

    fn validate(&self) -> Option<NodeError> {
        if let Some(fault) = require_bounded(&self.child, &['x', 'y'], "so a bend would wind it up") {
            return Some(fault);
        }
        let Bounds { min: low, max: high } = self.child.bounds(0.0);
        let degrees = self.degrees_per_unit.in_frame();
        let far = low.x.abs().max(high.x.abs());
        let high = if degrees < 0.0 { -low.y } else { high.y };
        let most = (180.0 / far).min(if high > 0.0 {
            ((1.0 - MIN_RADIUS_FRACTION) / high).to_degrees()
        } else {
            f32::INFINITY
        });
        if degrees.abs() < most {
            return None;
        }
        let message = format!(
            "makes the shape overlap itself: for a shape that extends to x = {far} and y = {high}, \
             make it less than {most}, or make the shape smaller"
        );
        Some(NodeError::new("degrees_per_unit", message))
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let BentBounds { up, low, middle_z, half_z, reach, top, lipschitz, .. } = *self.arc();
        let (low, high) = if up < 0.0 { (-top, -low) } else { (low, top) };
        let bounds = Bounds { min: vec3(-reach, low, middle_z - half_z), max: vec3(reach, high, middle_z + half_z) };
        bounds.expanded(isolevel / lipschitz)
    }

    fn lipschitz_advice(&self) -> &'static str {
        "bend it less, or make its child thinner"
    }
}
