//! Constructive solid geometry: combines shapes, sharply or smoothly.
//!
//! `of` is folded from the left. With `smooth` k > 0, h = max(k − |a − b|, 0) rounds the seam by h²/(4k):
//! Inigo Quilez's quadratic polynomial minimum, <https://iquilezles.org/articles/smin/>. The child whose
//! distance wins is seen; within the seam the other one has the weight ½(h/k)².
//!
//! All are bounds: exact where one child alone is near.

mod carving;
mod seams;
mod xor;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use carving::{Engrave, Groove, Morph, Tongue};
pub use seams::{Chamfer, Columns, Join, Stairs};
pub use xor::Xor;

use super::bvh::{Run, Runs};
use super::value::indicator;
use super::{Exactness, Node, Sample, Sdf};
use crate::bounds::Bounds;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::Amount;

/// The points inside any of the shapes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Union {
    /// The shapes, one or more.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Width of the melted seam; 0 is sharp.
    #[serde(default = "sharp")]
    pub smooth: Amount,
    /// Bounding volume hierarchy of the shapes.
    #[serde(skip)]
    pub runs: Runs,
}

/// The points inside all of the shapes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Difference {
    /// The shape to cut from, then those to cut away.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Width of the melted seam; 0 is sharp.
    #[serde(default = "sharp")]
    pub smooth: Amount,
}

/// Smooth minimum, blended over `smooth`.
#[inline(always)]
fn least<R: Real, V: Sample<R>>(a: V, b: V, smooth: &Amount) -> V {
    let (da, db) = (a.distance(), b.distance());
    if smooth.is_zero() {
        return a.blend(
            b,
            da.min(db),
            #[inline(always)]
            || indicator(da, db.lt(da)),
        );
    }
    let overlap = overlap(da, db, smooth);
    let distance = overlap.square().mul_add(da.given(-0.25 * per(smooth.get())), da.min(db));
    a.blend(
        b,
        distance,
        #[inline(always)]
        || share(overlap, smooth, db.lt(da)),
    )
}

/// Smooth maximum, blended over `smooth`.
#[inline(always)]
fn greatest<R: Real, V: Sample<R>>(a: V, b: V, smooth: &Amount) -> V {
    let (da, db) = (a.distance(), b.distance());
    if smooth.is_zero() {
        return a.blend(
            b,
            da.max(db),
            #[inline(always)]
            || indicator(da, da.lt(db)),
        );
    }
    let overlap = overlap(da, db, smooth);
    let distance = overlap.square().mul_add(da.given(0.25 * per(smooth.get())), da.max(db));
    a.blend(
        b,
        distance,
        #[inline(always)]
        || share(overlap, smooth, da.lt(db)),
    )
}

/// The first without the second.
#[inline(always)]
fn cut<R: Real, V: Sample<R>>(a: V, b: V, smooth: &Amount) -> V {
    greatest(a, negated(b), smooth)
}

/// h = max(k − |a − b|, 0): how far into the seam.
#[inline(always)]
fn overlap<R: Real>(a: R, b: R, smooth: &Amount) -> R {
    (a.given(smooth.get()) - (a - b).abs()).at_least(0.0)
}

/// One over a seam's width or its square; 0 if an animated seam has width 0, because then no point is in it.
#[inline(always)]
fn per(width: f32) -> f32 {
    if width == 0.0 { 0.0 } else { 1.0 / width }
}

/// Weight of the second child, whether it wins or loses: the loser has ½(h/k)².
#[inline(always)]
fn share<R: Real>(overlap: R, smooth: &Amount, second_wins: R::Mask) -> R {
    let loser = overlap.square() * overlap.given(0.5 * per(smooth.get() * smooth.get()));
    R::select(second_wins, loser.splat(1.0) - loser, loser)
}

#[inline(always)]
fn negated<R: Real, V: Sample<R>>(v: V) -> V {
    let distance = -v.distance();
    v.at(distance)
}

/// All shapes joined, one after another.
#[inline(always)]
fn joined<R: Real, V: Sample<R>>(of: &[Node], p: Vec3<R>, join: impl Fn(V, V) -> V) -> V {
    let mut sum: V = of[0].sample(p);
    for other in &of[1..] {
        sum = join(sum, other.sample(p));
    }
    sum
}

