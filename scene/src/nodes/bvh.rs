//! Bounding volume hierarchy over a union's shapes: a BVH node farther away than the nearest result so far is
//! skipped.
//!
//! Skipping a BVH node leaves the least distance unchanged, which is never more than the distance to its
//! shapes: no ray passes a surface. Every arithmetic skips alike, so the results stay bit-identical.

use std::ops::Range;

use super::Node;
use crate::bounds::Bounds;
use crate::seek::Renew;

/// A run of fewer nodes is not worth a box.
pub(crate) const RUN_NODES: u32 = 8;

/// A run of shapes and, if it is long, its two halves.
#[derive(Clone, Debug)]
pub(super) struct Run {
    pub(super) shapes: Range<usize>,
    /// Box around them, if skipping is worthwhile.
    pub(super) bounds: Option<Bounds>,
    pub(super) halves: Option<Box<[Run; 2]>>,
}

/// Hierarchy of a list; empty until it is built. Ignored by comparisons, because it follows from the list.
#[derive(Clone, Debug, Default)]
pub struct Runs(pub(super) Option<Box<Run>>);

impl Renew for Runs {
    fn renew(&mut self) {
        *self = Self::default();
    }
}

impl PartialEq for Runs {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Runs {
    /// Hierarchy of all shapes but the first; empty if skipping is not worthwhile.
    pub(super) fn of(shapes: &[Node], moves: bool) -> Self {
        let measured = |shape| Measured { bounds: worthwhile_bounds(shape, moves), nodes: shape.count() };
        let measured: Vec<Measured> = shapes.iter().map(measured).collect();
        let all = (shapes.len() > 1).then(|| run(&measured, 1..shapes.len()));
        // In a box of its own, so that nodes stay small.
        Self(all.filter(Run::has_bounds).map(Box::new))
    }
}

impl Run {
    fn has_bounds(&self) -> bool {
        self.bounds.is_some() || self.halves.iter().flat_map(|halves| halves.iter()).any(Self::has_bounds)
    }
}

fn run(shapes: &[Measured], range: Range<usize>) -> Run {
    let own = &shapes[range.clone()];
    let nodes: u32 = own.iter().map(|shape| shape.nodes).sum();
    let bounds = own.iter().map(|shape| shape.bounds).reduce(|a, b| Some(a?.hull(b?))).flatten();
    let middle = range.start + range.len() / 2;
    let is_long = range.len() > 1 && nodes >= 2 * RUN_NODES;
    let halves = is_long.then(|| Box::new([range.start..middle, middle..range.end].map(|half| run(shapes, half))));
    Run { shapes: range, bounds: bounds.filter(|_| nodes >= RUN_NODES), halves }
}

/// What a run needs to know of a shape: found once, though the shape is in several runs.
struct Measured {
    bounds: Option<Bounds>,
    nodes: u32,
}

/// A shape's box, if it has an end in every direction. Where the job moves there is one in any case:
/// what has no end in one frame, a tilted plane say, may have one in the next.
fn worthwhile_bounds(shape: &Node, moves: bool) -> Option<Bounds> {
    let bounds = shape.bounds(0.0);
    if moves { Some(bounds.ended()) } else { Some(bounds).filter(|bounds| bounds.is_finite()) }
}

impl Node {
    /// The box that a ray near this object is held against, if it is worth it.
    pub(crate) fn skipping_bounds(&self, moves: bool) -> Option<Bounds> {
        worthwhile_bounds(self, moves).filter(|_| self.count() >= RUN_NODES)
    }
}
