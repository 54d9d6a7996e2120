//! Bounds of a displacement, and the region where it need not be evaluated.

use crate::real::Real;
use crate::seek::Invalidate;

/// Maximum Lipschitz factor, so that products with it stay finite.
pub(super) const MAX_LIPSCHITZ: f32 = 1e18;

/// Minimum slope, so that quotients stay finite: a displacement with less is evaluated everywhere.
const MIN_SLOPE: f32 = 1e-18;

/// Range of the values added to a distance, and the slope that they may add.
#[derive(Clone, Copy, Debug)]
pub(super) struct DisplacementBounds {
    low: f32,
    high: f32,
    lipschitz: f32,
    influence: f32,
}

/// Cached displacement bounds, empty until `precompute`. Ignored by `==` because they follow from the node.
#[derive(Clone, Copy, Debug, Default)]
pub struct CachedDisplacementBounds(pub(super) Option<DisplacementBounds>);

impl Invalidate for CachedDisplacementBounds {
    fn invalidate(&mut self) {
        *self = Self::default();
    }
}

impl PartialEq for CachedDisplacementBounds {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl DisplacementBounds {
    /// Displacement by values between the two `ends`, which makes the Lipschitz factor up to 1 + `steepening` times as
    /// large.
    pub(super) fn new(ends: [f32; 2], steepening: f32) -> Self {
        let steepening = steepening.min(MAX_LIPSCHITZ);
        let (low, high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
        let reach = (high - low) * 0.5 + (high - low) / steepening.max(MIN_SLOPE);
        Self { low, high, lipschitz: 1.0 + steepening, influence: reach * 1.000_1 }
    }

    /// Maximum distance, from the undisplaced surface, of points at a displaced distance of `inflate`.
    pub(super) fn inflate(self, isolevel: f32) -> f32 {
        (isolevel - self.low).max(0.0)
    }

    /// `distance` plus `amount`, clamped between lipschitz · (distance + low) and lipschitz · (distance + high).
    ///
    /// Neither end has a larger Lipschitz factor than the sum, and each has the sign of the sum wherever it replaces
    /// it. So the surface does not change, and a step may be as long as the distance to the nearest displacement.
    /// Farther than `influence` from the middle of the range only the ends are used, and the amount is not evaluated.
    pub(super) fn displaced<R: Real>(self, distance: R, amount: impl FnOnce() -> R) -> R {
        let (middle, half) = ((self.low + self.high) * 0.5, (self.high - self.low) * 0.5);
        let steepness = distance.uniform(self.lipschitz);
        let (from_middle, half) = (distance + distance.uniform(middle), distance.uniform(half));
        let (least, most) = ((from_middle - half) * steepness, (from_middle + half) * steepness);
        let near = from_middle.abs().lt(distance.uniform(self.influence));
        R::when(near, R::select(from_middle.below(0.0), most, least), || (distance + amount()).max(least).min(most))
    }
}
