//! Tubes along curves.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bounds::Bounds;
use crate::kinds::Exactness;
use crate::nodes::{Precompute, Precomputed, Primitive};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Length, Point};

/// All points within a radius of a quadratic Bézier curve.
///
/// The squared distance to the point at t is a polynomial of degree four, whose derivative is a cubic; see Inigo
/// Quilez, "2D distance functions": <https://iquilezles.org/articles/distfunctions2d/>. Its roots are found here by
/// Newton's method instead of Cardano's formula, which loses precision if the curve is nearly straight. The cubic has
/// its inflection at the parabola's vertex. After that it is convex, so that steps from t = 1 run down to its last
/// root and never past it; before that, by symmetry, steps from t = 0 run up to its first. The nearest point is one of
/// the two, because a root between them is a point of greatest distance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename = "BezierTube", deny_unknown_fields)]
pub struct BezierTubeParams {
    /// Start of the curve.
    pub a: Point,
    /// Control point: the curve leaves `a` toward it, and arrives at `c` from it.
    pub b: Point,
    /// End of the curve.
    pub c: Point,
    /// The radius.
    pub radius: Length,
}

/// `BezierTubeParams` with its derived values.
pub type BezierTube = Precomputed<BezierTubeParams>;

/// Maximum number of Newton steps: enough for 10⁻⁵ of the curve's length on the sharpest bend.
const NEWTON_STEPS: u32 = 16;
/// A step this short, in the curve's t, is the last one: the remaining error is of the order of its square.
const NEWTON_TOLERANCE: f32 = 1e-4;

/// The curve a + t·slope + t²·bend, and values derived from it.
#[derive(Clone, Debug)]
pub struct BezierCoefficients {
    slope: Vec3<f32>,
    bend: Vec3<f32>,
    /// The t of the parabola's vertex, or the nearest end.
    vertex: f32,
    /// Slope and twice the bend, over the square of the curve's size.
    slope_over_size: Vec3<f32>,
    bend_over_size: Vec3<f32>,
    /// The cubic's constant coefficients: of t³, of t², and part of that of t.
    cubic: [f32; 3],
}

impl Precompute for BezierTubeParams {
    type Derived = BezierCoefficients;

    fn derive(&self) -> BezierCoefficients {
        let [a, b, c] = [&self.a, &self.b, &self.c].map(Point::in_frame);
        let (slope, bend) = ((b - a) * 2.0, (a - b) + (c - b));
        let (along, bends) = (slope.length_squared(), bend.length_squared());
        let over_size = 1.0 / (along + bends).max(1e-20);
        BezierCoefficients {
            slope,
            bend,
            vertex: vertex(slope, bend),
            slope_over_size: slope * over_size,
            bend_over_size: bend * (2.0 * over_size),
            cubic: [2.0 * bends, 3.0 * slope.dot(bend), along].map(|coefficient| coefficient * over_size),
        }
    }
}

/// The t of the parabola's vertex, or the nearest end.
fn vertex(slope: Vec3<f32>, bend: Vec3<f32>) -> f32 {
    let (against, twice) = (-slope.dot(bend), 2.0 * bend.length_squared());
    if against <= 0.0 {
        0.0
    } else if against >= twice {
        1.0
    } else {
        against / twice
    }
}

impl BezierCoefficients {
    /// Its least radius of curvature: |v|³/|v × v′|, least at the vertex; infinite for a line.
    fn least_bend_radius(&self) -> f32 {
        let velocity = self.slope + self.bend * (2.0 * self.vertex);
        let turn = self.slope.cross(self.bend).length() * 2.0;
        let speed = velocity.length();
        // A curve along a line may reverse on itself: it is still a line.
        let straight = turn <= 1e-6 * (self.slope.length_squared() + self.bend.length_squared());
        if straight { f32::INFINITY } else { speed * speed * speed / turn }
    }
}

