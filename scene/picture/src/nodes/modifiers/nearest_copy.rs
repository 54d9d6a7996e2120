//! The nearest of several copies of a shape.
//!
//! Copies are evaluated in a loop, so that the shape's formula occurs only once. A copy is skipped if its bounds are
//! farther away than the nearest copy so far.

use crate::bounds::Bounds;
use crate::nodes::{Node, SdfValue};
use crate::real::{Real, Vec3};

/// A shape with fewer nodes is evaluated as fast as its bounds.
const MIN_CULL_NODES: u32 = 4;

/// Limit of finite coordinates and lengths.
const MISS_DISTANCE: f32 = 1e7;

/// The nearest copy so far: its distance, and the point in its shape's space.
pub(super) type NearestCopy<R> = (R, Vec3<R>);

/// Bounds of a shape, and whether copies are skipped by them.
#[derive(Clone, Debug)]
pub(super) struct ChildBounds {
    pub(super) bounds: Bounds,
    is_worth_testing: bool,
}

impl ChildBounds {
    /// Bounds of a shape.
    pub(super) fn new(shape: &Node) -> Self {
        Self { bounds: ended(shape.bounds(0.0)), is_worth_testing: shape.node_count() >= MIN_CULL_NODES }
    }
}

/// Shape that is repeated, with its bounds if skipping is worthwhile.
pub(super) struct RepeatedChild<'a> {
    shape: &'a Node,
    bounds: Option<&'a Bounds>,
}

impl<'a> RepeatedChild<'a> {
    pub(super) fn new(shape: &'a Node, held: &'a ChildBounds) -> Self {
        Self { shape, bounds: held.is_worth_testing.then_some(&held.bounds) }
    }

    /// State before the first copy.
    pub(super) fn start<R: Real>(p: Vec3<R>) -> NearestCopy<R> {
        (p.x.constant(f32::MAX), p)
    }

    /// The nearer of the nearest copy so far and the copy in whose space the point is `place`.
    pub(super) fn nearer<R: Real>(&self, place: Vec3<R>, found: NearestCopy<R>) -> NearestCopy<R> {
        match self.bounds {
            Some(bounds) => {
                R::when(bounds.distance_lower_bound(place).lt(found.0), found, || self.nearer_unculled(place, found))
            }
            None => self.nearer_unculled(place, found),
        }
    }

    fn nearer_unculled<R: Real>(&self, place: Vec3<R>, found: NearestCopy<R>) -> NearestCopy<R> {
        let distance = self.shape.distance(place);
        let nearer = distance.lt(found.0);
        (R::select(nearer, distance, found.0), Vec3::select(nearer, place, found.1))
    }
}

/// Value of the nearest copy of a node's only child.
pub(super) fn sample_nearest<R: Real, V: SdfValue<R>>(
    (distance, place): NearestCopy<R>,
    sample: &impl Fn(usize, Vec3<R>) -> V,
) -> V {
    V::with_known_distance(distance, || sample(0, place))
}

/// Bounds with finite sides, farther away than any point.
pub(super) fn ended(bounds: Bounds) -> Bounds {
    let ended = |c: f32| c.clamp(-MISS_DISTANCE, MISS_DISTANCE);
    Bounds { min: bounds.min.map(ended), max: bounds.max.map(ended) }
}

/// Number of copies, `spacing` apart, that may be the nearest to a point, for a shape of this width.
/// For each point of the shape the nearest of its copies is at most half a spacing away, so the centers of
/// the copies are within (width + spacing)/2 of the point. Rounding must not add a copy if the shape fills
/// its cell.
pub(super) fn max_overlapping(width: f32, spacing: f32) -> f32 {
    ((width / spacing + 1.0) * (1.0 - 1e-6)).ceil().max(1.0)
}

/// Integer nearest to `t`, and the side, −1 or 1, of it on which `t` is.
pub(super) fn nearest_whole<R: Real>(t: R) -> (R, R) {
    let nearest = (t + 0.5).floor();
    (nearest, R::select(t.lt(nearest), t.constant(-1.0), t.constant(1.0)))
}
