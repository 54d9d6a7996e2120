//! Exclusive or: the points inside an odd number of shapes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::fold_children;
use super::seams::around_joined;
use crate::bounds::Bounds;
use crate::kinds::Exactness;
use crate::nodes::value::indicator;
use crate::nodes::{Node, Sdf, SdfValue};
use crate::real::{Real, Vec3};
use crate::seek::Seek;

/// The points inside an odd number of the shapes; for two shapes, inside one and outside the other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Xor {
    /// The shapes, one or more.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
}

impl Sdf for Xor {
    const EXAMPLE: &'static str = r#"{ "of": [
        { "box": { "size": [1.5, 1.5, 1.5] } },
        { "translate": { "by": [0.2, 0.3, 0.4], "child": { "sphere": { "radius": 0.75 } } } }
    ] }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[r#"{ "of": [
        { "sphere": { "radius": 1 } },
        { "infinite_cylinder": { "radius": 0.6 } },
        { "box": { "size": [0.8, 3, 0.8] } }
    ] }"#];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        fold_children(&self.of, p, sample, xor_distance)
    }

    around_joined!();

    fn bounds(&self, isolevel: f32) -> Bounds {
        // It is never less than the least of the distances.
        self.of.iter().map(|shape| shape.bounds(isolevel)).reduce(Bounds::union).unwrap_or(Bounds::INFINITE)
    }
}

/// Exclusive or of two values: max(min(a, b), −max(a, b)), the nearer of the two surfaces with a sign of its own. The
/// material of that surface is visible.
fn xor_distance<R: Real, V: SdfValue<R>>(a: V, b: V) -> V {
    let (da, db) = (a.distance(), b.distance());
    let (less, greater) = (da.min(db), -da.max(db));
    a.blend(b, less.max(greater), || {
        let is_less = indicator(da, db.lt(da));
        R::select(less.lt(greater), da.constant(1.0) - is_less, is_less)
    })
}