/// third·t³ + second·t² + first·t + constant.
struct Cubic<R> {
    third: R,
    second: R,
    first: R,
    constant: R,
}

impl<R: Real> Cubic<R> {
    /// Value of the cubic, and one over its derivative. If the derivative is 0, a step by the latter leaves the curve.
    fn newton(&self, t: R) -> (R, R) {
        let value = self.third.mul_add(t, self.second).mul_add(t, self.first).mul_add(t, self.constant);
        let rise = (self.third * 3.0).mul_add(t, self.second * 2.0).mul_add(t, self.first);
        (value, t.constant(1.0) / rise.at_least(1e-7))
    }
}

/// Squared distance to the curve's point at t, from a point whose vector from the curve's start is `from_p`.
fn distance_squared_at<R: Real>(from_p: Vec3<R>, curve: &BezierCoefficients, t: R) -> R {
    let (slope, bend) = (Vec3::uniform(t, curve.slope), Vec3::uniform(t, curve.bend));
    bend.mul_add(t, slope).mul_add(t, from_p).length_squared()
}

impl Primitive for BezierTube {
    const EXAMPLE: &str = r#"{ "a": [-1, -0.7, 0.2], "b": [0, 1.8, -0.5], "c": [0.9, -0.6, 0.3], "radius": 0.2 }"#;

    const MORE_EXAMPLES: &[&str] = &[r#"{ "a": [-0.7, -0.8, 0], "b": [2, 0, 0], "c": [-0.7, 0.8, 0], "radius": 0.2 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let curve = self.derive();
        let vertex = p.x.uniform(curve.vertex);
        let from_p = Vec3::uniform(p.x, self.a.get()) - p;
        // The slope of half the squared distance, over the square of the curve's size.
        let [third, second, first] = curve.cubic;
        let (third, second) = (p.x.uniform(third), p.x.uniform(second));
        let first = from_p.dot_uniform(curve.bend_over_size) + p.x.uniform(first);
        let constant = from_p.dot_uniform(curve.slope_over_size);
        let cubic = Cubic { third, second, first, constant };
        let last = R::repeat(NEWTON_STEPS, p.x.constant(1.0), |t| {
            let (value, over_rise) = cubic.newton(t);
            let next = (t - value.at_least(0.0) * over_rise).max(vertex);
            ((t - next).above(NEWTON_TOLERANCE), next)
        });
        let first = R::repeat(NEWTON_STEPS, p.x.constant(0.0), |t| {
            let (value, over_rise) = cubic.newton(t);
            let next = (t - value.at_most(0.0) * over_rise).min(vertex);
            ((next - t).above(NEWTON_TOLERANCE), next)
        });
        let nearest = distance_squared_at(from_p, curve, first).min(distance_squared_at(from_p, curve, last));
        nearest.sqrt() - p.x.uniform(self.radius.get())
    }

    fn exactness(&self) -> Exactness {
        // If a bend is sharper than the tube is thick, the depth inside exceeds the formula's value.
        if self.derive().least_bend_radius() >= self.radius.in_frame() { Exactness::Exact } else { Exactness::Bound }
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (a, c) = (self.a.in_frame(), self.c.in_frame());
        let &BezierCoefficients { slope, bend, .. } = self.derive();
        // Along an axis, the curve is farthest where its derivative is 0.
        let furthest = |a: f32, slope: f32, bend: f32| {
            let t = if bend == 0.0 { 0.0 } else { (-slope / (2.0 * bend)).clamp(0.0, 1.0) };
            a + t * (slope + t * bend)
        };
        let turn = vec3(furthest(a.x, slope.x, bend.x), furthest(a.y, slope.y, bend.y), furthest(a.z, slope.z, bend.z));
        let at = |corner: Vec3<f32>| Bounds { min: corner, max: corner };
        at(a).union(at(c)).union(at(turn)).expanded(self.radius.in_frame() + isolevel)
    }
}
