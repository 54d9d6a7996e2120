//! Sphere tracing: advances along a ray by the distance to the nearest surface, until that distance is within a
//! tolerance that grows with the pixel's cone.
//!
//! John C. Hart, "Sphere tracing: a geometric method for the antialiased ray tracing of implicit
//! surfaces", The Visual Computer 12, 1996.

use crate::ray::{Ray, Tolerance};
use crate::real::{MaskValue, Real, Vec3, bundle};

/// Interval and limits of a march.
#[derive(Clone, Copy, Debug)]
pub struct MarchRange<R> {
    /// Distance along the ray at which the march starts.
    pub t_min: R,
    /// Distance along the ray at which it ends without a hit.
    pub t_max: R,
    /// Maximum number of steps.
    pub max_steps: u32,
    /// Limit of how far a step could go past the sphere around its start if the surface were a plane, in radii; with 0,
    /// steps stay inside.
    pub max_past: f32,
}

/// Result of a march.
#[derive(Clone, Copy, Debug)]
pub struct MarchResult<R: Real> {
    /// Distance along the ray.
    pub t: R,
    /// Distance along the ray where the march came within the tolerance; equal to `t` if no root was searched or
    /// found.
    pub near: R,
    /// Value of the distance field there.
    pub distance: R,
    /// Steps taken.
    pub steps: R,
    /// Evaluations of the distance field: at least one a step.
    pub evaluations: R,
    /// Whether the march came within the tolerance.
    pub hit: MaskValue<R>,
}

bundle!(MarchResult { t, near, distance, steps, evaluations, hit });

impl<R: Real> MarchResult<R> {
    /// Whether light from `t_max`, the end of the march's range, is occluded: if the march ran out of steps, too, since it
    /// did so between surfaces that meet ahead, most often.
    pub(crate) fn is_occluded(&self, t_max: R) -> R::Mask {
        self.hit.0 | self.t.lt(t_max)
    }
}

/// A distance field along a ray.
pub trait RayField<R: Real> {
    /// The part of the ray about which is known before its first point; `None` if the field has no parts.
    fn start(&self) -> Option<Part<R>> {
        None
    }

    /// From a point that is not in a known part: the next point that may be near a surface, or one beyond `farthest`,
    /// and its part.
    fn enter(&self, t: R, farthest: R) -> (R, Part<R>);

    /// Whether a distance in a part tells of surfaces in that part only, so that no step may end beyond.
    fn ends_with_part(&self) -> bool {
        false
    }

    /// Distance to the surface at a point in a part: at most the true one.
    fn distance(&self, t: R, part: Option<Part<R>>) -> R;
}

/// A part of a ray in which a field has one formula.
#[derive(Clone, Copy, Debug)]
pub struct Part<R> {
    /// The formula: the bits of a word.
    pub formula: R,
    /// End of the part, as a distance along the ray.
    pub end: R,
}

bundle!(Part { formula, end });

impl<R: Real, F: Fn(R) -> R> RayField<R> for F {
    fn enter(&self, t: R, farthest: R) -> (R, Part<R>) {
        (t, Part { formula: t, end: farthest })
    }

    fn distance(&self, t: R, _: Option<Part<R>>) -> R {
        self(t)
    }
}

/// Tolerances of a march, and the sides of the surface on which it runs.
#[derive(Clone, Copy, Debug)]
pub struct Approach<R> {
    /// Growth of the tolerance per distance along the ray.
    pub slope: R,
    /// Tolerance at the start of the ray.
    pub near: R,
    /// Rounding error of a distance: smaller distances are not significant.
    pub resolution: Tolerance,
    /// Whether rays also travel inside shapes, so that the sign of a distance tells only the side.
    pub both_sides: bool,
    /// Whether the root is also searched on surfaces with fine detail at every scale. There the slope at a point does
    /// not predict the distance ahead, so no step is longer than the distance. If false, a point within the tolerance
    /// is a hit.
    pub among_details: bool,
    /// Evaluations of the distance field that tell whether a surface has fine detail.
    pub detail_evaluations: f32,
}

impl<R: Real> Approach<R> {
    fn tolerance(&self, distance: R) -> R {
        distance.mul_add(self.slope, self.near)
    }
}