macro_rules! around_list {
    ($join_bounds:expr) => {
        const HAS_LIST: bool = true;

        fn bounds(&self, level: f32) -> Bounds {
            // Each seam bulges by a quarter of its width at most.
            let bulge = self.smooth.get() * 0.25 * (self.of.len() - 1) as f32;
            let mut of = self.of.iter().map(|shape| shape.bounds(level + bulge));
            let first = of.next().expect("a list has one shape or more");
            of.fold(first, $join_bounds)
        }

        fn exactness(&self) -> Exactness {
            self.of.iter().map(Node::exactness).fold(Exactness::Bound, Exactness::max)
        }

        fn children(&self) -> &[Node] {
            &self.of
        }

        fn children_mut(&mut self) -> &mut [Node] {
            &mut self.of
        }
    };
}

impl Sdf for Union {
    const EXAMPLE: &'static str = r#"{ "smooth": 0.3, "of": [
        { "sphere": { "radius": 0.7 } },
        { "translate": { "by": [0.8, 0.3, 0], "child": { "box": { "size": [0.9, 0.9, 0.9] } } } }
    ] }"#;

    #[inline(always)]
    fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V {
        match &self.runs.0 {
            Some(all) => self.join_run(all, self.of[0].sample(p), p),
            None => joined(
                &self.of,
                p,
                #[inline(always)]
                |a, b| least(a, b, &self.smooth),
            ),
        }
    }

    fn prepare(&mut self, moves: bool) {
        self.runs = Runs::of(&self.of, moves);
    }

    around_list!(Bounds::hull);
}

impl Union {
    /// Merges the shapes of a BVH node into the result so far, if the node is near enough: shapes farther
    /// away than the seam is wide do not change the minimum.
    fn join_run<R: Real, V: Sample<R>>(&self, run: &Run, sum: V, p: Vec3<R>) -> V {
        p.x.vectorize(
            #[inline(always)]
            || match &run.bounds {
                Some(bounds) => {
                    let beyond = bounds.distance_below(p);
                    let beyond = if self.smooth.is_zero() { beyond } else { beyond - p.x.given(self.smooth.get()) };
                    sum.unless_beyond(
                        beyond,
                        #[inline(always)]
                        |sum| self.join_shapes(run, sum, p),
                    )
                }
                None => self.join_shapes(run, sum, p),
            },
        )
    }

    #[inline(always)]
    fn join_shapes<R: Real, V: Sample<R>>(&self, run: &Run, sum: V, p: Vec3<R>) -> V {
        if let Some([first, second]) = run.halves.as_deref() {
            return self.join_run(second, self.join_run(first, sum, p), p);
        }
        let mut sum = sum;
        for shape in &self.of[run.shapes.clone()] {
            sum = least(sum, shape.sample(p), &self.smooth);
        }
        sum
    }
}

impl Sdf for Intersection {
    const EXAMPLE: &'static str = r#"{ "smooth": 0.1, "of": [
        { "sphere": { "radius": 1 } },
        { "box": { "size": [1.5, 1.5, 1.5] } }
    ] }"#;

    #[inline(always)]
    fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V {
        joined(
            &self.of,
            p,
            #[inline(always)]
            |a, b| greatest(a, b, &self.smooth),
        )
    }

    around_list!(Bounds::overlap);
}

impl Sdf for Difference {
    const EXAMPLE: &'static str = r#"{ "smooth": 0.05, "of": [
        { "box": { "size": [1.6, 1.6, 1.6] } },
        { "translate": { "by": [0.3, 0.4, 0.5], "child": { "sphere": { "radius": 0.9 } } } }
    ] }"#;

    #[inline(always)]
    fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V {
        joined(
            &self.of,
            p,
            #[inline(always)]
            |a, b| cut(a, b, &self.smooth),
        )
    }

    around_list!(|first, _| first);
}

fn sharp() -> Amount {
    Amount::new(0.0).expect("0 is in range")
}
