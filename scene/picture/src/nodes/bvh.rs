//! Bounding volume hierarchy over a union's shapes: a BVH node farther away than the nearest result so far is
//! skipped.
//!
//! Skipping a BVH node leaves the minimum distance unchanged, and that is never more than the distance to its shapes,
//! so no ray passes through a surface. Every arithmetic skips alike, so the results stay bit-identical.

use std::ops::Range;

use super::Node;
use super::operators::group_part;
use crate::bounds::Bounds;
use crate::seek::Invalidate;

/// Minimum number of scene nodes in a BVH node; a smaller one is not worth its bounds.
pub(crate) const MIN_BVH_NODES: u32 = 8;

/// A range of shapes and, if it is long, its two halves.
#[derive(Clone, Debug)]
pub(super) struct BvhNode {
    pub(super) shapes: Range<usize>,
    /// Box around them, if skipping is worthwhile.
    pub(super) bounds: Option<Bounds>,
    pub(super) children: Option<Box<[BvhNode; 2]>>,
}

/// Shapes that are combined before others.
#[derive(Clone, Debug)]
pub(super) struct GroupNode {
    pub(super) shapes: Range<usize>,
    /// Box around them, if skipping is worthwhile.
    pub(super) bounds: Option<Bounds>,
    /// Its parts; none if it is one shape.
    pub(super) parts: Vec<GroupNode>,
}

/// Hierarchy of a list; none until it is built. Ignored by comparisons, because it follows from the list. Boxed, so that
/// nodes stay small.
#[derive(Clone, Debug, Default)]
pub enum UnionBvh {
    /// Skipping is not worthwhile.
    #[default]
    None,
    /// Of all shapes but the first, of a union that combines them one after another.
    #[expect(private_interfaces, reason = "only unions look inside")]
    Halves(Box<BvhNode>),
    /// Of a union that combines shapes in groups.
    #[expect(private_interfaces, reason = "only unions look inside")]
    Groups(Box<GroupNode>),
}

impl Invalidate for UnionBvh {
    fn invalidate(&mut self) {
        *self = Self::default();
    }
}

impl PartialEq for UnionBvh {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl UnionBvh {
    /// Hierarchy of a union, given the bounds and the number of nodes of each shape.
    pub(super) fn new(shapes: impl Iterator<Item = (Bounds, u32)>, in_groups: bool, is_animated: bool) -> Self {
        let measured = |(bounds, nodes)| Measured { bounds: finite(bounds, is_animated), nodes };
        let measured: Vec<Measured> = shapes.map(measured).collect();
        if measured.len() < 2 {
            Self::None
        } else if in_groups {
            Self::Groups(Box::new(group(&measured, 0..measured.len())))
        } else {
            let all = build(&measured, 1..measured.len());
            if all.has_bounds() { Self::Halves(Box::new(all)) } else { Self::None }
        }
    }
}

impl BvhNode {
    fn has_bounds(&self) -> bool {
        self.bounds.is_some() || self.children.iter().flat_map(|halves| halves.iter()).any(Self::has_bounds)
    }
}

/// Number of nodes of some shapes, and the box around them, if it is finite.
fn measure(shapes: &[Measured]) -> (u32, Option<Bounds>) {
    let nodes = shapes.iter().fold(0_u32, |nodes, shape| nodes.saturating_add(shape.nodes));
    (nodes, shapes.iter().map(|shape| shape.bounds).reduce(|a, b| Some(a?.union(b?))).flatten())
}

fn group(shapes: &[Measured], range: Range<usize>) -> GroupNode {
    let (nodes, bounds) = measure(&shapes[range.clone()]);
    let part = group_part(range.len());
    let starts = if range.len() > 1 { range.clone().step_by(part) } else { (0..0).step_by(1) };
    let parts = starts.map(|start| group(shapes, start..range.end.min(start + part))).collect();
    GroupNode { shapes: range, bounds: bounds.filter(|_| nodes >= MIN_BVH_NODES), parts }
}

fn build(shapes: &[Measured], range: Range<usize>) -> BvhNode {
    let (nodes, bounds) = measure(&shapes[range.clone()]);
    let middle = range.start + range.len() / 2;
    let is_long = range.len() > 1 && nodes >= 2 * MIN_BVH_NODES;
    let halves = is_long.then(|| Box::new([range.start..middle, middle..range.end].map(|half| build(shapes, half))));
    BvhNode { shapes: range, bounds: bounds.filter(|_| nodes >= MIN_BVH_NODES), children: halves }
}

/// Size and bounds of a shape, measured once although the shape is in several BVH nodes.
struct Measured {
    bounds: Option<Bounds>,
    nodes: u32,
}

/// Bounds of a shape, if they are finite. For an animated job there are bounds in any case: an infinite shape, such as
/// a tilted plane, may be finite in the next frame.
fn finite(bounds: Bounds, is_animated: bool) -> Option<Bounds> {
    if is_animated { Some(bounds.clamped_to_finite()) } else { Some(bounds).filter(|bounds| bounds.is_finite()) }
}

impl Node {
    /// Bounds for skipping this object when a ray is distant, if that is worthwhile.
    pub fn culling_bounds(&self, is_animated: bool) -> Option<Bounds> {
        finite(self.bounds(0.0), is_animated).filter(|_| self.node_count() >= MIN_BVH_NODES)
    }
}
