//! Round solids: a cylinder with rounded edges, an ellipsoid, a spindle.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{distance_from_y_axis, hypot};
use crate::bounds::Bounds;
use crate::kinds::NodeError;
use crate::nodes::{Precompute, Precomputed, Primitive};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Length, LengthOrZero, Point};

/// A cylinder around the y axis with rounded edges, centered at the origin.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct RoundedCylinder {
    /// Radius.
    pub radius: Length,
    /// Full height.
    pub height: Length,
    /// Radius of its rounded edges, inside `radius` and `height`.
    pub round: LengthOrZero,
}

impl Primitive for RoundedCylinder {
    const EXAMPLE: &str = r#"{ "radius": 0.8, "height": 1.4, "round": 0.25 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let round = self.round.get();
        let past_side = distance_from_y_axis(p) - p.x.uniform(self.radius.get() - round);
        let past_cap = p.y.abs() - p.x.uniform(self.height.get() / 2.0 - round);
        let outside = hypot(past_side.at_least(0.0), past_cap.at_least(0.0));
        outside + past_side.max(past_cap).at_most(0.0) - p.x.uniform(round)
    }

    fn validate(&self) -> Option<NodeError> {
        let most = self.radius.in_frame().min(self.height.in_frame() / 2.0);
        (self.round.in_frame() > most).then(|| {
            NodeError::new(
                "round",
                format!(
                    "must be at most the radius and half the height, because edges are rounded inward: make round {most} or less"
                ),
            )
        })
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let radius = self.radius.in_frame();
        Bounds::symmetric(radius, self.height.in_frame() / 2.0, radius).expanded(isolevel)
    }
}

/// An ellipsoid around the origin, its axes along x, y and z.
///
/// The nearest point x satisfies p − x = t·∇, and so xᵢ = rᵢ²pᵢ/(t + rᵢ²), where t is such that x is on the
/// surface: David Eberly, "Distance from a Point to an Ellipse, an Ellipsoid, or a Hyperellipsoid",
/// <https://www.geometrictools.com/Documentation/DistancePointEllipseEllipsoid.pdf>. The inverse root of
/// Σ(xᵢ/rᵢ)² = 1 is nearly linear in t and concave, so that Newton's method converges from below and never
/// overshoots: Jorge Moré and Danny Sorensen, "Computing a Trust Region Step", SIAM Journal on Scientific and
/// Statistical Computing 4(3), 1983. With the normal n found there, the value is p·n − √Σ(rᵢnᵢ)², the distance to
/// the tangent plane with that normal. No such plane is farther away than the surface, and an error of n has a
/// quadratic effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename = "Ellipsoid", deny_unknown_fields)]
pub struct EllipsoidParams {
    /// Half its extents along x, y and z.
    pub radii: [Length; 3],
}

/// `EllipsoidParams` with its derived values.
pub type Ellipsoid = Precomputed<EllipsoidParams>;

/// Maximum number of Newton steps; only a few points near the center of a flat ellipsoid need that many.
const ELLIPSOID_STEPS: u32 = 12;
/// Tolerance of √Σ(xᵢ/rᵢ)² around 1: the remaining error is its square.
const ELLIPSOID_TOLERANCE: f32 = 2e-4;

/// An ellipsoid's radii as fractions of the largest, so that no square is out of range.
#[derive(Clone, Debug)]
pub struct ScaledRadii {
    largest: f32,
    radius: Vec3<f32>,
    over_radius: Vec3<f32>,
    /// radius² − least².
    excess_squared: Vec3<f32>,
}

impl Precompute for EllipsoidParams {
    type Derived = ScaledRadii;

    fn derive(&self) -> ScaledRadii {
        let [x, y, z] = self.radii.each_ref().map(Length::in_frame);
        let (largest, least) = (x.max(y).max(z), x.min(y).min(z));
        let radius = vec3(x, y, z).map(|c| c / largest);
        let least = least / largest;
        let past_least = radius.map(|c| (c - least) * (c + least));
        ScaledRadii { largest, radius, over_radius: radius.map(|c| 1.0 / c), excess_squared: past_least }
    }
}

impl Primitive for Ellipsoid {
    const EXAMPLE: &str = r#"{ "radii": [1.1, 0.6, 0.8] }"#;

