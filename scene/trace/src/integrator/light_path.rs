//! Path tracing: light travels from surface to surface.
//!
//! At each surface, one light is chosen by its strength, and a direction toward it is sampled (next-event estimation); the
//! path goes on in a direction sampled by the BSDF. Lights that both can find are weighted by the balance heuristic: Eric
//! Veach and Leonidas Guibas, "Optimally combining sampling techniques for Monte Carlo rendering", SIGGRAPH 1995.

use super::emitters::{MetLight, NextEvent, ShadowRay, Vertex};
use super::grouped_light::GroupedLight;
use super::lighting::{OF_DIRECTION, OF_LOBE, OF_ROULETTE};
use super::ray_density::RayDensity;
use super::{Hit, Integrator, Radiance};
use crate::lights::NEVER;
use crate::march::MarchResult;
use crate::materials::bsdf::Geometry;
use crate::ray::{Ray, Tolerance};
use crate::real::{MaskValue, Real, Vec3, bundle, vec3};
use crate::sampling::Sampler;
use crate::scene::LightGroups;

/// Number of bounces from which on paths of little throughput end at random.
const FIRST_ROULETTE: f32 = 3.0;
/// Probability of going on, over the throughput, up to 1. Ending paths of more throughput costs more noise than it saves.
const SURVIVAL_PER_THROUGHPUT: f32 = 4.0;
/// Least probability of going on.
const MIN_SURVIVAL: f32 = 0.05;

/// State of a path after some bounces.
#[derive(Clone, Copy)]
pub(super) struct LightPath<R: Real> {
    pub(super) ray: Ray<R>,
    /// Tolerance at the start of the ray.
    pub(super) epsilon: R,
    /// Distance from the camera along the path.
    pub(super) t: R,
    /// Fraction of the light at the path's end that reaches the camera, over the densities of the path.
    pub(super) throughput: Vec3<R>,
    pub(super) color: Vec3<R>,
    /// The same light by its groups.
    pub(super) groups: GroupedLight<R>,
    /// Fraction of the background straight behind that reaches the camera.
    pub(super) background_weight: R,
    pub(super) evaluations: R,
    pub(super) bounce: R,
    /// Density of the ray's direction.
    pub(super) density: RayDensity<R>,
    /// Where the ray comes from.
    pub(super) from: Vertex<R>,
    /// Ray toward a light, from the same vertex.
    pub(super) shadow: ShadowRay<R>,
    pub(super) is_active: MaskValue<R>,
}

bundle!(LightPath {
    ray,
    epsilon,
    t,
    throughput,
    color,
    groups,
    background_weight,
    evaluations,
    bounce,
    density,
    from,
    shadow,
    is_active
});

/// Number of segments of a path: its last surface is lit, and its last ray finds lights, emitting surfaces and the sky.
pub(super) fn segments(max_bounces: u32) -> u32 {
    max_bounces + 2
}

impl<R: Real> LightPath<R> {
    /// Adds light of the group in this place to what the path has found.
    fn found(&mut self, light: Vec3<R>, place: usize) {
        self.color = self.color + light;
        self.groups = self.groups.with(light, place);
    }

    /// Adds light to what the path has found, unless a shadow ray has to be traced first.
    pub(super) fn lit(self, light: Vec3<R>, shadow: ShadowRay<R>) -> Self {
        let waits = shadow.is_traced.0;
        let color = Vec3::select(waits, self.color, self.color + light);
        let groups = GroupedLight::select(waits, self.groups, self.groups.with_chosen(light, shadow.group));
        Self { color, groups, shadow: ShadowRay { color: light, ..shadow }, ..self }
    }

    /// Adds this fraction of the shadow ray's light.
    pub(super) fn shadow_ray_traced(self, visible: R, evaluations: R) -> Self {
        let light = self.shadow.color * visible;
        Self {
            color: self.color + light,
            groups: self.groups.with_chosen(light, self.shadow.group),
            evaluations: self.evaluations + evaluations,
            shadow: ShadowRay { is_traced: MaskValue(visible.below(-1.0)), ..self.shadow },
            ..self
        }
    }

