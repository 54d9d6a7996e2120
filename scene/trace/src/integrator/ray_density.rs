//! Density of the direction of a path's ray, and the weight of light that shadow rays find as well.

use crate::real::{Real, bundle};

/// Density with which a path's ray was sampled.
///
/// A ray that has no rival has a number below 0 instead, so that the state of a path needs no masks for it. Only this
/// file reads it.
#[derive(Clone, Copy)]
pub(super) struct RayDensity<R> {
    value: R,
}

bundle!(RayDensity { value });

/// In place of the density of rays that next-event estimation does not find.
const UNRIVALED: f32 = -1.0;
/// In place of the density of rays whose light shadow rays find straight through glass.
const FOUND_STRAIGHT: f32 = -2.0;

impl<R: Real> RayDensity<R> {
    /// A direction was sampled with this density, which is not below 0.
    pub(super) fn new(density: R) -> Self {
        Self { value: density }
    }

    /// Next-event estimation does not find the ray: it is from the camera, or was transmitted.
    pub(super) fn unrivaled(like: R) -> Self {
        Self { value: like.constant(UNRIVALED) }
    }

    /// After a transmission of a ray with this density, if shadow rays go straight through glass: they find its light, too,
    /// unless the camera sees the glass directly.
    pub(super) fn transmitted_straight(self) -> Self {
        let is_seen = self.value.below(0.0) & self.value.above(FOUND_STRAIGHT + 0.5);
        let [unrivaled, found] = [UNRIVALED, FOUND_STRAIGHT].map(|value| self.value.constant(value));
        Self { value: R::select(is_seen, unrivaled, found) }
    }

    /// `yes` where `mask` is true, else `no`.
    pub(super) fn select(mask: R::Mask, yes: Self, no: Self) -> Self {
        Self { value: R::select(mask, yes.value, no.value) }
    }

    /// Weight of light that the ray meets, for the density with which next-event estimation would have found it: the
    /// balance heuristic.
    pub(super) fn weight(self, rival: R) -> R {
        let share = self.value / (self.value + rival).at_least(1e-30);
        R::select(self.value.below(0.0), rival.constant(1.0), share)
    }

    /// Where shadow rays have found the ray's light straight through glass.
    pub(super) fn is_found_straight(self, rival: R) -> R::Mask {
        self.value.below(FOUND_STRAIGHT + 0.5) & rival.above(0.0)
    }
}
