//! Motion of a surface: the way of a point of it from one frame to the next.
//!
//! A point is carried by what moves it: the nodes between its shape and the scene, with their numbers of both frames. A
//! shape whose own numbers are animated, such as a radius or a noise, changes without moving its points.

use super::{Node, SdfValue};
use crate::real::{Real, Vec3};

/// A distance, and the way of the surface's point until the next frame.
#[derive(Clone, Copy, Debug)]
pub struct Carried<R> {
    distance: R,
    way: Option<Vec3<R>>,
}

impl<R: Real> Carried<R> {
    /// The way; `None` if no number that moves the surface is animated.
    pub fn way(&self) -> Option<Vec3<R>> {
        self.way
    }
}

impl<R: Real> SdfValue<R> for Carried<R> {
    fn new(distance: R) -> Self {
        Self { distance, way: None }
    }

    fn distance(&self) -> R {
        self.distance
    }

    fn with_distance(self, distance: R) -> Self {
        Self { distance, ..self }
    }

    fn blend(self, other: Self, distance: R, second: impl FnOnce() -> R) -> Self {
        if self.way.is_none() && other.way.is_none() {
            return Self::new(distance);
        }
        let second = second();
        let first = second.constant(1.0) - second;
        let parts = [(self.way, first), (other.way, second)];
        let parts = parts.into_iter().filter_map(|(way, weight)| Some(way? * weight));
        Self { distance, way: parts.reduce(|sum, part| sum + part) }
    }

    // Whether there is a way follows from the nodes alone, so no part may be skipped.
    fn combine_unless_farther(self, _: R, combine: impl FnOnce(Self) -> Self) -> Self {
        combine(self)
    }

    fn with_known_distance(distance: R, value: impl FnOnce() -> Self) -> Self {
        value().with_distance(distance)
    }

    fn paint(self, _: u32, _: Vec3<R>) -> Self {
        self
    }

    fn mapped_outward(self, outward: impl FnOnce(Vec3<R>) -> Vec3<R>) -> Self {
        Self { way: self.way.map(outward), ..self }
    }
}

impl Node {
    /// Its distance at `p`, and the way of its surface there until the next frame, in which it is `next`.
    pub fn carry<R: Real>(&self, next: &Self, p: Vec3<R>) -> Carried<R> {
        self.carry_around(next, p, &|index, q| self.children()[index].carry(&next.children()[index], q))
    }

    /// Like `carry`, where `child` gives the value of a child, by its index, at a point in the child's space.
    pub fn carry_around<R: Real>(
        &self,
        next: &Self,
        p: Vec3<R>,
        child: &dyn Fn(usize, Vec3<R>) -> Carried<R>,
    ) -> Carried<R> {
        self.eval(p, &|index, q| {
            let child = child(index, q);
            Carried { way: self.way_from_child(next, [p, q], child.way), ..child }
        })
    }
}

/// The way of a child's point around a node, from the points around the node at which the child's point is in both
/// frames. It is exactly 0 if nothing has moved.
pub(super) fn way_between<R: Real>(
    q: Vec3<R>,
    way: Option<Vec3<R>>,
    is_animated: bool,
    [now, next]: [&dyn Fn(Vec3<R>) -> Vec3<R>; 2],
) -> Option<Vec3<R>> {
    (way.is_some() || is_animated).then(|| next(way.map_or(q, |way| q + way)) - now(q))
}

/// Implements `way_from_child` by the method `outward`, the inverse of the point that a child is evaluated at; and by
/// whether one of the numbers that it uses is animated.
macro_rules! carries_child {
    (|$self:ident| $is_animated:expr) => {
        fn way_from_child<R: Real>(
            &$self,
            next: &Self,
            [_, q]: [Vec3<R>; 2],
            way: Option<Vec3<R>>,
        ) -> Option<Vec3<R>> {
            $crate::nodes::carried::way_between(q, way, $is_animated, [
                &|q| $self.outward(q),
                &|q| next.outward(q),
            ])
        }
    };
}

pub(super) use carries_child;
