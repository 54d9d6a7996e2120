//! Constructive solid geometry: combines shapes, sharply or smoothly.
//!
//! `of` is folded from the left. With `smooth` k > 0, h = max(k − |a − b|, 0) rounds the seam by h²/(4k): Inigo Quilez's quadratic polynomial minimum,
//! <https://iquilezles.org/articles/smin/>. The child whose distance is used is visible; within the seam the other one
//! has the weight ½(h/k)².
//!
//! All are bounds: exact where only one child is near.

mod carving;
mod seams;
mod xor;

use std::ops::Range;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use carving::{Engrave, Groove, Morph, Tongue};
pub use seams::{Chamfer, Columns, SeamKind, Stairs};
pub use xor::Xor;

use super::bvh::{BvhNode, GroupNode, UnionBvh};
use super::cut::{Cut, Part};
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
pub fn smooth_min<R: Real, V: SdfValue<R>>(a: V, b: V, smooth: &LengthOrZero) -> V {
    let (da, db) = (a.distance(), b.distance());
    if smooth.is_zero() {
        return a.blend(b, da.min(db), || union_weight(da, db, smooth));
    }
    let overlap = seam_depth(da, db, smooth);
    let distance = overlap.square().mul_add(da.uniform(-0.25 * per(smooth.in_frame())), da.min(db));
    a.blend(b, distance, || seam_weight(overlap, smooth, db.lt(da)))
}

/// Weight of the second shape in the smooth minimum of two distances.
pub fn union_weight<R: Real>(a: R, b: R, smooth: &LengthOrZero) -> R {
    if smooth.is_zero() {
        return indicator(a, b.lt(a));
    }
    seam_weight(seam_depth(a, b, smooth), smooth, b.lt(a))
}

/// Smooth maximum, blended over `smooth`.
fn smooth_max<R: Real, V: SdfValue<R>>(a: V, b: V, smooth: &LengthOrZero) -> V {
    let (da, db) = (a.distance(), b.distance());
    if smooth.is_zero() {
        return a.blend(b, da.max(db), || indicator(da, da.lt(db)));
    }
    let overlap = seam_depth(da, db, smooth);
    let distance = overlap.square().mul_add(da.uniform(0.25 * per(smooth.in_frame())), da.max(db));
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
    let loser = overlap.square() * overlap.uniform(0.5 * per(smooth.in_frame() * smooth.in_frame()));
    R::select(second_wins, loser.constant(1.0) - loser, loser)
}

fn negated<R: Real, V: SdfValue<R>>(v: V) -> V {
    let distance = -v.distance();
    v.with_distance(distance)
}

/// Combines all shapes, one after another.
fn fold_children<R: Real, V: SdfValue<R>>(
    of: &[Node],
    p: Vec3<R>,
    sample: &impl Fn(usize, Vec3<R>) -> V,
    join: impl Fn(V, V) -> V,
) -> V {
    fold_left(0..of.len(), 1, &mut |range| sample(range.start, p), &join)
}

/// Maximum number of shapes that a smooth union combines one after another.
const MAX_LEFT_FOLD: usize = 64;
/// Number of parts of each group of a larger smooth union.
const GROUP_PARTS: usize = 8;

/// Whether the shapes of a union are combined in groups. The seam of a left fold may reach any later shape, so that no
/// part of a long list could be left out where it is distant; groups end that.
pub(super) fn is_grouped(count: usize, smooth: &LengthOrZero) -> bool {
    count > MAX_LEFT_FOLD && !smooth.is_zero()
}

/// Combines the values of `count` leaves: one after another, or in groups of eight, groups of eight of these, and so on,
/// in the order of their indices.
pub(super) fn fold_indexed<V>(
    count: usize,
    in_groups: bool,
    leaf: &mut impl FnMut(usize) -> V,
    join: &impl Fn(V, V) -> V,
) -> V {
    if in_groups {
        fold_group(0..count, leaf, join)
    } else {
        fold_left(0..count, 1, &mut |range| leaf(range.start), join)
    }
}

