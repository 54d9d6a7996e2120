//! Paths through media: light is scattered any number of times.
//!
//! The distance of the next collision is sampled by delta tracking: E. R. Woodcock et al., "Techniques used in the GEM code
//! for Monte Carlo neutronics calculations in reactors and other systems of complex geometry", ANL-7050, 1965. The
//! transmittance toward lights is estimated by ratio tracking: Jan Novák, Andrew Selle and Wojciech Jarosz, "Residual ratio
//! tracking for estimating attenuation in participating media", ACM Transactions on Graphics 33(6), 2014. Both are unbiased
//! for any density that is at most the majorant.

use std::f32::consts::PI;

use super::Integrator;
use super::emitters::NextEvent;
use super::light_path::LightPath;
use super::lighting::{IN_MEDIA, IN_SHADOWING_MEDIA, OF_DIRECTION, OF_LOBE};
use super::media::Media;
use super::ray_density::RayDensity;
use crate::lights::{NEVER, direction_around};
use crate::materials::MediumScattering;
use crate::materials::microfacet::orthonormal_basis;
use crate::ray::Ray;
use crate::real::{MaskValue, Real, Vec3, bundle, vec3};
use crate::sampling::Sampler;
use crate::scene::LightGroups;

/// Maximum number of tentative collisions on a ray.
const MAX_COLLISIONS: u32 = 2048;
/// Bounces that a sampler tells apart from the collisions of each bounce.
const BOUNCES: f32 = 64.0;
/// Anisotropy up to which scattering counts as isotropic.
const ISOTROPIC: f32 = 1e-3;

/// A medium where light is scattered.
#[derive(Clone, Copy)]
struct Scatterer<R> {
    albedo: Vec3<R>,
    emission: Vec3<R>,
    anisotropy: R,
    /// Place of the light group of its emission; `None` if the picture has no groups.
    group: Option<R>,
}

bundle!(Scatterer { albedo, emission, anisotropy, group });