/// How far a step goes past its sphere, over how far it could go if the surface were a plane. With 1, rounding and curved
/// surfaces take most steps back.
const PAST_PER_PLANE: f32 = 0.9;
/// [`MarchRange::max_past`] of most scenes: a ray along a plane, or away from it, could go any way.
pub(crate) const MAX_PAST: f32 = 4.0;
/// That of scenes with fractals, whose distance changes from point to point: more steps would be taken back, from inside,
/// where an evaluation takes all iterations.
pub(crate) const MAX_PAST_FRACTALS: f32 = 0.6;
/// In place of the overstep, if the distance before does not tell how it changes: the next step stays inside its sphere.
const UNKNOWN: f32 = -1.0;

/// Marches along `ray` through `field`, which never exceeds the distance to its surface, until it intersects the
/// surface: the resulting distance is that of a root of the field.
///
/// A ray that only passes near a surface continues. The tolerance decides where the search for the root begins.
/// `along` is the same field along the ray.
/// `is_fine` returns whether a point's surface has fine detail at every scale; `None` if no surface does.
pub(crate) fn march_to_root<R: Real>(
    ray: &Ray<R>,
    reach: MarchRange<R>,
    approach: Approach<R>,
    along: &impl RayField<R>,
    field: impl Fn(Vec3<R>) -> R,
    is_fine: impl Fn(Vec3<R>) -> Option<R::Mask>,
) -> MarchResult<R> {
    let zero = reach.t_max.constant(0.0);
    let start = MarchResult {
        t: reach.t_min,
        near: reach.t_min,
        distance: zero,
        steps: zero,
        evaluations: zero,
        hit: MaskValue(zero.below(0.0)),
    };
    R::repeat(reach.max_steps, start, |so_far| {
        let reach = MarchRange { t_min: so_far.t, ..reach };
        let near = march(reach, |t| approach.tolerance(t), approach.both_sides, along);
        let near = MarchResult {
            steps: so_far.steps + near.steps,
            evaluations: so_far.evaluations + near.evaluations,
            ..near
        };
        let found = R::when(near.hit.0, near, || settle(ray, near, approach, &field, &is_fine));
        let passes = near.hit.0 & !found.hit.0;
        let goes_on = passes & found.t.lt(reach.t_max) & found.steps.below(reach.max_steps as f32);
        (goes_on, found)
    })
}

/// The intersection near where a march came within the tolerance; not a hit if the ray passes the surface.
pub fn settle<R: Real>(
    ray: &Ray<R>,
    near: MarchResult<R>,
    approach: Approach<R>,
    field: impl Fn(Vec3<R>) -> R,
    is_fine: impl Fn(Vec3<R>) -> Option<R::Mask>,
) -> MarchResult<R> {
    let is_fine = is_fine(ray.at(near.t));
    let near = MarchResult { evaluations: near.evaluations + approach.detail_evaluations, ..near };
    let Some(is_met) = is_fine.filter(|_| !approach.among_details) else {
        return find_root(ray, &near, approach, is_fine, &field);
    };
    R::when(!is_met, near, || find_root(ray, &near, approach, None, &field))
}

/// Two points of a ray and the field's values there; the nearer point is outside the surface.
#[derive(Clone, Copy)]
struct Search<R: Real> {
    before: R,
    value_before: R,
    after: R,
    value_after: R,
    steps: R,
    met: MaskValue<R>,
}

bundle!(Search { before, value_before, after, value_after, steps, met });

/// Maximum number of steps of a search for a root. A bracket is narrow enough after about ten; a ray along a surface
/// takes more.
const MAX_SEARCH_STEPS: u32 = 48;
/// Maximum step before the root is bracketed, in tolerances: about two pixels.
const MAX_STEP: f32 = 16.0;
/// Step of a ray that moves away from the surface, in tolerances.
const STEP_AWAY: f32 = 8.0;
/// Fraction of the resolution within which a point counts as a hit on fine detail.
const AMONG_DETAILS: f32 = 1.0 / 64.0;
/// Maximum error of a root before the last correction, in tolerances.
const EXACTNESS: f32 = 0.125;

