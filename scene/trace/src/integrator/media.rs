//! Participating media: emission, scattering and absorption along a ray through clouds and volumes.
//!
//! Transmittance follows the Beer-Lambert law. Only single scattering of direct light is computed here: `media_path.rs`
//! follows paths through media.

use super::Integrator;
use super::lighting::sample_lights;
use super::ray_kinds::RayFunction;
use crate::bounds::Bounds;
use crate::camera::View;
use crate::lights::{AmbientLight, Light};
use crate::materials::MediumMaterial;
use crate::ray::Ray;
use crate::real::{Real, Vec3, bundle, vec3};
use crate::sampling::Sampler;
use crate::scene::Scene;
use crate::visible::RayKind;

/// Media of a scene.
#[derive(Clone, Debug)]
pub(super) struct Media<'a> {
    pub(super) all: Vec<Medium<'a>>,
    /// Bounds of all media.
    pub(super) bounds: Bounds,
    /// Upper bound of the extinction of all media together.
    pub(super) majorant: f32,
    /// Maximum number of steps of a camera ray through media.
    max_steps: u32,
    /// Maximum number of steps of a ray toward a light.
    light_steps: u32,
}

/// An object with a medium material.
#[derive(Clone, Debug)]
pub(super) struct Medium<'a> {
    pub(super) object: usize,
    pub(super) material: MediumMaterial<'a>,
    /// Length of a step inside.
    step: f32,
}

/// Result of integrating media along a segment of a ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct MediumSegment<R> {
    /// Light emitted or scattered toward the viewer.
    pub(super) color: Vec3<R>,
    /// Transmittance of the segment.
    pub(super) transmittance: R,
    /// Evaluations of the scene's distance, for shadows in the media.
    pub(super) evaluations: R,
}

bundle!(MediumSegment { color, transmittance, evaluations });

/// Medium properties at a point.
struct MediumProperties<R> {
    /// Extinction coefficient.
    extinction: R,
    /// Extinction times the radiance toward the viewer.
    source: Vec3<R>,
    /// Evaluations of the scene's distance that it took.
    evaluations: R,
}

/// Transmittance below which the ray stops, because the background is no longer visible.
const MIN_TRANSMITTANCE: f32 = 1.0 / 256.0;
/// Maximum number of steps outside all media, on the way to one of them.
const MAX_EMPTY_STEPS: u32 = 96;

impl<'a> Media<'a> {
    /// The media that rays of a kind see, if there are any; `view` is the camera's.
    pub(super) fn new(scene: &'a Scene, rays: RayKind, view: &View) -> Option<Self> {
        let mut all = Vec::new();
        let mut bounds = Bounds::EMPTY;
        let (mut max_steps, mut light_steps) = (0, 0);
        for (object, tree) in scene.objects.iter().enumerate() {
            let Some(filling) = scene.material_of(object).as_medium() else { continue };
            if !tree.visible.to(rays) {
                continue;
            }
            let own = tree.shape.bounds(0.0);
            let within = if own.is_finite() { own.diagonal() } else { scene.march.max_distance.in_frame() };
            all.push(Medium { object, step: within / filling.steps() as f32, material: filling });
            bounds = if all.len() == 1 { own } else { bounds.union(own) };
            max_steps += filling.steps();
            light_steps = light_steps.max(filling.light_steps());
        }
        let majorant = all.iter().map(|medium| medium.material.density()).sum();
        (!all.is_empty()).then(|| Self { all, bounds: view.with_margin(bounds), majorant, max_steps, light_steps })
    }
}