    /// Ends paths of little throughput at random: whether the path goes on after its vertex, and its throughput then.
    pub(super) fn after_roulette(&self, throughput: Vec3<R>, sampler: &Sampler<R>) -> (R::Mask, Vec3<R>) {
        let one = self.bounce.constant(1.0);
        let brightest = throughput.max_element();
        let survival = (brightest * SURVIVAL_PER_THROUGHPUT).at_least(MIN_SURVIVAL).at_most(1.0);
        let survival = R::select(self.bounce.below(FIRST_ROULETTE - 0.5), one, survival);
        let goes_on = sampler.get_2d(OF_ROULETTE).0.lt(survival) & brightest.above(0.0);
        (goes_on, throughput * (one / survival))
    }
}

impl Integrator<'_> {
    /// Radiance along a ray from the camera.
    pub(super) fn light_path<R: Real>(&self, ray: &Ray<R>, max_bounces: u32, sampler: &Sampler<R>) -> Radiance<R> {
        let start = self.start_path(*ray);
        let follow = |all: &Self, limit: u32, path| {
            R::repeat(limit, path, |path| {
                let next = all.follow_segment(path, max_bounces, sampler);
                (next.is_active.0, next)
            })
        };
        let end = match &self.of_reflections {
            None => follow(self, segments(max_bounces), start),
            Some(onward) => {
                let first = self.follow_segment(start, max_bounces, sampler);
                R::when(first.is_active.0, first, || follow(onward, segments(max_bounces) - 1, first))
            }
        };
        self.radiance_of(&end)
    }

    /// A path that begins with a ray from the camera.
    pub(super) fn start_path<R: Real>(&self, ray: Ray<R>) -> LightPath<R> {
        let (zero, one) = (ray.direction.x.constant(0.0), ray.direction.x.constant(1.0));
        LightPath {
            ray,
            epsilon: zero.uniform(self.tolerance.floor),
            t: zero,
            throughput: vec3(one, one, one),
            color: vec3(zero, zero, zero),
            groups: self.no_grouped_light(zero),
            background_weight: one,
            evaluations: zero,
            bounce: zero,
            density: RayDensity::unrivaled(zero),
            from: Vertex { position: ray.origin, strength: zero },
            shadow: self.no_shadow_ray(zero),
            is_active: MaskValue(zero.below(1.0)),
        }
    }

    /// Radiance along a path that has ended.
    pub(super) fn radiance_of<R: Real>(&self, path: &LightPath<R>) -> Radiance<R> {
        let alpha = self.background(path.ray.direction).1;
        let alpha = path.background_weight.mul_add(alpha - 1.0, alpha.constant(1.0));
        let (color, evaluations) = (path.color, path.evaluations);
        Radiance { color, alpha, groups: path.groups, levels: self.leveled(color), evaluations }
    }

    /// Follows a path to the next surface or light, and samples the bounce there.
    fn follow_segment<R: Real>(&self, path: LightPath<R>, max_bounces: u32, sampler: &Sampler<R>) -> LightPath<R> {
        let sampler = sampler.after(path.bounce);
        let marched = self.march_from(&path.ray, path.epsilon);
        let path = LightPath { evaluations: path.evaluations + marched.evaluations, ..path };
        let next = self.after_march(path, &marched, max_bounces, &sampler);
        R::when(next.shadow.is_traced.0, next, || {
            let (visible, evaluations) =
                self.light_visibility(next.from.position, next.epsilon, &next.shadow, &sampler);
            next.shadow_ray_traced(visible, evaluations)
        })
    }

    /// Weight of light that a path's ray meets, for the density with which next-event estimation would have found it.
    fn weight<R: Real>(&self, path: &LightPath<R>, rival: R) -> R {
        let weight = path.density.weight(rival);
        if !self.has_straight_shadows() {
            return weight;
        }
        R::select(path.density.is_found_straight(rival), rival.constant(0.0), weight)
    }

    /// Samples the bounce where a path's ray has met something.
    pub(super) fn after_march<R: Real>(
        &self,
        path: LightPath<R>,
        marched: &MarchResult<R>,
        max_bounces: u32,
        sampler: &Sampler<R>,
    ) -> LightPath<R> {
        let zero = path.epsilon.constant(0.0);
        let farthest = zero.uniform(self.scene.march.max_distance.get());
        let surface = R::select(marched.hit.0, marched.t, farthest);
        let MetLight { distance, radiance, density, group } = self.met_light(&path.ray, &path.from);
        let meets_light = distance.lt(surface);
        let length = distance.min(surface);
        let mut path = path;
        let collision = self.media.as_ref().map(|media| (media, self.free_flight(media, &path.ray, length, sampler)));
        let length = collision.map_or(length, |(_, collision)| collision.min(length));
        if let Some(fog) = &self.scene.fog {
            let clear = fog.transmittance(&path.ray, length);
            let veil = self.fog_color(fog, path.ray.direction) * (zero.constant(1.0) - clear);
            path.found(path.throughput.mul_elementwise(veil), self.group(LightGroups::rest));
            path.throughput = path.throughput * clear;
            path.background_weight = path.background_weight * clear;
        }
        let rival = self.density_of_sky(path.ray.direction, &path.from);
        let sky = self.radiance_of_sky(path.ray.direction, path.background_weight) * self.weight(&path, rival);
        let behind = Vec3::select(meets_light, radiance * self.weight(&path, density), sky);
        let behind = path.throughput.mul_elementwise(behind);
        let of_sky = self.group_number(zero, |groups| groups.sky);
        let group = group.zip(of_sky).map(|(met, sky)| R::select(meets_light, met, sky));
        let ended = LightPath {
            color: path.color + behind,
            groups: path.groups.with_chosen(behind, group),
            background_weight: R::select(meets_light, zero, path.background_weight),
            is_active: MaskValue(zero.above(0.0)),
            ..path
        };
        let collides = collision.map_or(zero.above(0.0), |(_, t)| t.below(NEVER));
        let next = R::when(marched.hit.0 & !meets_light & !collides, ended, || {
            self.bounce(path, marched, max_bounces, sampler)
        });
        match collision {
            None => next,
            Some((media, t)) => R::when(collides, next, || self.scatter_in_media(path, media, t, max_bounces, sampler)),
        }
    }

    /// Tolerance at the start of a ray from a hit. Roots of smooth surfaces are exact, and the ray starts as near to them
    /// as rounding and speed allow, so that light from nearby does not shift.
    pub(super) fn start_tolerance<R: Real>(&self, hit: &Hit<R>) -> R {
        let Tolerance { slope, floor } = self.tolerance;
        let t = hit.t;
        if !self.fine.is_empty() {
            return t.mul_add(t.uniform(slope), t.uniform(floor));
        }
        let size = hit.position.map(Real::abs).max_element();
        let near = size.mul_add(t.constant(1e-6), t.uniform(floor));
        t.mul_add(t.uniform((slope / 32.0).max(1e-6)), near)
    }

    /// Radiance that a ray meets behind all surfaces: of the background straight behind, else of the light of the sky.
    fn radiance_of_sky<R: Real>(&self, direction: Vec3<R>, background_weight: R) -> Vec3<R> {
        let sky = self.scene.light_of_sky(direction);
        Vec3::select(background_weight.above(0.0), self.scene.background.radiance(direction), sky)
    }

    /// Lights the surface that a path has met, and samples where the path goes on.
    fn bounce<R: Real>(
        &self,
        path: LightPath<R>,
        marched: &MarchResult<R>,
        max_bounces: u32,
        sampler: &Sampler<R>,
    ) -> LightPath<R> {
        let zero = path.epsilon.constant(0.0);
        let met = self.hit(&path.ray, marched);
        let hit = Hit { t: met.t + path.t, ..met };
        let object = self.object_at(&hit);
        let bsdf = self.bsdf(&hit, &path.ray, object);
        let rival = self.density_of_object(object, &path.from);
        let mut path = path;
        let emitted = path.throughput.mul_elementwise(bsdf.emission) * self.weight(&path, rival);
        path.color = path.color + emitted;
        path.groups = path.groups.with_chosen(emitted, self.group_of_object(object));
        path.evaluations = path.evaluations + (super::lighting::NORMAL_EVALUATIONS + self.detail_evaluations());
        path.evaluations = path.evaluations + self.object_evaluations();
        let through = self.caught_shadow(&mut path, &hit, sampler);
        let ended = LightPath { background_weight: through, is_active: MaskValue(zero.above(0.0)), ..path };
        let is_last = path.bounce.above(max_bounces as f32 + 0.5);
        R::when(!is_last, ended, || {
            let lobes = self.materials.lobes;
            let seen = Geometry { normal: hit.normal, to_viewer: -path.ray.direction, is_inside: hit.is_inside };
            let near = self.start_tolerance(&met);
            // Where rays start that go on on this side of the surface: lights are sampled from there as well.
            let here = self.vertex(hit.normal.mul_add(near * 4.0, hit.position));
            let NextEvent { direction, arriving, density, shadow } = self.next_event(Some(hit.normal), &here, sampler);
            let lit = bsdf.evaluate(lobes, seen, direction);
            let weight = R::select(density.above(0.0), density / (density + lit.density).at_least(1e-30), zero + 1.0);
            let light = path.throughput.mul_elementwise(lit.value.mul_elementwise(arriving) * weight);

            let onward = bsdf.sample(lobes, &seen, sampler.get_2d(OF_DIRECTION), sampler.get_2d(OF_LOBE).0);
            let is_transmitted = onward.is_transmitted.0;
            let beyond = hit.normal.mul_add(near * -4.0, hit.position);
            let ray = Ray { origin: Vec3::select(is_transmitted, beyond, here.position), direction: onward.direction };
            let throughput = path.throughput.mul_elementwise(onward.weight);
            // Straight transmission leaves the background visible.
            let straight = is_transmitted & (bsdf.ior - 1.0).abs().below(1e-4);
            let transmitted = if self.has_straight_shadows() {
                path.density.transmitted_straight()
            } else {
                RayDensity::unrivaled(zero)
            };
            let see_through = R::select(straight, path.background_weight * onward.weight.mean(), zero);
            let (goes_on, throughput) = path.after_roulette(throughput, sampler);
            let next = LightPath {
                ray,
                epsilon: near,
                t: hit.t,
                throughput,
                color: path.color,
                groups: path.groups,
                background_weight: see_through + through,
                evaluations: path.evaluations,
                bounce: path.bounce + 1.0,
                density: RayDensity::select(is_transmitted, transmitted, RayDensity::new(onward.density)),
                from: here,
                shadow: path.shadow,
                is_active: MaskValue(goes_on),
            };
            next.lit(light, shadow)
        })
    }

    /// Adds what is seen of the background through a shadow catcher; returns the weight of the background then.
    fn caught_shadow<R: Real>(&self, path: &mut LightPath<R>, hit: &Hit<R>, sampler: &Sampler<R>) -> R {
        let zero = path.epsilon.constant(0.0);
        if !self.materials.catches_shadows {
            return zero;
        }
        let (light, evaluations) = self.incident_light(hit, sampler);
        path.evaluations = path.evaluations + evaluations + self.shade_evaluations();
        self.shadow_transparency(hit, &path.ray, &light).map_or(zero, |clear| {
            let behind = self.radiance_of_sky(path.ray.direction, path.background_weight);
            path.found(path.throughput.mul_elementwise(behind) * clear, self.group(|groups| groups.sky));
            path.background_weight * clear
        })
    }
}
