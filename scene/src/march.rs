//! Sphere tracing: along a ray by the distance to the nearest surface, until that is within a
//! tolerance that grows with the pixel's cone.
//!
//! John C. Hart, "Sphere tracing: a geometric method for the antialiased ray tracing of implicit
//! surfaces", The Visual Computer 12, 1996.

use crate::camera::Ray;
use crate::real::{Flag, Real, bundle};

/// How near is near enough: `slope · t + floor` at distance t.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// By distance along the ray.
    pub slope: f32,
    /// At least, in scene units.
    pub floor: f32,
}

/// Where a march starts, and where it ends if it does not hit.
#[derive(Clone, Copy, Debug)]
pub struct Reach<R> {
    /// Distance at which it starts.
    pub nearest: R,
    /// Distance at which the ray misses.
    pub farthest: R,
    /// Steps after which it gives up.
    pub max_steps: u32,
}

/// Where a march ended.
#[derive(Clone, Copy, Debug)]
pub struct Marched<R: Real> {
    /// Distance along the ray.
    pub distance: R,
    /// Distance to the nearest surface at the last step.
    pub gap: R,
    /// Steps taken.
    pub steps: R,
    /// Whether it came near enough.
    pub hit: Flag<R>,
}

bundle!(Marched { distance, gap, steps, hit });

/// How far a step goes, in radii of the sphere around its start. 1.25 to 1.4 save a seventh of the
/// steps of the shipped scenes; more makes too many steps go back.
const RELAXATION: f32 = 1.3;
/// Overstep of a step that stayed inside its sphere. Less than any distance, so the step is never taken back.
const NOT_PAST: f32 = -1e30;

/// Marches along `ray` through `field`, which never tells more than the distance to its surface.
/// `tolerance` is what is near enough at a distance along the ray.
///
/// Steps go past the end of the sphere around their start. If the sphere around their end does not
/// reach back to it, they are taken back to it: Benjamin Keinert et al., "Enhanced sphere tracing",
/// Smart Tools and Apps for Graphics, 2014.
#[inline(always)]
pub fn march<R: Real>(
    ray: &Ray<R>,
    reach: Reach<R>,
    tolerance: impl Fn(R) -> R,
    field: impl Fn(crate::real::Vec3<R>) -> R,
) -> Marched<R> {
    let zero = reach.farthest.splat(0.0);
    let not_past = zero.splat(NOT_PAST);
    let start = (reach.nearest, not_past, zero, zero, Flag(zero.below(0.0)));
    let (distance, _, gap, steps, hit) = R::repeat(
        reach.max_steps,
        start,
        #[inline(always)]
        |(t, past, _, steps, _)| {
            let gap = field(ray.at(t));
            let is_torn = gap.lt(past);
            let hit = gap.lt(tolerance(t)) & !is_torn;
            let (end, further) = (t + gap, gap * (RELAXATION - 1.0));
            // The last step must see all that is left of the ray.
            let goes_past = (end + further).lt(reach.farthest) & !is_torn;
            let ahead = R::select(goes_past, end + further, R::select(is_torn, t - past, end));
            let next = R::select(hit, t, ahead);
            let past = R::select(goes_past, further, not_past);
            (!hit & next.lt(reach.farthest), (next, past, gap, steps + 1.0, Flag(hit)))
        },
    );
    Marched { distance, gap, steps, hit }
}
