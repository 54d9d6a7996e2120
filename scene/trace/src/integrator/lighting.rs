//! Incident light at a point, and its occlusion.

use super::ray_kinds::RayFunction;
use super::scene_distance::AlongRay;
use super::{Hit, Integrator};
use crate::ambient_occlusion::AmbientOcclusion;
use crate::lights::{AmbientLight, LightSample, PlacedLight};
use crate::march::{MarchRange, MarchResult, march};
use crate::materials::IncidentLight;
use crate::materials::microfacet::orthonormal_basis;
use crate::ray::Ray;
use crate::real::{Real, Vec3};
use crate::sampling::Sampler;

/// Purposes of random numbers, see [`Sampler::get_2d`]: the light with index i uses `OF_LIGHTS` + i.
pub(super) const IN_PIXEL: u32 = 0;
pub(super) const OF_DIRECTION: u32 = 1;
pub(super) const OF_LOBE: u32 = 2;
pub(super) const IN_MEDIA: u32 = 3;
/// Which light, and where on it.
pub(super) const OF_LIGHT: u32 = 4;
pub(super) const ON_LIGHT: u32 = 5;
/// Where the lens lets a ray through.
pub(super) const ON_LENS: u32 = 7;
/// Whether a path goes on.
pub(super) const OF_ROULETTE: u32 = 6;
/// Along rays toward lights.
pub(super) const IN_SHADOWING_MEDIA: u32 = 8;
const OF_LIGHTS: u32 = 16;
/// Growth of the tolerance of shadow rays per distance.
pub(super) const SHADOW_SLOPE: f32 = 4e-7;
/// Distance evaluations of one normal.
pub(super) const NORMAL_EVALUATIONS: f32 = 4.0;

impl Integrator<'_> {
    /// Color of a surface, and its number of distance evaluations.
    pub(super) fn surface<R: Real>(
        &self,
        ray: &Ray<R>,
        marched: &MarchResult<R>,
        sampler: &Sampler<R>,
    ) -> (Vec3<R>, R) {
        let hit = self.hit(ray, marched);
        let (light, evaluations) = self.incident_light(&hit, sampler);
        (self.shade(&hit, ray, &light), evaluations + self.surface_evaluations())
    }

    /// Distance evaluations of one hit and its material.
    pub(super) fn surface_evaluations(&self) -> f32 {
        NORMAL_EVALUATIONS + self.detail_evaluations() + self.shade_evaluations()
    }

    /// Incident light at a hit, and the number of distance evaluations it took.
    pub(super) fn incident_light<R: Real>(&self, hit: &Hit<R>, sampler: &Sampler<R>) -> (IncidentLight<R>, R) {
        let zero = hit.t.constant(0.0);
        let mut evaluations = zero;
        let mut light = IncidentLight { lights: Vec::new(), ambient: None, ambient_visibility: None, shadow: None };
        if !self.materials.slots().any(|slot| self.scene.used_materials()[slot].is_lit()) {
            return (light, evaluations);
        }
        light.ambient_visibility = self.ambient_visibility(hit);
        if light.ambient_visibility.is_some() {
            evaluations = evaluations + AmbientOcclusion::SAMPLES;
        }
        let farthest = zero.uniform(self.scene.march.max_distance.get());
        let mut caught = CaughtLight { all: zero, arriving: zero };
        for (index, source) in self.scene.lights.iter().enumerate() {
            let pair = || sampler.get_2d(OF_LIGHTS + index as u32);
            let environment = self.scene.environment();
            if let Some((mut incoming, distance)) = source.sample_at(hit.position, farthest, environment.day(), pair) {
                let unoccluded = incoming.radiance;
                if source.options().casts_shadows {
                    let (visible, of_shadow) = self.shadow_visibility(hit, incoming.direction, distance);
                    incoming.radiance = incoming.radiance * visible;
                    evaluations = evaluations + of_shadow;
                }
                let cosine = hit.normal.dot(incoming.direction).at_least(0.0);
                caught.add(unoccluded * cosine, incoming.radiance * cosine);
                light.lights.push(incoming);
            } else if let Some(sky) = source.ambient(environment) {
                let (around, unoccluded, of_sky) =
                    self.sky_light(sky, source.options().casts_shadows, hit, light.ambient_visibility, pair);
                evaluations = evaluations + of_sky;
                caught.add(unoccluded, around);
                light.ambient = Some(light.ambient.map_or(around, |sum| sum + around));
            }
        }
        light.shadow = self.materials.catches_shadows.then(|| caught.shadow());
        (light, evaluations)
    }

    fn ambient_visibility<R: Real>(&self, hit: &Hit<R>) -> Option<R> {
        let occlusion = self.scene.ambient_occlusion.as_ref()?;
        Some(occlusion.visibility(hit.position, hit.normal, |p| self.of_shadow_rays().distance(p)))
    }

    /// Ambient light, the same without occlusion, and the number of distance evaluations for the occlusion.
    fn sky_light<R: Real>(
        &self,
        sky: AmbientLight<'_>,
        casts_shadows: bool,
        hit: &Hit<R>,
        openness: Option<R>,
        pair: impl FnOnce() -> (R, R),
    ) -> (Vec3<R>, Vec3<R>, R) {
        let strength = hit.t.uniform(sky.strength);
        if !casts_shadows && let Some(mean) = sky.from.cosine_mean(hit.normal) {
            let mean = mean * strength;
            return (openness.map_or(mean, |openness| mean * openness), mean, hit.t.constant(0.0));
        }
        let direction = sample_cosine_hemisphere(hit.normal, pair());
        let seen = sky.from.radiance(direction) * strength;
        if !casts_shadows {
            return (openness.map_or(seen, |openness| seen * openness), seen, hit.t.constant(0.0));
        }
        let farthest = hit.t.uniform(self.scene.march.max_distance.get());
        let (visible, evaluations) = self.shadow_visibility(hit, direction, farthest);
        (seen * visible, seen, evaluations)
    }

    /// Fraction of the light from `direction` that reaches the hit, and the number of distance evaluations it took.
    pub(super) fn shadow_visibility<R: Real>(&self, hit: &Hit<R>, direction: Vec3<R>, farthest: R) -> (R, R) {
        let shadows = self.of_shadow_rays();
        let key = shadows.key(RayFunction::Visibility);
        farthest.call(key, (*hit, direction, farthest), |(hit, direction, farthest)| {
            let zero = farthest.constant(0.0);
            // Start farther from the surface than the march ended.
            let near = self.tolerance.at(hit.t);
            let ray = Ray { origin: hit.normal.mul_add(near * 4.0, hit.position), direction };
            let faces = hit.normal.dot(direction).above(0.0);
            R::when(faces, (zero, zero), || {
                let (visible, evaluations) = shadows.is_unoccluded(&ray, near, farthest);
                match &shadows.media {
                    None => (visible, evaluations),
                    Some(media) => R::when(visible.above(0.0), (visible, evaluations), || {
                        (shadows.transmittance(media, &ray, farthest), evaluations)
                    }),
                }
            })
        })
    }

    /// 1 if no surface is on the ray nearer than `farthest`, else 0; and the number of distance evaluations it took.
    pub(super) fn is_unoccluded<R: Real>(&self, ray: &Ray<R>, near: R, farthest: R) -> (R, R) {
        let (zero, one) = (farthest.constant(0.0), farthest.constant(1.0));
        let (nearest, farthest) = self.bounds.intersect_ray(ray, farthest);
        R::when(nearest.lt(farthest), (one, zero), || {
            let (max_steps, max_past) = (self.scene.march.max_steps, self.max_past);
            let reach = MarchRange { t_min: nearest, t_max: farthest, max_steps, max_past };
            let marched =
                march(reach, |t| t.mul_add(t.constant(SHADOW_SLOPE), near), false, &AlongRay { integrator: self, ray });
            (R::select(marched.is_occluded(farthest), zero, one), marched.evaluations)
        })
    }
}

