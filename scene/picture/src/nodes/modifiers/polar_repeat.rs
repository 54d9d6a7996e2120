//! Copies in a ring, correct across its sectors.
//!
//! For each point of a shape, the nearest of its copies is the one at the nearest angle. So only copies within half
//! the shape's own angle plus half a sector may be the nearest: two if the shape fits its sector, all if it extends
//! around the axis.

use std::f32::consts::{PI, TAU};

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use super::cached::Cached;
use super::nearest_copy::{ChildBounds, RepeatedChild, max_overlapping, nearest_whole, sample_nearest};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::nodes::transforms::around_child;
use crate::nodes::{Child, Node, Sdf, SdfValue};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::integer_in_range;

/// Maximum number of copies of a ring.
const MAX_COPIES: u32 = 10_000;
/// Maximum number of copies evaluated for one point.
const MAX_EVALUATED_COPIES: u32 = 64;

/// Copies of a shape in a ring about the y axis, one of them at the shape's own position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct PolarRepeat {
    /// Number of copies, evenly spaced around the axis.
    #[serde(deserialize_with = "copies")]
    #[schemars(range(min = 1, max = MAX_COPIES))]
    pub count: u32,
    /// The shape, translated away from the axis.
    pub child: Child,
    /// Values derived from the fields above.
    #[serde(skip)]
    #[schemars(skip)]
    ring: Cached<RingLayout>,
}

/// Position of the shape in the ring.
#[derive(Clone, Debug)]
struct RingLayout {
    /// Angle of its center, in radians from x to z.
    middle: f32,
    /// Width, in radians.
    width: f32,
    /// Number of copies that may be the nearest.
    reach: f32,
    /// Sine and cosine of a sector.
    turn: (f32, f32),
    held: ChildBounds,
}

impl PolarRepeat {
    fn sector(&self) -> f32 {
        TAU / self.count as f32
    }

    fn ring(&self) -> &RingLayout {
        self.ring.get(|| {
            let held = ChildBounds::new(&self.child);
            let (middle, width) = angles(held.bounds);
            let reach = max_overlapping(width, self.sector()).min(self.count as f32);
            RingLayout { middle, width, reach, turn: Real::sin_cos(self.sector()), held }
        })
    }
}

/// Angle of a box's center about the y axis, and the width of the box as an angle seen from the axis.
fn angles(Bounds { min: low, max: high }: Bounds) -> (f32, f32) {
    if low.x <= 0.0 && high.x >= 0.0 && low.z <= 0.0 && high.z >= 0.0 {
        return (0.0, TAU);
    }
    // With finite ends, so that there is a center; a box off the axis is less than half a turn wide.
    let (x, z) = (0.5 * (low.x + high.x), 0.5 * (low.z + high.z));
    let from_middle =
        |(corner_x, corner_z): (f32, f32)| Real::atan2(x * corner_z - z * corner_x, x * corner_x + z * corner_z);
    let corners = [(low.x, low.z), (low.x, high.z), (high.x, low.z), (high.x, high.z)].map(from_middle);
    let least = corners.into_iter().fold(PI, f32::min);
    let most = corners.into_iter().fold(-PI, f32::max);
    (Real::atan2(z, x) + 0.5 * (least + most), most - least)
}

impl Sdf for PolarRepeat {
    const EXAMPLE: &'static str = r#"{ "count": 9, "child": {
        "translate": { "by": [0.85, 0, 0], "child": { "box": { "size": [0.4, 0.9, 0.2], "round": 0.05 } } }
    } }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "count": 7, "child": { "capsule": { "a": [0.4, -0.5, -0.5], "b": [0.7, 0.5, 0.6], "radius": 0.12 } } }"#,
        r#"{ "count": 3, "child": { "box": { "size": [2, 0.3, 0.2] } } }"#,
        r#"{ "count": 24, "child": { "translate": { "by": [-0.7, 0.1, 0.6], "child": {
            "sphere": { "radius": 0.1 }
        } } } }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let (sector, RingLayout { middle, reach, turn, held, .. }) = (self.sector(), self.ring());
        let original = RepeatedChild::new(&self.child, held);
        let angle = p.z.atan2(p.x);
        let (near, side) = nearest_whole((angle - angle.uniform(*middle)) * angle.uniform(1.0 / sector));
        let first = side.mul_add(angle.uniform(-((reach - 1.0) * 0.5).floor()), near);
        // From here on, each copy is one sector farther to that side.
        let (sin, cos) = (first * angle.uniform(sector)).sin_cos();
        let place = vec3(p.x.mul_add(cos, p.z * sin), p.y, p.z.mul_add(cos, -(p.x * sin)));
        let (sin, cos) = (side * angle.uniform(turn.0), angle.uniform(turn.1));
        let (_, _, nearest) = R::repeat(
            MAX_EVALUATED_COPIES,
            (angle.constant(1.0), place, RepeatedChild::start(p)),
            |(looked_at, place, nearest)| {
                let nearest = original.nearer(place, nearest);
                let next = vec3(place.x.mul_add(cos, place.z * sin), place.y, place.z.mul_add(cos, -(place.x * sin)));
                (looked_at.lt(angle.uniform(*reach)), (looked_at + 1.0, next, nearest))
            },
        );
        sample_nearest(nearest, sample)
    }

    around_child!();

    /// Each copy is rotated as its points are.
    fn way_from_child<R: Real>(&self, _: &Self, [p, q]: [Vec3<R>; 2], way: Option<Vec3<R>>) -> Option<Vec3<R>> {
        way.map(|way| {
            let per_square = p.x.constant(1.0) / q.x.square_add(q.z.square()).at_least(1e-12);
            let cos = q.x.mul_add(p.x, q.z * p.z) * per_square;
            let sin = q.x.mul_add(p.z, -(q.z * p.x)) * per_square;
            vec3(way.x.mul_add(cos, -(way.z * sin)), way.y, way.x.mul_add(sin, way.z * cos))
        })
    }

    fn own_exactness(&self) -> Exactness {
        match self.child.exactness() {
            Exactness::Exact if self.count == 1 || self.ring().width < self.sector() => Exactness::Exact,
            Exactness::Exact => Exactness::Bound,
            child @ (Exactness::Bound | Exactness::Estimate) if self.ring().reach == self.count as f32 => child,
            // The value may jump where the set of evaluated copies changes, but it stays less than the distance.
            Exactness::Bound | Exactness::Estimate => Exactness::Estimate,
        }
    }

    fn validate(&self) -> Option<NodeError> {
        let reach = self.ring().reach;
        let fault = || {
            let message = format!(
                "makes {reach} copies overlap, more than {MAX_EVALUATED_COPIES}: make it less, \
                 or move the shape away from the y axis"
            );
            NodeError::new("count", message)
        };
        (reach > MAX_EVALUATED_COPIES as f32).then(fault)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let Bounds { min: low, max: high } = self.child.bounds(isolevel);
        let (x, z) = (low.x.abs().max(high.x.abs()), low.z.abs().max(high.z.abs()));
        let radius = Real::sqrt(x * x + z * z);
        Bounds { min: vec3(-radius, low.y, -radius), max: vec3(radius, high.y, radius) }
    }

    fn child_evaluations(&self) -> f32 {
        self.ring().reach
    }
}

fn copies<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 1, MAX_COPIES, "copies")
}