impl Integrator<'_> {
    /// Distance of a ray's next collision with media; [`NEVER`] if there is none before `farthest`.
    pub(super) fn free_flight<R: Real>(&self, media: &Media<'_>, ray: &Ray<R>, farthest: R, sampler: &Sampler<R>) -> R {
        let never = farthest.constant(NEVER);
        let (near, far) = media.bounds.intersect_ray(ray, farthest);
        R::when(near.lt(far), never, || {
            let zero = farthest.constant(0.0);
            let (_, _, collision) = R::repeat(MAX_COLLISIONS, (near, zero, never), |(t, count, _)| {
                let (step, (_, choice)) = tentative_step(media, count, sampler, IN_MEDIA);
                let t = t + step;
                let is_inside = t.lt(far);
                let majorant = zero.uniform(media.majorant);
                let extinction = R::when(is_inside, zero, || self.extinction(media, ray.at(t)));
                let is_real = (choice * majorant).lt(extinction);
                (is_inside & !is_real, (t, count + 1.0, R::select(is_real, t, never)))
            });
            collision
        })
    }

    /// An estimate of the transmittance of the media along a ray up to `farthest`.
    pub(super) fn tracked_transmittance<R: Real>(
        &self,
        media: &Media<'_>,
        ray: &Ray<R>,
        farthest: R,
        sampler: &Sampler<R>,
    ) -> R {
        let (zero, one) = (farthest.constant(0.0), farthest.constant(1.0));
        let (near, far) = media.bounds.intersect_ray(ray, farthest);
        R::when(near.lt(far), one, || {
            let (_, _, left) = R::repeat(MAX_COLLISIONS, (near, zero, one), |(t, count, left)| {
                let (step, _) = tentative_step(media, count, sampler, IN_SHADOWING_MEDIA);
                let t = t + step;
                let is_inside = t.lt(far);
                let left = R::when(is_inside, left, || {
                    let share = self.extinction(media, ray.at(t)) / zero.uniform(media.majorant).at_least(1e-30);
                    left * (one - share).at_least(0.0)
                });
                (is_inside & left.above(0.0), (t, count + 1.0, left))
            });
            left
        })
    }

    /// Lights the point at the distance `t` of a path's ray, where media scatter it, and samples where it goes on.
    pub(super) fn scatter_in_media<R: Real>(
        &self,
        path: LightPath<R>,
        media: &Media<'_>,
        t: R,
        max_bounces: u32,
        sampler: &Sampler<R>,
    ) -> LightPath<R> {
        let zero = t.constant(0.0);
        let p = path.ray.at(t);
        let scatterer = self.scatterer(media, p, sampler.get_2d(OF_LOBE).1);
        let emitted = path.throughput.mul_elementwise(scatterer.emission);
        let (color, groups) = (path.color + emitted, path.groups.with_chosen(emitted, scatterer.group));
        let ended = LightPath { color, groups, background_weight: zero, is_active: MaskValue(zero.above(0.0)), ..path };
        let is_last = path.bounce.above(max_bounces as f32 + 0.5);
        R::when(!is_last, ended, || {
            let throughput = path.throughput.mul_elementwise(scatterer.albedo);
            let near = zero.uniform(self.tolerance.floor);
            let here = self.vertex(p);
            let NextEvent { direction, arriving, density, shadow } = self.next_event(None, &here, sampler);
            let scattered = phase(scatterer.anisotropy, path.ray.direction.dot(direction));
            let weight = R::select(density.above(0.0), density / (density + scattered).at_least(1e-30), zero + 1.0);
            let light = throughput.mul_elementwise(arriving) * (scattered * PI * weight);
            let direction = sample_phase(scatterer.anisotropy, path.ray.direction, sampler.get_2d(OF_DIRECTION));
            let (goes_on, throughput) = path.after_roulette(throughput, sampler);
            let next = LightPath {
                ray: Ray { origin: p, direction },
                epsilon: near,
                t: path.t + t,
                throughput,
                color,
                groups,
                background_weight: zero,
                evaluations: path.evaluations,
                bounce: path.bounce + 1.0,
                density: RayDensity::new(phase(scatterer.anisotropy, path.ray.direction.dot(direction))),
                from: here,
                shadow: path.shadow,
                is_active: MaskValue(goes_on),
            };
            next.lit(light, shadow)
        })
    }

    /// One of the media at `p`, chosen by their extinction there.
    fn scatterer<R: Real>(&self, media: &Media<'_>, p: Vec3<R>, choice: R) -> Scatterer<R> {
        let zero = p.x.constant(0.0);
        let extinctions: Vec<R> = media.all.iter().map(|medium| self.extinction_of(medium, p)).collect();
        let target = choice * extinctions.iter().fold(zero, |sum, extinction| sum + *extinction);
        let black = vec3(zero, zero, zero);
        let group = self.group_number(zero, LightGroups::rest);
        let mut chosen = Scatterer { albedo: black, emission: black, anisotropy: zero, group };
        let mut before = zero;
        for (medium, extinction) in media.all.iter().zip(extinctions) {
            let after = before + extinction;
            let is_chosen = !target.lt(before) & target.lt(after);
            chosen = R::when(is_chosen, chosen, || {
                let MediumScattering { albedo, emission, anisotropy } = medium.material.scattering();
                Scatterer {
                    albedo: Vec3::uniform(zero, albedo),
                    emission: Vec3::uniform(zero, emission),
                    anisotropy: zero.uniform(anisotropy),
                    group: self.group_number(zero, |groups| groups.objects[medium.object]),
                }
            });
            before = after;
        }
        chosen
    }
}

/// Length of the step to the next tentative collision, and the random numbers of that.
fn tentative_step<R: Real>(media: &Media<'_>, count: R, sampler: &Sampler<R>, purpose: u32) -> (R, (R, R)) {
    let pair = sampler.after((count + 1.0).mul_add(count.constant(BOUNCES), sampler.bounce())).get_2d(purpose);
    let majorant = count.uniform(media.majorant).at_least(1e-30);
    (-(count.constant(1.0) - pair.0).ln() / majorant, pair)
}

/// The phase function of L. G. Henyey and J. L. Greenstein, "Diffuse radiation in the galaxy", Astrophysical Journal 93,
/// 1941, per steradian, for the cosine between the directions of travel before and after.
fn phase<R: Real>(anisotropy: R, cosine: R) -> R {
    let square = anisotropy * anisotropy;
    let below = (square + 1.0 - anisotropy * cosine * 2.0).at_least(1e-6);
    (square.constant(1.0) - square) * (0.25 / PI) / (below * below.sqrt())
}

/// A direction sampled by [`phase`] around the direction of travel.
fn sample_phase<R: Real>(anisotropy: R, travel: Vec3<R>, (u, v): (R, R)) -> Vec3<R> {
    let one = u.constant(1.0);
    let is_isotropic = anisotropy.abs().below(ISOTROPIC);
    let g = R::select(is_isotropic, one, anisotropy);
    let square = g * g;
    let share = (one - square) / (g * u).mul_add(one + one, one - g).at_least(1e-6);
    let cosine = (square + 1.0 - share * share) / (g + g);
    let versine = R::select(is_isotropic, u + u, one - cosine).at_least(0.0).at_most(2.0);
    let (right, up) = orthonormal_basis(travel);
    direction_around(travel, right, up, versine, v).normalize()
}