/// Finds the exact intersection of a ray that has come near a surface; not a hit if the ray passes the surface.
///
/// The secant method until the root is bracketed, then the Illinois variant of regula falsi: M. Dowell, P. Jarratt, "A
/// modified regula falsi method for computing the root of an equation", BIT 11, 1971.
pub(crate) fn find_root<R: Real>(
    ray: &Ray<R>,
    near: &MarchResult<R>,
    approach: Approach<R>,
    is_fine: Option<R::Mask>,
    field: impl Fn(Vec3<R>) -> R,
) -> MarchResult<R> {
    let one = near.distance.constant(1.0);
    // For a ray that starts inside, distances are negative before the surface.
    let side = if approach.both_sides { R::select(field(ray.at(near.t)).below(0.0), -one, one) } else { one };
    // Initial slope: as if the ray had approached the surface at a right angle.
    let is_inside = near.distance.below(1e-30);
    let start = Search {
        before: near.t - near.distance,
        value_before: near.distance + near.distance,
        after: near.t,
        value_after: near.distance,
        steps: near.steps,
        met: MaskValue(is_inside),
    };
    let found = R::when(!is_inside, start, || {
        R::repeat(MAX_SEARCH_STEPS, start, |search| search.step(ray, side, approach, is_fine, &field))
    });
    let to_know_side = if approach.both_sides { 1.0 } else { 0.0 };
    MarchResult {
        t: found.after,
        near: R::select(found.met.0, near.t, found.after),
        distance: R::select(found.met.0, near.distance, found.value_after.abs()),
        steps: found.steps,
        evaluations: near.evaluations + (found.steps - near.steps) + to_know_side,
        hit: found.met,
    }
}

impl<R: Real> Search<R> {
    /// Whether the search continues, and its two points.
    fn step(
        self,
        ray: &Ray<R>,
        side: R,
        approach: Approach<R>,
        is_fine: Option<R::Mask>,
        field: impl Fn(Vec3<R>) -> R,
    ) -> (R::Mask, Self) {
        let Self { before, value_before, after, value_after, .. } = self;
        let (zero, half) = (after.constant(0.0), after.constant(0.5));
        let width = after - before;
        let tolerance = approach.tolerance(after);
        let is_between = value_after.below(0.0);
        let fall = value_before - value_after;
        let falls = fall.above(0.0);
        let per_fall = width / R::select(falls, fall, after.constant(1.0));
        let outwards = R::select(falls, value_after * per_fall, tolerance * STEP_AWAY);
        let outwards = outwards.max(value_after).min(tolerance * MAX_STEP);
        let resolution = approach.resolution.at(after);
        let outwards = is_fine.map_or(outwards, |fine| R::select(fine, value_after.max(resolution), outwards));
        let inwards = (value_before * per_fall).max(width * 0.01).min(width * 0.99);
        let here = R::select(is_between, before + inwards, after + outwards);
        let value = field(ray.at(here)) * side;

        let exactness = tolerance * EXACTNESS;
        let fall = R::select(is_between, fall, value_after - value);
        let way = R::select(is_between, width, here - after);
        // Distance along the ray to the estimated root; 0 if the values do not lead to one.
        let is_falling = fall.above(0.0);
        let further = R::select(is_falling, value * (way / fall.at_least(1e-12)), zero);
        let level = is_fine.map_or(resolution, |fine| R::select(fine, resolution * AMONG_DETAILS, resolution));
        let is_level = value.abs().lt(level);
        let is_near = further.abs().lt(exactness) & is_falling;
        // On fine detail, a slope toward a root may end before the root.
        let is_near = is_fine.map_or(is_near, |fine| is_near & (!fine | is_between));
        let met = is_level | is_near | (is_between & width.lt(exactness));
        let passes = !is_between & tolerance.lt(value);
        let corrected = here + further.max(-exactness).min(exactness);

        // Illinois: the end that is retained twice counts half.
        let is_outside = zero.lt(value);
        let kept_before = R::select(is_outside, value, value_before * half);
        let kept_after = R::select(is_outside, value_after * half, value);
        let next = Self {
            before: R::select(is_between, R::select(is_outside, here, before), after),
            value_before: R::select(is_between, kept_before, value_after),
            after: R::select(met, corrected, R::select(is_between & is_outside, after, here)),
            value_after: R::select(is_between, kept_after, value),
            steps: self.steps + 1.0,
            met: MaskValue(met),
        };
        (!met & !passes, next)
    }
}

