//! What is added to a distance, and where it need not be looked at.

use crate::real::Real;

/// No Lipschitz factor is said to be more, so that products with it have an end.
pub(super) const STEEPEST: f32 = 1e18;

/// No quotient without an end: a relief with less slope is looked at everywhere.
const LEAST_STEEPENING: f32 = 1e-18;

/// The least and the greatest that is added to a distance, and how much steeper that may make it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Relief {
    low: f32,
    high: f32,
    steepness: f32,
    reach: f32,
}

/// Cached displacement bounds, empty until `precompute`. Ignored by `==` because they follow from the node.
#[derive(Clone, Copy, Debug, Default)]
pub struct FoundRelief(pub(super) Option<Relief>);

impl PartialEq for FoundRelief {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Relief {
    /// What adds something from one of `ends` to the other, and makes the distance up to 1 + `steepening`
    /// times as steep.
    pub(super) fn new(ends: [f32; 2], steepening: f32) -> Self {
        let steepening = steepening.min(STEEPEST);
        let (low, high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
        let reach = (high - low) * 0.5 + (high - low) / steepening.max(LEAST_STEEPENING);
        Self { low, high, steepness: 1.0 + steepening, reach: reach * 1.000_1 }
    }

    /// How far what is at a distance of `level` may be from where nothing was added.
    pub(super) fn level(self, level: f32) -> f32 {
        (level - self.low).max(0.0)
    }

    /// `distance` plus `amount`, held between steepness · (distance + low) and steepness · (distance + high).
    ///
    /// Neither end is steeper than the sum may be, and each has the sign of the sum wherever it takes its
    /// place: the surface stays where it is, a step may be as long as the way to the nearest place where there can be any,
    /// and beyond `reach` from the middle the ends alone count, so nobody asks for the amount there.
    #[inline(always)]
    pub(super) fn added<R: Real>(self, distance: R, amount: impl FnOnce() -> R) -> R {
        let (middle, half) = ((self.low + self.high) * 0.5, (self.high - self.low) * 0.5);
        let steepness = distance.given(self.steepness);
        let (from_middle, half) = (distance + distance.given(middle), distance.given(half));
        let (least, most) = ((from_middle - half) * steepness, (from_middle + half) * steepness);
        let near = from_middle.abs().lt(distance.given(self.reach));
        R::when(
            near,
            R::select(from_middle.below(0.0), most, least),
            #[inline(always)]
            || (distance + amount()).max(least).min(most),
        )
    }
}
