//! Exclusive or: the points inside an odd number of shapes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::joined;
use super::seams::around_joined;
use crate::bounds::Bounds;
use crate::nodes::value::indicator;
use crate::nodes::{Exactness, Node, Sample, Sdf};
use crate::real::{Real, Vec3};
use crate::seek::Seek;

/// The points inside an odd number of the shapes: of two, inside one and outside the other.
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
    const MORE: &'static [&'static str] = &[r#"{ "of": [
        { "sphere": { "radius": 1 } },
        { "infinite_cylinder": { "radius": 0.6 } },
        { "box": { "size": [0.8, 3, 0.8] } }
    ] }"#];

    #[inline(always)]
    fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V {
        joined(&self.of, p, either)
    }

    around_joined!();

    fn bounds(&self, level: f32) -> Bounds {
        // It is never less than the least of the distances.
        self.of.iter().map(|shape| shape.bounds(level)).reduce(Bounds::hull).unwrap_or(Bounds::EVERYWHERE)
    }
}

/// Exclusive or of two values: max(min(a, b), −max(a, b)), the nearer of the two surfaces with a sign of its
/// own. That surface is the one that is seen.
#[inline(always)]
fn either<R: Real, V: Sample<R>>(a: V, b: V) -> V {
    let (da, db) = (a.distance(), b.distance());
    let (less, greater) = (da.min(db), -da.max(db));
    a.blend(
        b,
        less.max(greater),
        #[inline(always)]
        || {
            let is_less = indicator(da, db.lt(da));
            R::select(less.lt(greater), da.splat(1.0) - is_less, is_less)
        },
    )
}