/// A march that can be interrupted after each step.
#[derive(Clone, Copy)]
pub struct March<R: Real> {
    /// Distance along the ray.
    pub t: R,
    /// How far the last step went past its sphere.
    pub past: R,
    /// Value of the distance field where it was evaluated last.
    pub gap: R,
    /// Steps taken.
    pub steps: R,
    /// Whether the march came within the tolerance.
    pub hit: MaskValue<R>,
    /// Whether there is another step to take.
    pub goes_on: MaskValue<R>,
    /// The part of the ray.
    pub part: Option<Part<R>>,
}

bundle!(March { goes_on, t, past, gap, steps, hit, part });

impl<R: Real> March<R> {
    /// A march from `t`, if it lies before the ray's end.
    pub fn start(t: R, t_max: R, field: &impl RayField<R>) -> Self {
        let zero = t.constant(0.0);
        Self {
            t,
            past: zero.constant(UNKNOWN),
            gap: zero,
            steps: zero,
            hit: MaskValue(zero.below(0.0)),
            goes_on: MaskValue(t.lt(t_max)),
            part: field.start(),
        }
    }

    /// The result, if there is no step left to take.
    pub fn result(&self) -> MarchResult<R> {
        let Self { t, gap, steps, hit, past: _, goes_on: _, part: _ } = *self;
        MarchResult { t, near: t, distance: gap, steps, evaluations: steps, hit }
    }

    /// Takes a step, with the tolerance at its start.
    ///
    /// It is longer than the radius of the sphere around its start, within a part of the ray. If the sphere around its end
    /// does not overlap the one around its start, it is taken back to the first sphere: Benjamin Keinert et al., "Enhanced
    /// sphere tracing", Smart Tools and Apps for Graphics, 2014. It is as long as would make the two spheres touch if the
    /// distance went on to change as it did in the step before: Csaba Bálint and Gábor Valasek, "Accelerating sphere
    /// tracing", Eurographics 2018, short papers. With `both_sides`, the sign of a distance tells only the side.
    pub fn step(
        self,
        t_max: R,
        max_past: f32,
        tolerance: impl Fn(R) -> R,
        both_sides: bool,
        field: &impl RayField<R>,
    ) -> Self {
        let Self { t, past, gap: before, steps, part, .. } = self;
        let entered = part.map(|part| R::when(!t.lt(part.end), (t, part), || field.enter(t, t_max)));
        let (t, part) = entered.map_or((t, None), |(t, part)| (t, Some(part)));
        let gap = match part {
            None => field.distance(t, None),
            Some(part) => R::when(t.lt(t_max), t_max, || field.distance(t, Some(part))),
        };
        let gap = if both_sides { gap.abs() } else { gap };
        // A step past a surface at a right angle ends as far behind it as it went too far: up to rounding.
        let is_torn = past.above(0.0) & gap.lt(if both_sides { past * 1.0001 } else { past });
        let hit = gap.lt(tolerance(t)) & !is_torn;
        let (end, further) = (t + gap, gap * radii_past(max_past, before, past, gap));
        // The last step must cover the rest of the ray, or of the part.
        let goes_past = (end + further).lt(t_max) & !is_torn;
        let goes_past = part.map_or(goes_past, |part| goes_past & (end + further).lt(part.end));
        let end = part.filter(|_| field.ends_with_part()).map_or(end, |part| end.min(part.end));
        let ahead = R::select(goes_past, end + further, R::select(is_torn, t - past, end));
        let next = R::select(hit, t, ahead);
        Self {
            t: next,
            past: R::select(goes_past, further, t.constant(UNKNOWN)),
            gap,
            steps: steps + 1.0,
            hit: MaskValue(hit),
            goes_on: MaskValue(!hit & next.lt(t_max)),
            part,
        }
    }
}