fn fold_group<V>(range: Range<usize>, leaf: &mut impl FnMut(usize) -> V, join: &impl Fn(V, V) -> V) -> V {
    let part = group_part(range.len());
    if part == 1 {
        return fold_left(range, 1, &mut |range| leaf(range.start), join);
    }
    fold_left(range, part, &mut |range| fold_group(range, leaf, join), join)
}

/// Length of the parts of a group: the greatest power of eight below its own.
pub(super) fn group_part(length: usize) -> usize {
    let mut part = 1;
    while part * GROUP_PARTS < length {
        part *= GROUP_PARTS;
    }
    part
}

/// Combines parts of `part` leaves, from the left.
fn fold_left<V>(
    range: Range<usize>,
    part: usize,
    value: &mut impl FnMut(Range<usize>) -> V,
    join: &impl Fn(V, V) -> V,
) -> V {
    let mut parts = range.clone().step_by(part).map(|start| start..range.end.min(start + part));
    let first = value(parts.next().expect("a list has one shape or more"));
    parts.fold(first, |sum, part| join(sum, value(part)))
}

/// Maximum by which the smooth union of `count` shapes is less than the least of their distances, in widths of the
/// seam. Of equal distances, a seam gives a quarter less; of a sum that is `u` widths less, (1 − u)²/4 less than that.
pub(super) fn seam_sink(count: usize, in_groups: bool) -> f32 {
    let joined = |parts: usize, of_part: f32| {
        // It approaches 1, and after some hundred parts it is 1 for all purposes.
        (1..parts.min(1 << 10)).fold(of_part, |sink, _| {
            let apart = sink - of_part;
            sink + 0.25 * (1.0 - apart) * (1.0 - apart)
        })
    };
    let (mut sink, mut groups) = (0.0, count);
    while in_groups && groups > GROUP_PARTS {
        sink = joined(GROUP_PARTS, sink);
        groups = groups.div_ceil(GROUP_PARTS);
    }
    joined(groups, sink)
}

macro_rules! around_list {
    ($sink:expr, $join_bounds:expr) => {
        fn has_child_list(&self) -> bool {
            true
        }

        fn bounds(&self, isolevel: f32) -> Bounds {
            let sink: fn(&Self) -> f32 = $sink;
            let isolevel = isolevel + self.smooth.in_frame() * sink(self);
            let mut of = self.of.iter().map(|shape| shape.bounds(isolevel));
            let first = of.next().expect("a list has one shape or more");
            of.fold(first, $join_bounds)
        }

        fn own_exactness(&self) -> Exactness {
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
    const ALIASES: &'static [&'static str] = &["combine", "join", "merge"];
    const EXAMPLE: &'static str = r#"{ "smooth": 0.3, "of": [
        { "sphere": { "radius": 0.7 } },
        { "translate": { "by": [0.8, 0.3, 0], "child": { "box": { "size": [0.9, 0.9, 0.9] } } } }
    ] }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        union_indexed(self.of.len(), &self.smooth, &self.bvh, &|index| sample(index, p), p)
    }

    fn prepare(&mut self, is_animated: bool) {
        let shapes = self.of.iter().map(|shape| (shape.bounds(0.0), shape.node_count()));
        self.bvh = UnionBvh::new(shapes, self.is_grouped(), is_animated);
    }

    fn cut(&self) -> Cut<'_> {
        Cut::Union(&self.smooth, self.of.iter().map(Part::Shape).collect())
    }

    around_list!(|union| seam_sink(union.of.len(), union.is_grouped()), Bounds::union);
}

impl Union {
    fn is_grouped(&self) -> bool {
        is_grouped(self.of.len(), &self.smooth)
    }
}

