//! Waves and edges that patterns are made of.

use crate::limits::MIN_LENGTH;
use crate::real::Real;

/// How far `x` is from the nearest border between bands of a width, positive in the bands that
/// start at even multiples of it.
#[inline(always)]
pub(super) fn bands<R: Real>(x: R, width: f32) -> R {
    let period = 2.0 * width;
    let turns = x.mul_add(x.given(1.0 / period), x.splat(0.25));
    let part = turns - turns.floor();
    // A triangle wave through 0 at every border.
    ((part - 0.5).abs() - 0.25) * x.given(-period)
}

/// From −1 to 1 over a border `softness` wide, by the signed distance to it.
#[inline(always)]
pub(super) fn edge<R: Real>(distance: R, softness: f32) -> R {
    (distance * distance.given(2.0 / softness.max(MIN_LENGTH))).at_least(-1.0).at_most(1.0)
}

/// From 0 to 1 over a border `softness` wide, by the signed distance to it.
#[inline(always)]
pub(super) fn step<R: Real>(distance: R, softness: f32) -> R {
    let slope = distance.given(1.0 / softness.max(MIN_LENGTH));
    distance.mul_add(slope, distance.splat(0.5)).at_least(0.0).at_most(1.0)
}

/// From 0 at whole turns to 1 at half turns and back, smoothly: within 0.01 of (1 − cos 2πx)/2, at any size of x.
#[inline(always)]
pub(super) fn swing<R: Real>(turns: R) -> R {
    let part = turns - turns.floor();
    let rise = part.splat(1.0) - (part + part - 1.0).abs();
    rise.square() * rise.mul_add(rise.splat(-2.0), rise.splat(3.0))
}