/// How far a step goes past its sphere, in radii, by the limit `max_past`, and by the distances `before` and after the step
/// that went `past` its own. If the distance rises by m on each unit of the way (it falls with m < 0), a step of 2/(1 − m)
/// radii makes the spheres touch, which is (1 + m)/(1 − m) past the first.
fn radii_past<R: Real>(max_past: f32, before: R, past: R, gap: R) -> R {
    if max_past == 0.0 {
        return gap.constant(0.0);
    }
    let (way, rise) = (before + past, gap - before);
    let (of_rise, of_way) = (way + rise, way - rise);
    let of_plane = of_rise / of_way.max(of_rise * (1.0 / max_past));
    R::select(past.below(0.0), gap.constant(0.0), (of_plane * PAST_PER_PLANE).at_least(0.0))
}

/// Marches along a ray through a field which never exceeds the distance to its surface. `tolerance` is the tolerance at a
/// distance along the ray.
pub fn march<R: Real>(
    reach: MarchRange<R>,
    tolerance: impl Fn(R) -> R,
    both_sides: bool,
    field: &impl RayField<R>,
) -> MarchResult<R> {
    let start = March::start(reach.t_min, reach.t_max, field);
    let end = R::repeat(reach.max_steps, start, |march| {
        let next = march.step(reach.t_max, reach.max_past, &tolerance, both_sides, field);
        (next.goes_on.0, next)
    });
    end.result()
}

#[cfg(test)]
mod tests {
    use super::*;

    const REACH: MarchRange<f32> = MarchRange { t_min: 0.0, t_max: 40.0, max_steps: 10_000, max_past: MAX_PAST };
    const TOLERANCE: f32 = 1e-4;

    /// Numbers from 0 to 1.
    fn numbers(seed: u32) -> impl Iterator<Item = f32> {
        std::iter::successors(Some(seed), |&last| Some(last.wrapping_mul(1_664_525).wrapping_add(1_013_904_223)))
            .map(|bits| (bits >> 8) as f32 / (1 << 24) as f32)
            .skip(1)
    }

    #[test]
    fn no_step_passes_a_surface() {
        let mut rays = 0;
        for seed in 0..2_000 {
            let mut numbers = numbers(seed * 7919);
            let mut next = || numbers.next().expect("there is always another");
            // Balls that the ray meets, misses by a little, or passes.
            let balls: Vec<[f32; 3]> = (0..12).map(|_| [next() * 40.0, next() * 2.0, next().square()]).collect();
            let distance = |t: f32| {
                let gaps = balls
                    .iter()
                    .map(|&[along, beside, radius]| (t - along).square_add(beside.square()).sqrt() - radius);
                gaps.fold(f32::MAX, f32::min)
            };
            if distance(0.0) < TOLERANCE {
                continue;
            }
            let met = balls.iter().filter(|[_, beside, radius]| beside < radius);
            let roots = met.map(|&[along, beside, radius]| along - (radius.square() - beside.square()).sqrt());
            let first = roots.filter(|&root| root > 0.0).fold(REACH.t_max, f32::min);
            for both_sides in [false, true] {
                let marched = march(REACH, |_| TOLERANCE, both_sides, &distance);
                // Not beyond the first; a ball that the ray only passes closely is a hit, too.
                assert!(marched.hit.0 || first == REACH.t_max, "{seed}: {marched:?} {first}");
                assert!(!marched.hit.0 || marched.t < first + 2.0 * TOLERANCE, "{seed}: {marched:?} {first}");
            }
            rays += 1;
        }
        assert!(rays > 1_000, "{rays} rays start outside");
    }

    #[test]
    fn a_ray_along_a_plane_takes_few_steps() {
        let steps = |max_past: f32| {
            let reach = MarchRange { max_past, ..REACH };
            let marched = march(reach, |_| TOLERANCE, false, &|t: f32| (20.0 - t) * 0.05);
            assert!(marched.hit.0 && (marched.t - 20.0).abs() < 0.01, "{marched:?}");
            marched.steps
        };
        let (long, short) = (steps(MAX_PAST), steps(0.0));
        assert!(long < 0.6 * short, "{long} steps, {short} within their spheres");
    }
}
