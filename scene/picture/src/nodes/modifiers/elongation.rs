//! Longer shapes: elongated at the center, or stretched along each axis.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bounds::Bounds;
use crate::kinds::Exactness;
use crate::nodes::carried::carries_child;
use crate::nodes::transforms::around_child;
use crate::nodes::{Child, Node, Sdf, SdfValue};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{LengthOrZero, ScaleFactor};

/// A shape cut at its center and pulled apart; the cut's cross-section fills the space between.
///
/// Inigo Quilez, "Distance functions", elongation: <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Elongate {
    /// Added length along x, y and z.
    pub by: [LengthOrZero; 3],
    /// The shape.
    pub child: Child,
}

/// Scales a shape along each axis separately.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Stretch {
    /// Factors along x, y and z.
    pub by: [ScaleFactor; 3],
    /// The shape.
    pub child: Child,
}

impl Sdf for Elongate {
    const EXAMPLE: &'static str = r#"{ "by": [0.8, 0, 0.4], "child": { "torus": { "radius": 0.4, "tube": 0.2 } } }"#;
    const MORE_EXAMPLES: &'static [&'static str] =
        &[r#"{ "by": [0, 0.9, 0], "child": { "sphere": { "radius": 0.6 } } }"#];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let [x, y, z] = &self.by;
        sample(0, vec3(elongated(p.x, x), elongated(p.y, y), elongated(p.z, z)))
    }

    // No two points become farther apart, so the child's Lipschitz factor remains.
    around_child!();

    /// Both ends move as the length grows, and points between them in proportion.
    fn way_from_child<R: Real>(&self, next: &Self, [p, q]: [Vec3<R>; 2], way: Option<Vec3<R>>) -> Option<Vec3<R>> {
        let growths: [Option<f32>; 3] = std::array::from_fn(|axis| {
            let (by, next) = (&self.by[axis], &next.by[axis]);
            by.is_animated().then(|| if by.in_frame() == 0.0 { 0.0 } else { next.in_frame() / by.in_frame() - 1.0 })
        });
        way_of_parts(growths, p - q, way)
    }

    fn own_exactness(&self) -> Exactness {
        self.child.exactness().max(Exactness::Bound)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let Bounds { min: low, max: high } = self.child.bounds(isolevel);
        let [x, y, z] = self.by.each_ref().map(|by| 0.5 * by.in_frame());
        Bounds { min: vec3(low.x - x, low.y - y, low.z - z), max: vec3(high.x + x, high.y + y, high.z + z) }
    }
}

/// A way, and along the axes that grow the way of an offset.
pub(super) fn way_of_parts<R: Real>(
    growths: [Option<f32>; 3],
    offset: Vec3<R>,
    way: Option<Vec3<R>>,
) -> Option<Vec3<R>> {
    if growths.iter().all(Option::is_none) {
        return way;
    }
    let [x, y, z] = growths;
    let own = |offset: R, growth: Option<f32>| offset * growth.map_or(offset.constant(0.0), |by| offset.uniform(by));
    let own = vec3(own(offset.x, x), own(offset.y, y), own(offset.z, z));
    Some(way.map_or(own, |way| way + own))
}

/// Coordinate before elongation.
fn elongated<R: Real>(c: R, by: &LengthOrZero) -> R {
    let half = c.uniform(0.5 * by.get());
    c - c.min(half).max(-half)
}

impl Stretch {
    fn factors(&self) -> Vec3<f32> {
        let [x, y, z] = self.by.each_ref().map(ScaleFactor::in_frame);
        vec3(x, y, z)
    }

    fn outward<R: Real>(&self, q: Vec3<R>) -> Vec3<R> {
        q.mul_elementwise(Vec3::uniform(q.x, self.factors()))
    }

    fn min_factor(&self) -> f32 {
        let Vec3 { x, y, z } = self.factors();
        x.min(y).min(z)
    }
}

impl Sdf for Stretch {
    const EXAMPLE: &'static str = r#"{ "by": [1.1, 0.5, 0.8], "child": { "sphere": { "radius": 1 } } }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[r#"{ "by": [1.5, 1, 0.6], "child": { "rotate": {
        "degrees": [0, 0, 30], "child": { "torus": { "radius": 0.5, "tube": 0.2 } }
    } } }"#];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let per = Vec3::uniform(p.x, self.factors().map(|factor| 1.0 / factor));
        let child: V = sample(0, vec3(p.x * per.x, p.y * per.y, p.z * per.z));
        let distance = child.distance() * p.x.uniform(self.min_factor());
        child.with_distance(distance)
    }

    // Distances grow by at most 1/min_factor, by which the value is multiplied: the child's Lipschitz factor remains.
    around_child!();

    carries_child!(|self| self.by.iter().any(ScaleFactor::is_animated));

    fn own_exactness(&self) -> Exactness {
        self.child.exactness().max(Exactness::Bound)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let Bounds { min: low, max: high } = self.child.bounds(isolevel / self.min_factor());
        let Vec3 { x, y, z } = self.factors();
        Bounds { min: vec3(low.x * x, low.y * y, low.z * z), max: vec3(high.x * x, high.y * y, high.z * z) }
    }
}