impl Integrator<'_> {
    /// Integrates the media along a ray up to `farthest`.
    pub(super) fn integrate_media<R: Real>(
        &self,
        media: &Media<'_>,
        ray: &Ray<R>,
        farthest: R,
        sampler: &Sampler<R>,
    ) -> MediumSegment<R> {
        let (zero, one) = (farthest.constant(0.0), farthest.constant(1.0));
        let nothing = MediumSegment { color: vec3(zero, zero, zero), transmittance: one, evaluations: zero };
        let (near, far) = media.bounds.intersect_ray(ray, farthest);
        R::when(near.lt(far), nothing, || {
            let (_, jitter) = sampler.get_2d(super::lighting::IN_MEDIA);
            let (_, crossed) = R::repeat(media.max_steps + MAX_EMPTY_STEPS, (near, nothing), |(t, crossed)| {
                let (step, crossed) = self.media_step(media, ray, t, jitter, &crossed, sampler);
                let next = t + step;
                (next.lt(far) & crossed.transmittance.above(MIN_TRANSMITTANCE), (next, crossed))
            });
            crossed
        })
    }

    /// Length of the step from `t` on a ray, and the media integrated to its end.
    fn media_step<R: Real>(
        &self,
        media: &Media<'_>,
        ray: &Ray<R>,
        t: R,
        jitter: R,
        crossed: &MediumSegment<R>,
        sampler: &Sampler<R>,
    ) -> (R, MediumSegment<R>) {
        let p = ray.at(t);
        let (mut outside, mut inside_step) = (t.constant(1e9), t.constant(1e9));
        let mut depths = Vec::with_capacity(media.all.len());
        for medium in &media.all {
            let distance = self.object_distance(medium.object, p);
            let step = t.uniform(medium.step);
            inside_step = inside_step.min(R::select(distance.below(0.0), step, inside_step));
            // The first step into a medium is shortened by a random amount, else the rim would be visible.
            outside = outside.min(R::select(distance.below(0.0), outside, jitter.mul_add(step, distance)));
            depths.push(-distance);
        }
        let is_inside = inside_step.below(1e9);
        let step = R::select(is_inside, inside_step.min(outside), outside).at_least(1e-6);
        let here = *crossed;
        let crossed = R::when(is_inside, here, || {
            let properties = self.medium_properties(media, p, &depths, ray.direction, sampler);
            let left = (-(properties.extinction * step)).exp();
            let share = (left.constant(1.0) - left) * here.transmittance / properties.extinction.at_least(1e-9);
            let sent = properties.source * share;
            let sent = match &self.scene.fog {
                None => sent,
                Some(fog) => {
                    let clear = fog.transmittance(ray, t);
                    let veiled = (clear.constant(1.0) - clear) * share * properties.extinction;
                    self.fog_color(fog, ray.direction).mul_add(veiled, sent * clear)
                }
            };
            MediumSegment {
                color: here.color + sent,
                transmittance: here.transmittance * left,
                evaluations: here.evaluations + properties.evaluations,
            }
        });
        (step, crossed)
    }

    /// Medium properties at `p`, whose distances to the media are given, and the radiance sent against `direction`.
    fn medium_properties<R: Real>(
        &self,
        media: &Media<'_>,
        p: Vec3<R>,
        depths: &[R],
        direction: Vec3<R>,
        sampler: &Sampler<R>,
    ) -> MediumProperties<R> {
        let zero = p.x.constant(0.0);
        let black = vec3(zero, zero, zero);
        let mut properties = MediumProperties { extinction: zero, source: black, evaluations: zero };
        let mut scattering = Vec::new();
        for (medium, &depth) in media.all.iter().zip(depths) {
            let extinction = medium.material.extinction(p, depth);
            properties.extinction = properties.extinction + extinction;
            properties.source = medium.material.emission(p.x).mul_add(extinction, properties.source);
            if let Some(volume) = medium.material.as_scattering() {
                scattering.push((volume, extinction));
            }
        }
        if scattering.is_empty() {
            return properties;
        }
        let thick = scattering.iter().fold(zero, |sum, (_, extinction)| sum + *extinction).above(1e-6);
        (properties.source, properties.evaluations) = R::when(thick, (properties.source, zero), || {
            let (mut sent, mut evaluations) = (properties.source, zero);
            for (source, incoming, distance) in sample_lights(self, p, sampler) {
                let (lit, of_shadow) = self.light_optical_depth(source, p, incoming.direction, distance);
                evaluations = evaluations + of_shadow;
                let cosine = direction.dot(incoming.direction);
                for (volume, extinction) in &scattering {
                    let phase = volume.phase(cosine, lit);
                    sent = incoming
                        .radiance
                        .mul_elementwise(volume.scattering_albedo(p.x))
                        .mul_add(phase * *extinction, sent);
                }
            }
            for source in &self.scene.lights {
                let Some(AmbientLight { from, strength }) = source.ambient(self.scene.environment()) else {
                    continue;
                };
                let (up, down) = (vec3(zero, zero.constant(1.0), zero), vec3(zero, zero.constant(-1.0), zero));
                let mean = (from.radiance(up) + from.radiance(down)) * zero.uniform(0.5 * strength);
                for (volume, extinction) in &scattering {
                    sent = mean.mul_elementwise(volume.scattering_albedo(p.x)).mul_add(*extinction, sent);
                }
            }
            (sent, evaluations)
        });
        properties
    }

    /// Optical depth τ between a light and `p`; 80 if a surface is in between, so that exp(−τ) is 0. And the number of
    /// evaluations of the scene's distance that it took.
    fn light_optical_depth<R: Real>(&self, source: &Light, p: Vec3<R>, direction: Vec3<R>, distance: R) -> (R, R) {
        const OPAQUE_DEPTH: f32 = 80.0;
        let zero = p.x.constant(0.0);
        if !source.options().casts_shadows {
            return (zero, zero);
        }
        let ray = Ray { origin: p, direction };
        let shadows = self.of_shadow_rays();
        let depth = shadows.media.as_ref().map_or(zero, |media| shadows.optical_depth(media, &ray, distance));
        if shadows.surfaces.is_empty() {
            return (depth, zero);
        }
        let near = p.x.uniform(self.tolerance.floor) + p.x.uniform(self.tolerance.slope);
        let (visible, evaluations) = shadows.is_unoccluded(&ray, near, distance);
        (depth + (visible.constant(1.0) - visible) * OPAQUE_DEPTH, evaluations)
    }

    /// Transmittance of the media along a ray toward a light.
    pub(super) fn transmittance<R: Real>(&self, media: &Media<'_>, ray: &Ray<R>, farthest: R) -> R {
        (-self.optical_depth(media, ray, farthest)).exp()
    }

    /// Optical depth along a ray up to `farthest`: the integral of the extinction.
    fn optical_depth<R: Real>(&self, media: &Media<'_>, ray: &Ray<R>, farthest: R) -> R {
        farthest.call(self.key(RayFunction::OpticalDepth), (*ray, farthest), |(ray, farthest)| {
            let zero = farthest.constant(0.0);
            let (near, far) = media.bounds.intersect_ray(&ray, farthest);
            R::when(near.lt(far), zero, || {
                let step = (far - near) * zero.constant(1.0 / media.light_steps as f32);
                let start = step.mul_add(zero.constant(0.5), near);
                let (_, sum) = R::repeat(media.light_steps, (start, zero), |(t, sum)| {
                    let here = self.extinction(media, ray.at(t));
                    let sum = here.mul_add(step, sum);
                    (sum.below(20.0), (t + step, sum))
                });
                sum
            })
        })
    }

    /// Total extinction of the media at `p`.
    pub(super) fn extinction<R: Real>(&self, media: &Media<'_>, p: Vec3<R>) -> R {
        let own = media.all.iter().map(|medium| self.extinction_of(medium, p));
        own.fold(p.x.constant(0.0), |sum, own| sum + own)
    }

    /// Extinction of a medium at `p`.
    pub(super) fn extinction_of<R: Real>(&self, medium: &Medium<'_>, p: Vec3<R>) -> R {
        let depth = -self.object_distance(medium.object, p);
        R::when(depth.above(0.0), p.x.constant(0.0), || medium.material.extinction(p, depth))
    }
}
