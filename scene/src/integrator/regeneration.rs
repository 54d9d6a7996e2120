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
use super::{Integrator, Radiance};
use crate::camera::Ray;
use crate::march::{March, RELAXATION};
use crate::real::{MaskValue, Real, Vec3, bundle};
use crate::sampling::PixelSampler;

/// Maximum number of rounds, more than the samples that are rendered at once ever take.
const MAX_ROUNDS: u32 = 1 << 31;

/// Samples of a pixel, the path of one of them, and the march along its shadow ray or its ray.
#[derive(Clone, Copy)]
struct Lane<R: Real> {
    sample: R,
    sum: Radiance<R>,
    path: LightPath<R>,
    march: March<R>,
    /// Where the ray leaves the scene's bounds, or is at its light.
    farthest: R,
}

bundle!(Lane { sample, sum, path, march, farthest });

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
    /// Adds samples of a pixel to `sum`, as [`Integrator::accumulate`] does.
    pub(super) fn accumulate_paths<R: Real>(
        &self,
        pixel: &PixelSampler<R>,
        [first, end]: [R; 2],
        sum: Radiance<R>,
        max_bounces: u32,
    ) -> Radiance<R> {
        let path = self.start_path_of(pixel, first);
        let (march, farthest) = self.start_march(&path);
        let start = Lane { sample: first, sum, path, march, farthest };
        // In each round, every lane takes a step of a march, or what follows a march.
        let rays = self.samples.saturating_mul(2 * segments(max_bounces));
        let rounds = rays.saturating_mul(2 * (self.scene.march.max_steps + 1)).min(MAX_ROUNDS);
        let end = R::repeat(rounds, start, |lane| {
            let march = R::when(lane.march.goes_on.0, lane.march, || self.march_on(&lane));
            let lane = Lane { march, ..lane };
            let lane = R::when(!march.goes_on.0, lane, || self.after_marching(lane, pixel, max_bounces));
            (lane.sample.lt(end), lane)
        });
        end.sum
    }

    fn start_path_of<R: Real>(&self, pixel: &PixelSampler<R>, sample: R) -> LightPath<R> {
        self.start_path(self.ray_of_sample(pixel, &pixel.sample(sample)))
    }

    /// A march along a path's next ray, and where that ends.
    fn start_march<R: Real>(&self, path: &LightPath<R>) -> (March<R>, R) {
        let ray = path.next_ray();
        let farthest = path.t.uniform(self.scene.march.max_distance.get());
        let farthest = R::select(path.ends_at_light(), path.shadow.distance, farthest);
        let (nearest, farthest) = self.bounds.intersect_ray(&ray, farthest);
        (March::start(nearest, farthest, &AlongRay { integrator: self, ray: &ray }), farthest)
    }

    /// Marches on, until few of the lanes that do have steps left to take.
    fn march_on<R: Real>(&self, lane: &Lane<R>) -> March<R> {
        let (ray, near, max_steps) = (lane.path.next_ray(), lane.path.epsilon, self.scene.march.max_steps);
        let slope = near.uniform(self.tolerance.slope);
        let slope = R::select(lane.path.ends_at_light(), near.constant(SHADOW_SLOPE), slope);
        let along = AlongRay { integrator: self, ray: &ray };
        R::repeat_while_many(max_steps, lane.march, |march| {
            let next = march.step(lane.farthest, RELAXATION, |t| t.mul_add(slope, near), self.lets_through, &along);
            let goes_on = next.goes_on.0 & next.steps.below(max_steps as f32);
            (goes_on, March { goes_on: MaskValue(goes_on), ..next })
        })
    }

    /// Searches the root where a march has ended, and then adds the light of a shadow ray, or bounces. Starts the next march.
    fn after_marching<R: Real>(&self, lane: Lane<R>, pixel: &PixelSampler<R>, max_bounces: u32) -> Lane<R> {
        let Lane { sample, sum, path, march, farthest } = lane;
        let ray = path.next_ray();
        let marched = march.result();
        let found =
            R::when(!path.ends_at_light(), marched, || self.found_surface(&ray, path.epsilon, marched, farthest));
        let mut path = path;
        path.evaluations = path.evaluations + (found.evaluations - march.steps);
        let passes = marched.hit.0 & !found.hit.0 & found.t.lt(farthest);
        let passes = passes & found.steps.below(self.scene.march.max_steps as f32);
        let along = AlongRay { integrator: self, ray: &ray };
        let further = March { steps: found.steps, ..March::start(found.t, farthest, &along) };
        R::when(!passes, Lane { sample, sum, path, march: further, farthest }, || {
            let mut path = path;
            path.evaluations = path.evaluations + march.steps;
            let dice = pixel.sample(sample);
            let is_shadow = path.shadow.is_traced.0;
            let bounced =
                R::when(!is_shadow, path, || self.after_march(path, &found, max_bounces, &dice.after(path.bounce)));
            let path = R::when(is_shadow, bounced, || {
                let mut visible = R::select(found.hit.0, found.t.constant(0.0), found.t.constant(1.0));
                let mut length = path.shadow.distance;
                if let Some(object) = path.shadow.object {
                    let of_light = object.below(-0.5);
                    length = R::select(of_light, length, found.t);
                    visible = R::when(!of_light, visible, || {
                        R::when(found.hit.0, found.t.constant(0.0), || self.is_of_object(&ray, found.t, object))
                    });
                }
                let visible =
                    self.through_media(ray.origin, visible, length, ray.direction, &dice.after(path.bounce - 1.0));
                path.shadow_ray_traced(visible, found.t.constant(0.0))
            });
            let has_ended = !path.is_active.0 & !path.shadow.is_traced.0;
            let (sample, sum, path) = R::when(has_ended, (sample, sum, path), || {
                let next = sample + 1.0;
                (next, sum + self.radiance_of(&path), self.start_path_of(pixel, next))
            });
            let (march, farthest) = self.start_march(&path);
            Lane { sample, sum, path, march, farthest }
        })
    }
}
