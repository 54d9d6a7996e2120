//! The nearest of several copies of a shape.
//!
//! Copies are looked at in a loop, so that the shape's formula is there once however many they are.
//! A copy whose box is further away than what has been found need not be looked at.

use crate::bounds::Bounds;
use crate::nodes::{Node, Sample};
use crate::real::{Real, Vec3};

/// A shape of fewer nodes is looked at as fast as its box.
const BOX_NODES: u32 = 4;

/// Coordinates and lengths end before this.
const FAR: f32 = 1e7;

/// The nearest copy so far: its distance, and where its shape sees the point.
pub(super) type Nearest<R> = (R, Vec3<R>);

/// A box that holds a shape and, if it is worth a look, says which copies are too far away.
#[derive(Clone, Debug)]
pub(super) struct Held {
    pub(super) bounds: Bounds,
    is_looked_at: bool,
}

impl Held {
    /// The box around a shape.
    pub(super) fn new(shape: &Node) -> Self {
        Self { bounds: ended(shape.bounds(0.0)), is_looked_at: shape.count() >= BOX_NODES }
    }
}

/// A shape that has copies, and the box that holds it, if that is worth a look.
pub(super) struct Original<'a> {
    shape: &'a Node,
    bounds: Option<&'a Bounds>,
}

impl<'a> Original<'a> {
    #[inline(always)]
    pub(super) fn new(shape: &'a Node, held: &'a Held) -> Self {
        Self { shape, bounds: held.is_looked_at.then_some(&held.bounds) }
    }

    /// Before any copy has been looked at.
    #[inline(always)]
    pub(super) fn none<R: Real>(p: Vec3<R>) -> Nearest<R> {
        (p.x.splat(f32::MAX), p)
    }

    /// The nearer of what was found and the copy that sees the point at `place`.
    #[inline(always)]
    pub(super) fn nearer<R: Real>(&self, place: Vec3<R>, found: Nearest<R>) -> Nearest<R> {
        match self.bounds {
            Some(bounds) => R::when(
                bounds.distance_below(place).lt(found.0),
                found,
                #[inline(always)]
                || self.nearer_one(place, found),
            ),
            None => self.nearer_one(place, found),
        }
    }

    #[inline(always)]
    fn nearer_one<R: Real>(&self, place: Vec3<R>, found: Nearest<R>) -> Nearest<R> {
        let distance = self.shape.distance(place);
        let nearer = distance.lt(found.0);
        (R::select(nearer, distance, found.0), Vec3::select(nearer, place, found.1))
    }

    /// What is seen of the nearest copy.
    #[inline(always)]
    pub(super) fn sample<R: Real, V: Sample<R>>(&self, (distance, place): Nearest<R>) -> V {
        V::found(self.shape, place, distance)
    }
}

/// The box with an end in every direction, further away than anything.
pub(super) fn ended(bounds: Bounds) -> Bounds {
    let ended = |c: f32| c.clamp(-FAR, FAR);
    Bounds { low: bounds.low.map(ended), high: bounds.high.map(ended) }
}

/// How many copies, `spacing` apart, may be the nearest to a point by a shape so wide: for each point
/// of the shape the nearest of its copies is at most half a spacing away, so that the middles of the
/// copies lie within (width + spacing)/2 of the point. Rounding must not add one to a shape that fills its cell.
pub(super) fn within_reach(width: f32, spacing: f32) -> f32 {
    ((width / spacing + 1.0) * (1.0 - 1e-6)).ceil().max(1.0)
}

/// The whole number nearest to `t`, and the side, −1 or 1, on which `t` lies of it.
#[inline(always)]
pub(super) fn nearest_whole<R: Real>(t: R) -> (R, R) {
    let nearest = (t + 0.5).floor();
    (nearest, R::select(t.lt(nearest), t.splat(-1.0), t.splat(1.0)))
}
