//! Value of a node at a point: a bare distance while marching, with materials once a ray has hit.

use super::Node;
use crate::real::{Real, Vec3, vec3};

/// Value of a node at a point.
pub trait Sample<R: Real>: Clone {
    /// A value with this distance and the object's own material.
    fn new(distance: R) -> Self;

    /// The distance.
    fn distance(&self) -> R;

    /// The same surface at another distance.
    fn at(self, distance: R) -> Self;

    /// Two surfaces combined at `distance`; the second has the weight that `second` returns, 0 to 1.
    fn blend(self, other: Self, distance: R, second: impl FnOnce() -> R) -> Self;

    /// Combines this value with a shape that is at least `lower_bound` away. May return `self` without calling `combine` if that shape cannot be nearer.
    fn unless_beyond(self, beyond: R, join: impl FnOnce(Self) -> Self) -> Self;

    /// The surface of `node` as `place` sees it, where its distance is known already.
    fn found(node: &Node, place: Vec3<R>, distance: R) -> Self;

    /// The same surface with a material wherever no inner node names one; `p` is the point in the space
    /// of the material's textures.
    fn paint(self, slot: u32, p: Vec3<R>) -> Self;
}

/// A bare distance.
#[derive(Clone, Copy, Debug)]
pub struct Distance<R>(pub R);

impl<R: Real> Sample<R> for Distance<R> {
    #[inline(always)]
    fn new(distance: R) -> Self {
        Self(distance)
    }

    #[inline(always)]
    fn distance(&self) -> R {
        self.0
    }

    #[inline(always)]
    fn at(self, distance: R) -> Self {
        Self(distance)
    }

    #[inline(always)]
    fn blend(self, _: Self, distance: R, _: impl FnOnce() -> R) -> Self {
        Self(distance)
    }

    #[inline(always)]
    fn unless_beyond(self, beyond: R, join: impl FnOnce(Self) -> Self) -> Self {
        Self(R::when(
            beyond.lt(self.0),
            self.0,
            #[inline(always)]
            || join(self).0,
        ))
    }

    #[inline(always)]
    fn found(_: &Node, _: Vec3<R>, distance: R) -> Self {
        Self(distance)
    }

    #[inline(always)]
    fn paint(self, _: u32, _: Vec3<R>) -> Self {
        self
    }
}

/// A material and its fraction of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Coat<R> {
    /// The material's slot; `None` is the object's own.
    pub slot: Option<u32>,
    /// Its fraction, 0 to 1.
    pub share: R,
    /// The point in its textures' space; for a material in several places, that of the greatest fraction.
    pub place: Vec3<R>,
}

/// A distance with the materials of the surface.
#[derive(Clone, Debug)]
pub struct Painted<R> {
    distance: R,
    /// One entry per material; empty if nothing is painted, which is the common case.
    coats: Vec<Coat<R>>,
}

impl<R: Real> Painted<R> {
    /// The materials' fractions; empty if nothing is painted.
    pub fn coats(&self) -> &[Coat<R>] {
        &self.coats
    }
}

impl<R: Real> Sample<R> for Painted<R> {
    #[inline(always)]
    fn new(distance: R) -> Self {
        Self { distance, coats: Vec::new() }
    }

    #[inline(always)]
    fn distance(&self) -> R {
        self.distance
    }

    #[inline(always)]
    fn at(self, distance: R) -> Self {
        Self { distance, ..self }
    }

    #[inline(always)]
    fn blend(self, other: Self, distance: R, second: impl FnOnce() -> R) -> Self {
        if self.coats.is_empty() && other.coats.is_empty() {
            return Self::new(distance);
        }
        let second = second();
        let first = second.splat(1.0) - second;
        let nowhere = vec3(second.splat(0.0), second.splat(0.0), second.splat(0.0));
        let explicit = |coats: Vec<Coat<R>>| {
            if coats.is_empty() { vec![Coat { slot: None, share: second.splat(1.0), place: nowhere }] } else { coats }
        };
        let mut coats = explicit(self.coats);
        for coat in &mut coats {
            coat.share = coat.share * first;
        }
        for coat in explicit(other.coats) {
            add(&mut coats, Coat { share: coat.share * second, ..coat });
        }
        Self { distance, coats }
    }

    #[inline(always)]
    fn unless_beyond(self, _: R, join: impl FnOnce(Self) -> Self) -> Self {
        join(self)
    }

    #[inline(always)]
    fn found(node: &Node, place: Vec3<R>, distance: R) -> Self {
        node.sample::<R, Self>(place).at(distance)
    }

    #[inline(always)]
    fn paint(self, slot: u32, p: Vec3<R>) -> Self {
        let distance = self.distance;
        if self.coats.is_empty() {
            return Self { distance, coats: vec![Coat { slot: Some(slot), share: distance.splat(1.0), place: p }] };
        }
        let mut coats = Vec::with_capacity(self.coats.len());
        for coat in self.coats {
            let place = if coat.slot.is_none() { p } else { coat.place };
            add(&mut coats, Coat { slot: coat.slot.or(Some(slot)), place, ..coat });
        }
        Self { distance, coats }
    }
}

/// Adds a fraction to that of the same material, or as a new one.
#[inline(always)]
fn add<R: Real>(coats: &mut Vec<Coat<R>>, new: Coat<R>) {
    for coat in coats.iter_mut() {
        if coat.slot == new.slot {
            coat.place = Vec3::select(coat.share.lt(new.share), new.place, coat.place);
            coat.share = coat.share + new.share;
            return;
        }
    }
    coats.push(new);
}

/// 1 where `mask` holds, else 0.
#[inline(always)]
pub(super) fn indicator<R: Real>(like: R, mask: R::Mask) -> R {
    R::select(mask, like.splat(1.0), like.splat(0.0))
}
