//! Constructive solid geometry: combines shapes, sharply or smoothly.
//!
//! `of` is folded from the left. With `smooth` k > 0, h = max(k − |a − b|, 0) rounds the seam by h²/(4k): Inigo
//! Quilez's quadratic polynomial minimum, <https://iquilezles.org/articles/smin/>. The child whose distance is used is
//! visible; within the seam the other one has the weight ½(h/k)².
//!
//! All are bounds: exact where only one child is near.

mod carving;
mod seams;
mod xor;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use carving::{Engrave, Groove, Morph, Tongue};
pub use seams::{Chamfer, Columns, SeamKind, Stairs};
pub use xor::Xor;

use super::bvh::{BvhNode, UnionBvh};
use super::value::indicator;
use super::{Exactness, Node, Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::LengthOrZero;

/// The points inside any of the shapes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Union {
    /// The shapes, one or more.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Width of the smooth seam; 0 is sharp.
    #[serde(default = "default_smooth")]
    pub smooth: LengthOrZero,
    /// Bounding volume hierarchy of the shapes.
    #[serde(skip)]
    pub bvh: UnionBvh,
}

/// The points inside all of the shapes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Intersection {
    /// The shapes, one or more.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Width of the smooth seam; 0 is sharp.
    #[serde(default = "default_smooth")]
    pub smooth: LengthOrZero,
}

/// The first shape without the others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Difference {
    /// The shape to cut from, then the shapes to subtract.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Width of the smooth seam; 0 is sharp.
    #[serde(default = "default_smooth")]
    pub smooth: LengthOrZero,
}

/// Smooth minimum, blended over `smooth`.
fn smooth_min<R: Real, V: SdfValue<R>>(a: V, b: V, smooth: &LengthOrZero) -> V {
    let (da, db) = (a.distance(), b.distance());
    if smooth.is_zero() {
        return a.blend(b, da.min(db), || indicator(da, db.lt(da)));
    }
    let overlap = seam_depth(da, db, smooth);
    let distance = overlap.square().mul_add(da.uniform(-0.25 * per(smooth.get())), da.min(db));
    a.blend(b, distance, || seam_weight(overlap, smooth, db.lt(da)))
}

/// Smooth maximum, blended over `smooth`.
fn smooth_max<R: Real, V: SdfValue<R>>(a: V, b: V, smooth: &LengthOrZero) -> V {
    let (da, db) = (a.distance(), b.distance());
    if smooth.is_zero() {
        return a.blend(b, da.max(db), || indicator(da, da.lt(db)));
    }
    let overlap = seam_depth(da, db, smooth);
    let distance = overlap.square().mul_add(da.uniform(0.25 * per(smooth.get())), da.max(db));
    a.blend(b, distance, || seam_weight(overlap, smooth, da.lt(db)))
}

/// The first without the second.
fn smooth_subtract<R: Real, V: SdfValue<R>>(a: V, b: V, smooth: &LengthOrZero) -> V {
    smooth_max(a, negated(b), smooth)
}

/// h = max(k − |a − b|, 0): depth into the seam.
fn seam_depth<R: Real>(a: R, b: R, smooth: &LengthOrZero) -> R {
    (a.uniform(smooth.get()) - (a - b).abs()).at_least(0.0)
}

/// One over a seam's width or its square; 0 if an animated seam has width 0, because then no point is in it.
fn per(width: f32) -> f32 {
    if width == 0.0 { 0.0 } else { 1.0 / width }
}

/// Weight of the second child: the child whose distance is not used has ½(h/k)².
fn seam_weight<R: Real>(overlap: R, smooth: &LengthOrZero, second_wins: R::Mask) -> R {
    let loser = overlap.square() * overlap.uniform(0.5 * per(smooth.get() * smooth.get()));
    R::select(second_wins, loser.constant(1.0) - loser, loser)
}

fn negated<R: Real, V: SdfValue<R>>(v: V) -> V {
    let distance = -v.distance();
    v.with_distance(distance)
}

/// Combines all shapes, one after another.
fn fold_children<R: Real, V: SdfValue<R>>(of: &[Node], p: Vec3<R>, join: impl Fn(V, V) -> V) -> V {
    let mut sum: V = of[0].sample(p);
    for other in &of[1..] {
        sum = join(sum, other.sample(p));
    }
    sum
}

macro_rules! around_list {
    ($join_bounds:expr) => {
        const HAS_CHILD_LIST: bool = true;

        fn bounds(&self, isolevel: f32) -> Bounds {
            // Each seam bulges by a quarter of its width at most.
            let bulge = self.smooth.get() * 0.25 * (self.of.len() - 1) as f32;
            let mut of = self.of.iter().map(|shape| shape.bounds(isolevel + bulge));
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

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>) -> V {
        match &self.bvh.0 {
            Some(all) => self.union_bvh(all, self.of[0].sample(p), p),
            None => fold_children(&self.of, p, |a, b| smooth_min(a, b, &self.smooth)),
        }
    }

    fn precompute(&mut self, is_animated: bool) {
        self.bvh = UnionBvh::new(&self.of, is_animated);
    }

    around_list!(Bounds::union);
}

impl Union {
    /// Merges the shapes of a BVH node into the result so far, if the node is near enough: shapes farther away than
    /// the seam is wide do not change the minimum.
    fn union_bvh<R: Real, V: SdfValue<R>>(&self, run: &BvhNode, sum: V, p: Vec3<R>) -> V {
        match &run.bounds {
            Some(bounds) => {
                let beyond = bounds.distance_lower_bound(p);
                let beyond = if self.smooth.is_zero() { beyond } else { beyond - p.x.uniform(self.smooth.get()) };
                sum.combine_unless_farther(beyond, |sum| self.union_children(run, sum, p))
            }
            None => self.union_children(run, sum, p),
        }
    }

    fn union_children<R: Real, V: SdfValue<R>>(&self, run: &BvhNode, sum: V, p: Vec3<R>) -> V {
        if let Some([first, second]) = run.children.as_deref() {
            return self.union_bvh(second, self.union_bvh(first, sum, p), p);
        }
        let mut sum = sum;
        for shape in &self.of[run.shapes.clone()] {
            sum = smooth_min(sum, shape.sample(p), &self.smooth);
        }
        sum
    }
}

impl Sdf for Intersection {
    const EXAMPLE: &'static str = r#"{ "smooth": 0.1, "of": [
        { "sphere": { "radius": 1 } },
        { "box": { "size": [1.5, 1.5, 1.5] } }
    ] }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>) -> V {
        fold_children(&self.of, p, |a, b| smooth_max(a, b, &self.smooth))
    }

    around_list!(Bounds::intersection);
}

impl Sdf for Difference {
    const EXAMPLE: &'static str = r#"{ "smooth": 0.05, "of": [
        { "box": { "size": [1.6, 1.6, 1.6] } },
        { "translate": { "by": [0.3, 0.4, 0.5], "child": { "sphere": { "radius": 0.9 } } } }
    ] }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>) -> V {
        fold_children(&self.of, p, |a, b| smooth_subtract(a, b, &self.smooth))
    }

    around_list!(|first, _| first);

    fn subtracts(&self) -> bool {
        true
    }
}

fn default_smooth() -> LengthOrZero {
    LengthOrZero::new(0.0).expect("0 is in range")
}
