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

/// Marches along `ray` through `field`, which never tells more than the distance to its surface.
/// `tolerance` is what is near enough at a distance along the ray.
#[inline(always)]
pub fn march<R: Real>(
    ray: &Ray<R>,
    reach: Reach<R>,
    tolerance: impl Fn(R) -> R,
    field: impl Fn(crate::real::Vec3<R>) -> R,
) -> Marched<R> {
    let zero = reach.farthest.splat(0.0);
    let start = (reach.nearest, zero, zero, Flag(zero.below(0.0)));
    let (distance, gap, steps, hit) = R::repeat(
        reach.max_steps,
        start,
        #[inline(always)]
        |(t, _, steps, _)| {
            let gap = field(ray.at(t));
            let hit = gap.lt(tolerance(t));
            let next = R::select(hit, t, t + gap);
            (!hit & next.lt(reach.farthest), (next, gap, steps + 1.0, Flag(hit)))
        },
    );
    Marched { distance, gap, steps, hit }
}
