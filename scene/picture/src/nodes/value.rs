//! Value of a node at a point: a bare distance while marching, with materials once a ray has hit.

use crate::real::{Real, Vec3, vec3};

/// Value of a node at a point.
pub trait SdfValue<R: Real>: Clone {
    /// A value with this distance and the object's own material.
    fn new(distance: R) -> Self;

    /// The distance.
    fn distance(&self) -> R;

    /// The same surface at another distance.
    fn with_distance(self, distance: R) -> Self;

    /// Two surfaces combined at `distance`; the second has the weight that `second` returns, 0 to 1.
    fn blend(self, other: Self, distance: R, second: impl FnOnce() -> R) -> Self;

    /// Combines this value with a shape that is at least `lower_bound` away. May return `self` without calling
    /// `combine` if that shape cannot be nearer.
    fn combine_unless_farther(self, beyond: R, join: impl FnOnce(Self) -> Self) -> Self;

    /// A value whose distance is known already.
    fn with_known_distance(distance: R, value: impl FnOnce() -> Self) -> Self;

    /// The same surface with a material wherever no inner node names one; `p` is the point in the space of the
    /// material's textures.
    fn paint(self, slot: u32, p: Vec3<R>) -> Self;

    /// The same surface in a space around its own, where `outward` takes directions of the one to directions of the other.
    fn mapped_outward(self, outward: impl FnOnce(Vec3<R>) -> Vec3<R>) -> Self {
        let _ = outward;
        self
    }
}

/// A bare distance.
#[derive(Clone, Copy, Debug)]
pub struct Distance<R>(pub R);

impl<R: Real> SdfValue<R> for Distance<R> {
    fn new(distance: R) -> Self {
        Self(distance)
    }

    fn distance(&self) -> R {
        self.0
    }

    fn with_distance(self, distance: R) -> Self {
        Self(distance)
    }

    fn blend(self, _: Self, distance: R, _: impl FnOnce() -> R) -> Self {
        Self(distance)
    }

    fn combine_unless_farther(self, beyond: R, join: impl FnOnce(Self) -> Self) -> Self {
        Self(R::when(beyond.lt(self.0), self.0, || join(self).0))
    }

    fn with_known_distance(distance: R, _: impl FnOnce() -> Self) -> Self {
        Self(distance)
    }

    fn paint(self, _: u32, _: Vec3<R>) -> Self {
        self
    }
}

/// A material and its weight on a surface.
#[derive(Clone, Copy, Debug)]
pub struct MaterialWeight<R> {
    /// The material's slot; `None` is the object's own.
    pub slot: Option<u32>,
    /// Weight, 0 to 1.
    pub weight: R,
    /// The point in the space of its textures; for a material in several spaces, that of the greatest weight.
    pub point: Vec3<R>,
}

/// A distance with the materials of the surface.
#[derive(Clone, Debug)]
pub struct DistanceWithMaterials<R> {
    distance: R,
    /// One entry per material; empty if nothing is painted, which is the common case.
    weights: Vec<MaterialWeight<R>>,
}

impl<R: Real> DistanceWithMaterials<R> {
    /// The materials' weights; empty if nothing is painted.
    pub fn weights(&self) -> &[MaterialWeight<R>] {
        &self.weights
    }
}

impl<R: Real> SdfValue<R> for DistanceWithMaterials<R> {
    fn new(distance: R) -> Self {
        Self { distance, weights: Vec::new() }
    }

    fn distance(&self) -> R {
        self.distance
    }

    fn with_distance(self, distance: R) -> Self {
        Self { distance, ..self }
    }

    fn blend(self, other: Self, distance: R, second: impl FnOnce() -> R) -> Self {
        if self.weights.is_empty() && other.weights.is_empty() {
            return Self::new(distance);
        }
        let second = second();
        let first = second.constant(1.0) - second;
        let nowhere = vec3(second.constant(0.0), second.constant(0.0), second.constant(0.0));
        let explicit = |coats: Vec<MaterialWeight<R>>| {
            if coats.is_empty() {
                vec![MaterialWeight { slot: None, weight: second.constant(1.0), point: nowhere }]
            } else {
                coats
            }
        };
        let mut coats = explicit(self.weights);
        for coat in &mut coats {
            coat.weight = coat.weight * first;
        }
        for coat in explicit(other.weights) {
            add_weight(&mut coats, MaterialWeight { weight: coat.weight * second, ..coat });
        }
        Self { distance, weights: coats }
    }

    fn combine_unless_farther(self, _: R, join: impl FnOnce(Self) -> Self) -> Self {
        join(self)
    }

    fn with_known_distance(distance: R, value: impl FnOnce() -> Self) -> Self {
        value().with_distance(distance)
    }

    fn paint(self, slot: u32, p: Vec3<R>) -> Self {
        let distance = self.distance;
        if self.weights.is_empty() {
            return Self {
                distance,
                weights: vec![MaterialWeight { slot: Some(slot), weight: distance.constant(1.0), point: p }],
            };
        }
        let mut coats = Vec::with_capacity(self.weights.len());
        for coat in self.weights {
            let place = if coat.slot.is_none() { p } else { coat.point };
            add_weight(&mut coats, MaterialWeight { slot: coat.slot.or(Some(slot)), point: place, ..coat });
        }
        Self { distance, weights: coats }
    }
}

/// Adds a weight to that of the same material, or as a new one.
fn add_weight<R: Real>(coats: &mut Vec<MaterialWeight<R>>, new: MaterialWeight<R>) {
    for coat in coats.iter_mut() {
        if coat.slot == new.slot {
            coat.point = Vec3::select(coat.weight.lt(new.weight), new.point, coat.point);
            coat.weight = coat.weight + new.weight;
            return;
        }
    }
    coats.push(new);
}

/// 1 where `mask` is true, else 0.
pub(super) fn indicator<R: Real>(like: R, mask: R::Mask) -> R {
    R::select(mask, like.constant(1.0), like.constant(0.0))
}
