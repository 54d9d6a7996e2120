//! Waves and edges for patterns.

use crate::limits::MIN_LENGTH;
use crate::real::Real;

/// Distance of `x` from the nearest border between bands of a width, positive in the bands that start at even
/// multiples of it.
pub(super) fn bands<R: Real>(x: R, width: f32) -> R {
    let period = 2.0 * width;
    let turns = x.mul_add(x.uniform(1.0 / period), x.constant(0.25));
    let part = turns - turns.floor();
    // A triangle wave through 0 at every border.
    ((part - 0.5).abs() - 0.25) * x.uniform(-period)
}

/// Contrast of a pattern averaged over `width`: all up to half of its period, none from a full period on, because both
/// colors are then equally likely.
pub(super) fn kept<R: Real>(width: R, period: f32) -> R {
    width.mul_add(width.uniform(-2.0 / period), width.constant(2.0)).at_least(0.0).at_most(1.0)
}

/// A border `softness` wide, averaged over a footprint of `width`.
pub(super) fn softened<R: Real>(softness: f32, width: R) -> R {
    let softness = width.uniform(softness.max(MIN_LENGTH));
    width.square_add(softness.square()).sqrt()
}

/// Alternating 1 and −1 in bands of a width, the first from 0 on, with borders `softness` wide, averaged over a
/// footprint of `seen`.
pub(super) fn square_wave<R: Real>(x: R, width: f32, softness: f32, seen: R) -> R {
    let slope = x.constant(2.0) / softened(softness, seen);
    (bands(x, width) * slope).at_least(-1.0).at_most(1.0) * kept(seen, 2.0 * width)
}

/// Smooth wave: 0 at integer x, 1 at half-integer x; within 0.01 of (1 − cos 2πx)/2, at any size of x.
pub(super) fn smooth_wave<R: Real>(turns: R) -> R {
    let part = turns - turns.floor();
    let rise = part.constant(1.0) - (part + part - 1.0).abs();
    rise.square() * rise.mul_add(rise.constant(-2.0), rise.constant(3.0))
}