    const MORE_EXAMPLES: &[&str] = &[r#"{ "radii": [1, 0.1, 1] }"#, r#"{ "radii": [0.2, 1.1, 0.3] }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let &ScaledRadii { largest, radius, over_radius, excess_squared: past_least } = self.derive();
        let (radius, over_radius) = (Vec3::uniform(p.x, radius), Vec3::uniform(p.x, over_radius));
        let past_least = Vec3::uniform(p.x, past_least);
        let place = vec3(p.x.abs(), p.y.abs(), p.z.abs()) * p.x.uniform(1.0 / largest);
        // A point on a plane of symmetry may have its nearest points on both sides: start from one
        // side.
        let reach = times(radius, place.map(|c| c.at_least(1e-6)));
        // No greater than the root: for one coordinate alone, and for all as if on the largest ball.
        let start = (reach - past_least).max_element().max(reach.length() - past_least.max_element());
        let t = R::repeat(ELLIPSOID_STEPS, start, |t| {
            let (ratio, inverse) = nearest_ratio(reach, past_least, t);
            let size = ratio.length();
            let slope = times(ratio, ratio).dot(inverse);
            let step = (size - 1.0).at_least(0.0) * size.square() / slope;
            (size.above(1.0 + ELLIPSOID_TOLERANCE), t + step)
        });
        let (ratio, _) = nearest_ratio(reach, past_least, t);
        let normal = times(ratio, over_radius);
        (normal.dot(place) - ratio.length()) / normal.length() * p.x.uniform(largest)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let [x, y, z] = &self.radii;
        Bounds::symmetric(x.in_frame(), y.in_frame(), z.in_frame()).expanded(isolevel)
    }
}

/// Nearest point divided by the radii, if `t` is `excess_squared` beyond −least²; and 1/(t + radius²).
fn nearest_ratio<R: Real>(reach: Vec3<R>, past_least: Vec3<R>, t: R) -> (Vec3<R>, Vec3<R>) {
    let inverse = past_least.map(|c| t.constant(1.0) / (c + t));
    (times(reach, inverse), inverse)
}

/// Product of each coordinate.
fn times<R: Real>(a: Vec3<R>, b: Vec3<R>) -> Vec3<R> {
    vec3(a.x * b.x, a.y * b.y, a.z * b.z)
}

/// A spindle between two points: the arc of a circle through both, rotated about the line between them.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Vesica {
    /// One tip.
    pub a: Point,
    /// The other tip.
    pub b: Point,
    /// Radius halfway between the tips.
    pub radius: Length,
}

impl Vesica {
    /// Half the vector between the tips, from `a`.
    fn half_axis(&self) -> Vec3<f32> {
        (self.b.in_frame() - self.a.in_frame()) * 0.5
    }
}

impl Primitive for Vesica {
    const EXAMPLE: &str = r#"{ "a": [-0.5, -0.9, 0], "b": [0.5, 0.9, 0.2], "radius": 0.45 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let half_axis = self.half_axis();
        let (half, radius) = (half_axis.length(), self.radius.in_frame());
        // The arc's center is this far behind the axis.
        let behind = ((half - radius) * (half + radius) / (2.0 * radius)).max(0.0);
        let around = behind + radius;
        let from_middle = p - Vec3::uniform(p.x, self.a.in_frame() + half_axis);
        let unit = Vec3::uniform(p.x, half_axis * (1.0 / half.max(1e-12)));
        let along = from_middle.dot(unit);
        let across = unit.mul_add(-along, from_middle).length();
        let (along, behind, half) = (along.abs(), p.x.uniform(behind), p.x.uniform(half));
        let past_tip = (across * half).lt((along - half) * behind);
        let to_tip = across.square_add((along - half).square());
        let to_center = (across + behind).square_add(along.square());
        let distance = R::select(past_tip, to_tip, to_center).sqrt();
        // Remaining offset to a distant center, without subtracting large numbers.
        let over_circle = (across + behind * 2.0).mul_add(across, (along - half) * (along + half));
        R::select(past_tip, distance, over_circle / (distance + p.x.uniform(around)))
    }

    fn validate(&self) -> Option<NodeError> {
        let half = self.half_axis().length();
        if half < crate::limits::MIN_LENGTH {
            return Some(NodeError::new("b", "equals a: put the two tips at different points"));
        }
        (self.radius.in_frame() > half).then(|| {
            NodeError::new(
                "radius",
                format!(
                    "must be at most half the distance from a to b, so that it has tips: make radius {half} or less"
                ),
            )
        })
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (a, b) = (self.a.in_frame(), self.b.in_frame());
        Bounds { min: a, max: a }.union(Bounds { min: b, max: b }).expanded(self.radius.in_frame() + isolevel)
    }
}