/// Combines the values of `count` shapes; `bvh` is their hierarchy, if they have one.
pub(super) fn union_indexed<R: Real, V: SdfValue<R>>(
    count: usize,
    smooth: &LengthOrZero,
    bvh: &UnionBvh,
    shape: &impl Fn(usize) -> V,
    p: Vec3<R>,
) -> V {
    let join = |a, b| smooth_min(a, b, smooth);
    let with_bvh = BvhUnion { smooth, shape, join: &join, p };
    match bvh {
        UnionBvh::None => fold_indexed(count, is_grouped(count, smooth), &mut |index| shape(index), &join),
        UnionBvh::Halves(all) => with_bvh.merge(all, shape(0)),
        UnionBvh::Groups(all) => with_bvh.group(all),
    }
}

/// Union of shapes in a hierarchy, evaluated at `p`.
struct BvhUnion<'a, R, S, J> {
    smooth: &'a LengthOrZero,
    shape: &'a S,
    join: &'a J,
    p: Vec3<R>,
}

impl<R: Real, S, J> BvhUnion<'_, R, S, J> {
    /// Combines a sum with what is inside bounds, if that is near enough: shapes farther away than the seam is wide do
    /// not change the minimum. `sink` is the depth of the seams inside, in widths.
    fn unless_farther<V: SdfValue<R>>(
        &self,
        bounds: Option<&Bounds>,
        sink: f32,
        sum: V,
        combine: impl FnOnce(V) -> V,
    ) -> V {
        let Some(bounds) = bounds else { return combine(sum) };
        let beyond = bounds.distance_lower_bound(self.p);
        let width = self.smooth.in_frame() * (1.0 + sink);
        let beyond = if self.smooth.is_zero() { beyond } else { beyond - self.p.x.uniform(width) };
        sum.combine_unless_farther(beyond, combine)
    }

    /// Merges the shapes of a BVH node into the result so far.
    fn merge<V: SdfValue<R>>(&self, run: &BvhNode, sum: V) -> V
    where
        S: Fn(usize) -> V,
        J: Fn(V, V) -> V,
    {
        self.unless_farther(run.bounds.as_ref(), 0.0, sum, |sum| {
            if let Some([first, second]) = run.children.as_deref() {
                return self.merge(second, self.merge(first, sum));
            }
            run.shapes.clone().fold(sum, |sum, index| (self.join)(sum, (self.shape)(index)))
        })
    }

    /// The value of a group.
    fn group<V: SdfValue<R>>(&self, group: &GroupNode) -> V
    where
        S: Fn(usize) -> V,
        J: Fn(V, V) -> V,
    {
        let Some((first, others)) = group.parts.split_first() else { return (self.shape)(group.shapes.start) };
        others.iter().fold(self.group(first), |sum, part| {
            let sink = seam_sink(part.shapes.len(), true);
            self.unless_farther(part.bounds.as_ref(), sink, sum, |sum| (self.join)(sum, self.group(part)))
        })
    }
}

impl Sdf for Intersection {
    const ALIASES: &'static [&'static str] = &["intersect"];
    const EXAMPLE: &'static str = r#"{ "smooth": 0.1, "of": [
        { "sphere": { "radius": 1 } },
        { "box": { "size": [1.5, 1.5, 1.5] } }
    ] }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        fold_children(&self.of, p, sample, |a, b| smooth_max(a, b, &self.smooth))
    }

    // A seam only takes away.
    around_list!(|_| 0.0, Bounds::intersection);
}

impl Node {
    /// Whether it subtracts its other children from the first.
    pub fn subtracts(&self) -> bool {
        matches!(self, Self::Difference(_))
    }
}

impl Sdf for Difference {
    const ALIASES: &'static [&'static str] = &["cut", "minus", "subtract", "subtraction"];
    const EXAMPLE: &'static str = r#"{ "smooth": 0.05, "of": [
        { "box": { "size": [1.6, 1.6, 1.6] } },
        { "translate": { "by": [0.3, 0.4, 0.5], "child": { "sphere": { "radius": 0.9 } } } }
    ] }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        fold_children(&self.of, p, sample, |a, b| smooth_subtract(a, b, &self.smooth))
    }

    // A seam only takes away.
    around_list!(|_| 0.0, |first, _| first);
}

pub(super) fn default_smooth() -> LengthOrZero {
    LengthOrZero::new(0.0).expect("0 is in range")
}
