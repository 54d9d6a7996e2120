//! Path tracing in lanes that do not wait for one another.
//!
//! The lanes of a CPU's vector, and the threads of a GPU's warp, take the same steps at once. Their marches, and their paths,
//! are of different lengths. So there is one loop of marches for rays of paths and for shadow rays: it pauses when few lanes
//! still march, the others take what follows their march, and all march on. A lane whose path has ended goes on with its next
//! sample at once: Jan Novák, Vlastimil Havran and Carsten Dachsbacher, "Path regeneration for interactive path tracing",
//! Eurographics 2010, short papers. No result depends on the other lanes.

use super::light_path::{LightPath, segments};
use super::lighting::SHADOW_SLOPE;
use super::scene_distance::AlongRay;
use super::straight_shadows::Glass;
use super::{Integrator, Radiance};
use crate::march::March;
use crate::ray::Ray;
use crate::real::{MaskValue, Real, Vec3, bundle};
use crate::sampling::PixelSampler;
use crate::transport::{PathSettings, Transport};

/// Maximum number of rounds, more than the samples that are rendered at once ever take.
const MAX_ROUNDS: u32 = 1 << 31;

/// Samples of a pixel, the path of one of them, and the march along its shadow ray or its ray.
#[derive(Clone, Copy)]
pub struct Lane<R: Real> {
    march: March<R>,
    sample: R,
    sum: Radiance<R>,
    path: LightPath<R>,
    /// Where the ray leaves the scene's bounds, or is at its light.
    farthest: R,
}

bundle!(Lane { march, sample, sum, path, farthest });

/// The part of a lane that its march needs.
#[derive(Clone, Copy)]
pub struct MarchedRay<R: Real> {
    ray: Ray<R>,
    near: R,
    slope: R,
    farthest: R,
}

bundle!(MarchedRay { ray, near, slope, farthest });

/// The steps of [`Integrator::accumulate`] where it traces paths, for processors that run their loops otherwise: a lane
/// starts, marches while its march goes on, takes what follows its march, and marches again, until its sample is the end.
#[derive(Clone, Copy, Debug)]
pub struct PathSteps<'a> {
    integrator: &'a Integrator<'a>,
    max_bounces: u32,
}

impl<R: Real> Lane<R> {
    /// The march.
    pub fn march(&self) -> March<R> {
        self.march
    }

    /// The lane with another number in place of its evaluations of the distance field, which are not counted then.
    pub fn without_evaluations(self, none: R) -> Self {
        let sum = Radiance { evaluations: none, ..self.sum };
        Self { sum, path: LightPath { evaluations: none, ..self.path }, ..self }
    }
}

impl<R: Real> LightPath<R> {
    /// The ray to trace next.
    fn next_ray(&self) -> Ray<R> {
        let is_shadow = self.shadow.is_traced.0;
        Ray {
            origin: Vec3::select(is_shadow, self.from.position, self.ray.origin),
            direction: Vec3::select(is_shadow, self.shadow.direction, self.ray.direction),
        }
    }

    /// Whether the ray to trace next ends at a light, or else at the first surface.
    fn ends_at_light(&self) -> R::Mask {
        let is_shadow = self.shadow.is_traced.0;
        self.shadow.object.map_or(is_shadow, |object| is_shadow & object.below(-0.5))
    }
}

impl Integrator<'_> {
    /// The steps of paths, if [`Integrator::accumulate`] takes them: not if rays of other kinds see other objects, by
    /// other formulas.
    pub fn path_steps(&self) -> Option<PathSteps<'_>> {
        match self.scene.integrator {
            Transport::Path(PathSettings { max_bounces, straight_shadows: _ })
                if self.of_reflections.is_none() && self.of_shadows.is_none() =>
            {
                Some(PathSteps { integrator: self, max_bounces })
            }
            Transport::Path(_) | Transport::Direct => None,
        }
    }
}