/// Light on a matte surface, for shadow catchers: the mean of the channels.
struct CaughtLight<R> {
    /// Without occlusion.
    all: R,
    arriving: R,
}

impl<R: Real> CaughtLight<R> {
    fn add(&mut self, all: Vec3<R>, arriving: Vec3<R>) {
        self.all = self.all + all.mean();
        self.arriving = self.arriving + arriving.mean();
    }

    /// Fraction of the light that does not arrive; 0 where there is no light at all.
    fn shadow(&self) -> R {
        ((self.all - self.arriving) / self.all.at_least(1e-9)).at_least(0.0)
    }
}

/// Cosine-weighted direction around a normal: a point of the unit disk, projected onto the hemisphere.
fn sample_cosine_hemisphere<R: Real>(normal: Vec3<R>, (u, v): (R, R)) -> Vec3<R> {
    let (right, up) = orthonormal_basis(normal);
    let (sine, cosine) = (v * std::f32::consts::TAU).sin_cos();
    let away = u.sqrt();
    let height = (u.constant(1.0) - u).sqrt();
    let along = normal.mul_add(height, right * (away * cosine));
    up.mul_add(away * sine, along)
}

/// All lights as they arrive unoccluded at a point inside a medium, with their indices.
pub(super) fn sample_lights<'a, R: Real>(
    program: &'a Integrator<'_>,
    p: Vec3<R>,
    sampler: &'a Sampler<R>,
) -> impl Iterator<Item = (&'a PlacedLight, LightSample<R>, R)> {
    let farthest = p.x.uniform(program.scene.march.max_distance.get());
    program.scene.lights.iter().enumerate().filter_map(move |(index, source)| {
        let day = program.scene.environment().day();
        let (incoming, distance) = source.sample_at(p, farthest, day, || sampler.get_2d(OF_LIGHTS + index as u32))?;
        Some((source, incoming, distance))
    })
}
