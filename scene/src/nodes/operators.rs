//! Constructive solid geometry: two or more shapes made one, sharply or melted together.
//!
//! `of` is folded from the left. With `smooth` k > 0, h = max(k − |a − b|, 0) rounds the seam by
//! h²/(4k): Inigo Quilez's quadratic polynomial minimum, <https://iquilezles.org/articles/smin/>.
//! The child whose distance wins is the one that is seen; within the seam the loser has the share ½(h/k)².
//!
//! All are bounds: exact where one child alone is near.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::sample::indicator;
use super::{Node, Sample, Sdf};
use crate::bounds::Bounds;
use crate::real::{Real, Vec3};
use crate::values::Amount;

/// What is in any of the shapes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Union {
    /// The shapes, one or more.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Width of the melted seam; 0 is sharp.
    #[serde(default = "sharp")]
    pub smooth: Amount,
}

/// What is in all of the shapes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Intersection {
    /// The shapes, one or more.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Width of the melted seam; 0 is sharp.
    #[serde(default = "sharp")]
    pub smooth: Amount,
}

/// The first shape without the others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Difference {
    /// The shape to cut from, then those to cut away.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Width of the melted seam; 0 is sharp.
    #[serde(default = "sharp")]
    pub smooth: Amount,
}

/// The lesser of two, melted over `smooth`.
#[inline(always)]
fn least<R: Real, V: Sample<R>>(a: V, b: V, smooth: Amount) -> V {
    let (da, db, smooth) = (a.distance(), b.distance(), smooth.get());
    if smooth == 0.0 {
        return a.blend(
            b,
            da.min(db),
            #[inline(always)]
            || indicator(da, db.lt(da)),
        );
    }
    let overlap = overlap(da, db, smooth);
    let distance = overlap.square().mul_add(da.given(-0.25 / smooth), da.min(db));
    a.blend(
        b,
        distance,
        #[inline(always)]
        || share(overlap, smooth, db.lt(da)),
    )
}

/// The greater of two, melted over `smooth`.
#[inline(always)]
fn greatest<R: Real, V: Sample<R>>(a: V, b: V, smooth: Amount) -> V {
    let (da, db, smooth) = (a.distance(), b.distance(), smooth.get());
    if smooth == 0.0 {
        return a.blend(
            b,
            da.max(db),
            #[inline(always)]
            || indicator(da, da.lt(db)),
        );
    }
    let overlap = overlap(da, db, smooth);
    let distance = overlap.square().mul_add(da.given(0.25 / smooth), da.max(db));
    a.blend(
        b,
        distance,
        #[inline(always)]
        || share(overlap, smooth, da.lt(db)),
    )
}

/// The first without the second.
#[inline(always)]
fn cut<R: Real, V: Sample<R>>(a: V, b: V, smooth: Amount) -> V {
    greatest(a, negated(b), smooth)
}

/// h = max(k − |a − b|, 0): how far into the seam.
#[inline(always)]
fn overlap<R: Real>(a: R, b: R, smooth: f32) -> R {
    (a.given(smooth) - (a - b).abs()).at_least(0.0)
}

/// The second child's share where it wins or loses: the loser has ½(h/k)².
#[inline(always)]
fn share<R: Real>(overlap: R, smooth: f32, second_wins: R::Mask) -> R {
    let loser = overlap.square() * overlap.given(0.5 / (smooth * smooth));
    R::select(second_wins, loser.splat(1.0) - loser, loser)
}

#[inline(always)]
fn negated<R: Real, V: Sample<R>>(v: V) -> V {
    let distance = -v.distance();
    v.at(distance)
}

macro_rules! operator {
    ($Kind:ident, $example:literal, $join:expr, $bounds:expr) => {
        impl Sdf for $Kind {
            const EXAMPLE: &'static str = $example;
            const HAS_LIST: bool = true;

            #[inline(always)]
            fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V {
                let mut joined: V = self.of[0].sample(p);
                for other in &self.of[1..] {
                    joined = $join(joined, other.sample(p), self.smooth);
                }
                joined
            }

            fn bounds(&self, level: f32) -> Bounds {
                // Each seam bulges by a quarter of its width at most.
                let bulge = self.smooth.get() * 0.25 * (self.of.len() - 1) as f32;
                let mut of = self.of.iter().map(|shape| shape.bounds(level + bulge));
                let first = of.next().expect("a list has one shape or more");
                of.fold(first, $bounds)
            }

            fn children(&self) -> &[Node] {
                &self.of
            }

            fn children_mut(&mut self) -> &mut [Node] {
                &mut self.of
            }
        }
    };
}

operator!(
    Union,
    r#"{ "smooth": 0.3, "of": [
        { "sphere": { "radius": 0.7 } },
        { "translate": { "by": [0.8, 0.3, 0], "child": { "box": { "size": [0.9, 0.9, 0.9] } } } }
    ] }"#,
    least,
    Bounds::hull
);
operator!(
    Intersection,
    r#"{ "smooth": 0.1, "of": [
        { "sphere": { "radius": 1 } },
        { "box": { "size": [1.5, 1.5, 1.5] } }
    ] }"#,
    greatest,
    Bounds::overlap
);
operator!(
    Difference,
    r#"{ "smooth": 0.05, "of": [
        { "box": { "size": [1.6, 1.6, 1.6] } },
        { "translate": { "by": [0.3, 0.4, 0.5], "child": { "sphere": { "radius": 0.9 } } } }
    ] }"#,
    cut,
    |first, _| first
);

fn sharp() -> Amount {
    Amount::new(0.0).expect("0 is in range")
}