impl PathSteps<'_> {
    /// Adds samples of a pixel to `sum`, as [`Integrator::accumulate`] does.
    pub(super) fn accumulate<R: Real>(&self, [x, y]: [R; 2], [first, end]: [R; 2], sum: Radiance<R>) -> Radiance<R> {
        let all = self.integrator;
        let pixel = all.pixel_sampler(x, y);
        let start = self.start_lane(&pixel, first, sum);
        // In each round, every lane takes a step of a march, or what follows a march.
        let rays = all.samples.saturating_mul(2 * segments(self.max_bounces));
        let rounds = rays.saturating_mul(2 * (all.scene.march.max_steps + 1)).min(MAX_ROUNDS);
        let last = R::repeat(rounds, start, |lane| {
            // Marches on, until few of the lanes that do have steps left to take.
            let march = R::when(lane.march.goes_on.0, lane.march, || {
                let ray = self.marched_ray(&lane);
                R::repeat_while_many(all.scene.march.max_steps, lane.march, |march| {
                    let next = self.march_step(&ray, march);
                    (next.goes_on.0, next)
                })
            });
            let lane = Lane { march, ..lane };
            let lane = R::when(!march.goes_on.0, lane, || self.end_march(lane, &pixel));
            (lane.sample.lt(end), lane)
        });
        last.sum
    }

    /// A lane that starts with a sample of the pixel (`x`, `y`), to be added to `sum`.
    pub fn start<R: Real>(&self, x: R, y: R, sample: R, sum: Radiance<R>) -> Lane<R> {
        self.start_lane(&self.integrator.pixel_sampler(x, y), sample, sum)
    }

    fn start_lane<R: Real>(&self, pixel: &PixelSampler<R>, sample: R, sum: Radiance<R>) -> Lane<R> {
        let path = self.start_path(pixel, sample);
        let (march, farthest) = self.start_march(&path);
        Lane { march, sample, sum, path, farthest }
    }

    fn start_path<R: Real>(&self, pixel: &PixelSampler<R>, sample: R) -> LightPath<R> {
        self.integrator.start_path(self.integrator.ray_of_sample(pixel, &pixel.sample(sample)))
    }

    /// A march along a path's next ray, and where that ends.
    fn start_march<R: Real>(&self, path: &LightPath<R>) -> (March<R>, R) {
        let all = self.integrator;
        let ray = path.next_ray();
        let farthest = path.t.uniform(all.scene.march.max_distance.get());
        let farthest = R::select(path.ends_at_light(), path.shadow.distance, farthest);
        let (nearest, farthest) = all.bounds.intersect_ray(&ray, farthest);
        (March::start(nearest, farthest, &AlongRay { integrator: all, ray: &ray }), farthest)
    }

    /// The part of the lane that its march needs.
    pub fn marched_ray<R: Real>(&self, lane: &Lane<R>) -> MarchedRay<R> {
        let near = lane.path.epsilon;
        let slope = near.uniform(self.integrator.tolerance.slope);
        let slope = R::select(lane.path.ends_at_light(), near.constant(SHADOW_SLOPE), slope);
        MarchedRay { ray: lane.path.next_ray(), near, slope, farthest: lane.farthest }
    }

    /// A step of a march that goes on.
    pub fn march_step<R: Real>(&self, marched: &MarchedRay<R>, march: March<R>) -> March<R> {
        let MarchedRay { ray, near, slope, farthest } = *marched;
        let all = self.integrator;
        let along = AlongRay { integrator: all, ray: &ray };
        let next = march.step(farthest, all.max_past, |t| t.mul_add(slope, near), all.lets_through, &along);
        let goes_on = next.goes_on.0 & next.steps.below(all.scene.march.max_steps as f32);
        March { goes_on: MaskValue(goes_on), ..next }
    }

    /// The lane after a march of the pixel (`x`, `y`) that has ended.
    pub fn after_march<R: Real>(&self, x: R, y: R, lane: Lane<R>) -> Lane<R> {
        self.end_march(lane, &self.integrator.pixel_sampler(x, y))
    }

    /// Searches the root where a march has ended, and then adds the light of a shadow ray, or bounces. Starts the next march.
    fn end_march<R: Real>(&self, lane: Lane<R>, pixel: &PixelSampler<R>) -> Lane<R> {
        let all = self.integrator;
        let Lane { march, sample, sum, path, farthest } = lane;
        let ray = path.next_ray();
        let marched = march.result();
        let found =
            R::when(!path.ends_at_light(), marched, || all.found_surface(&ray, path.epsilon, marched, farthest));
        let mut path = path;
        // A further march goes on with these steps, so that they are counted at its end.
        path.evaluations = path.evaluations + (found.evaluations - found.steps);
        let has_steps = found.steps.below(all.scene.march.max_steps as f32);
        let mut passes = marched.hit.0 & !found.hit.0 & found.t.lt(farthest) & has_steps;
        let mut next = found.t;
        if all.has_straight_shadows() {
            let is_met = path.shadow.is_traced.0 & found.hit.0;
            let glass =
                R::when(is_met, Glass::opaque(found.t.constant(0.0)), || all.glass_in_the_way(&path, &ray, &found));
            let goes_through = glass.filter.max_element().above(0.0);
            path.shadow.color =
                Vec3::select(goes_through, path.shadow.color.mul_elementwise(glass.filter), path.shadow.color);
            next = R::select(goes_through, glass.beyond, next);
            path.evaluations = path.evaluations + glass.evaluations;
            passes = passes | (goes_through & has_steps);
        }
        let along = AlongRay { integrator: all, ray: &ray };
        let further = March { steps: found.steps, ..March::start(next, farthest, &along) };
        R::when(!passes, Lane { march: further, sample, sum, path, farthest }, || {
            let mut path = path;
            path.evaluations = path.evaluations + found.steps;
            let sampler = pixel.sample(sample);
            let is_shadow = path.shadow.is_traced.0;
            let bounced = R::when(!is_shadow, path, || {
                all.after_march(path, &found, self.max_bounces, &sampler.after(path.bounce))
            });
            let path = R::when(is_shadow, bounced, || {
                let (occluded, zero) = (found.is_occluded(farthest), found.t.constant(0.0));
                let mut visible = R::select(occluded, zero, found.t.constant(1.0));
                let mut asked = zero;
                let mut length = path.shadow.distance;
                if let Some(object) = path.shadow.object {
                    let of_light = object.below(-0.5);
                    length = R::select(of_light, length, found.t);
                    (visible, asked) = R::when(!of_light, (visible, zero), || {
                        R::when(found.hit.0, (zero, zero), || all.is_of_object(&ray, found.t, object))
                    });
                }
                let visible =
                    all.through_media(ray.origin, visible, length, ray.direction, &sampler.after(path.bounce - 1.0));
                path.shadow_ray_traced(visible, asked)
            });
            let has_ended = !path.is_active.0 & !path.shadow.is_traced.0;
            let (sample, sum, path) = R::when(has_ended, (sample, sum, path), || {
                let next = sample + 1.0;
                (next, sum + all.radiance_of(&path), self.start_path(pixel, next))
            });
            let (march, farthest) = self.start_march(&path);
            Lane { march, sample, sum, path, farthest }
        })
    }
}
