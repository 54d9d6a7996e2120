//! Direct light: follows a ray through reflections and transmissions at surfaces, each lit by all lights.

use super::brightness_levels::LeveledLight;
use super::grouped_light::GroupedLight;
use super::lighting::{OF_DIRECTION, OF_LOBE};
use super::media::MediumSegment;
use super::ray_kinds::RayFunction;
use super::{Hit, Integrator, Radiance};
use crate::fog::Fog;
use crate::march::MarchResult;
use crate::materials::SpecularBsdf;
use crate::materials::bsdf::fresnel;
use crate::materials::microfacet::{alpha_from_roughness, orthonormal_basis, sample_visible_normal, smith_g2_over_g1};
use crate::ray::Ray;
use crate::real::{MaskValue, Real, Vec3, bundle, vec3};
use crate::sampling::Sampler;

/// State of a path after some bounces.
#[derive(Clone, Copy)]
struct PathState<R: Real> {
    ray: Ray<R>,
    /// Tolerance at the start of the current ray.
    epsilon: R,
    /// Distance from the camera along the path.
    t: R,
    /// Throughput: fraction of the light at the path's end that reaches the camera.
    throughput: Vec3<R>,
    color: Vec3<R>,
    /// Fraction of the background straight behind that reaches the camera.
    background_weight: R,
    evaluations: R,
    bounce: R,
    is_active: MaskValue<R>,
}

bundle!(PathState { ray, epsilon, t, throughput, color, background_weight, evaluations, bounce, is_active });

/// Ray that continues from a surface, and its weight.
#[derive(Clone, Copy)]
struct BsdfSample<R: Real> {
    direction: Vec3<R>,
    weight: Vec3<R>,
    /// Whether the ray continues on the other side of the surface.
    is_transmitted: MaskValue<R>,
}

/// Maximum radiance found by rays after the first bounce: a sharp highlight that few rays find would leave specks.
const MAX_INDIRECT_RADIANCE: f32 = 6.0;
/// Throughput below which a path ends, because its contribution is not visible.
const MIN_THROUGHPUT: f32 = 1.0 / 512.0;

impl Integrator<'_> {
    /// Radiance along a ray from the camera.
    pub(super) fn path<R: Real>(&self, ray: &Ray<R>, sampler: &Sampler<R>) -> Radiance<R> {
        let (zero, one) = (ray.direction.x.constant(0.0), ray.direction.x.constant(1.0));
        let start = PathState {
            ray: *ray,
            epsilon: zero.uniform(self.tolerance.floor),
            t: zero,
            throughput: vec3(one, one, one),
            color: vec3(zero, zero, zero),
            background_weight: one,
            evaluations: zero,
            bounce: zero,
            is_active: MaskValue(zero.below(1.0)),
        };
        let max_bounces = self.scene.march.max_bounces;
        let end = match &self.of_reflections {
            None if self.sends_on => self.trace_segments(max_bounces + 1, start, sampler),
            Some(onward) if self.sends_on && max_bounces > 0 => {
                let first = self.trace_segment(start, sampler);
                R::when(first.is_active.0, first, || onward.trace_segments(max_bounces, first, sampler))
            }
            _ => self.trace_segment(start, sampler),
        };
        // After the last bounce, the radiance behind all surfaces is used.
        let rest = end.throughput.mul_elementwise(self.radiance_behind(end.ray.direction, end.background_weight));
        let color = Vec3::select(end.is_active.0, end.color + rest, end.color);
        let alpha = self.background(end.ray.direction).1;
        let alpha = end.background_weight.mul_add(alpha - 1.0, one);
        Radiance {
            color,
            alpha,
            groups: GroupedLight::none(),
            levels: LeveledLight::none(),
            evaluations: end.evaluations,
        }
    }

    /// Traces a path over at most `limit` segments.
    fn trace_segments<R: Real>(&self, limit: u32, path: PathState<R>, sampler: &Sampler<R>) -> PathState<R> {
        R::repeat(limit, path, |path| {
            let next = self.trace_segment(path, sampler);
            (next.is_active.0, next)
        })
    }

    /// Traces a path to its next surface, and samples the bounce there.
    fn trace_segment<R: Real>(&self, path: PathState<R>, sampler: &Sampler<R>) -> PathState<R> {
        let sampler = sampler.after(path.bounce);
        let marched = self.march_from(&path.ray, path.epsilon);
        let mut path = path;
        path.evaluations = path.evaluations + marched.evaluations;
        let farthest = path.epsilon.uniform(self.scene.march.max_distance.get());
        let length = R::select(marched.hit.0, marched.t, farthest);
        // Only rays straight from the camera see the lights: others have their highlights instead.
        let seen = self.seen_light(&path.ray, length);
        let seen = seen.map(|(is_seen, at, light)| (is_seen & path.background_weight.above(0.0), at, light));
        let end = seen.map_or(length, |(is_seen, at, _)| R::select(is_seen, at, length));
        if let Some(crossed) = self.crossed_media(&path.ray, end, &sampler) {
            path.color = path.color + path.throughput.mul_elementwise(crossed.color);
            path.throughput = path.throughput * crossed.transmittance;
            path.background_weight = path.background_weight * crossed.transmittance;
            path.evaluations = path.evaluations + crossed.evaluations;
        }
        let behind = self.radiance_behind(path.ray.direction, path.background_weight);
        let missed = PathState {
            color: path.color + path.throughput.mul_elementwise(behind),
            is_active: MaskValue(path.epsilon.below(0.0)),
            ..path
        };
        let Some((is_seen, _, light)) = seen else {
            return R::when(marched.hit.0, missed, || self.scatter(path, &marched, &sampler));
        };
        let zero = path.epsilon.constant(0.0);
        let color = path.color + path.throughput.mul_elementwise(light);
        let ended = PathState {
            color: Vec3::select(is_seen, color, missed.color),
            background_weight: R::select(is_seen, zero, missed.background_weight),
            ..missed
        };
        R::when(marched.hit.0 & !is_seen, ended, || self.scatter(path, &marched, &sampler))
    }

    /// Clouds, volumes and fog along a part of a ray; `None` if the scene has none.
    pub(super) fn crossed_media<R: Real>(
        &self,
        ray: &Ray<R>,
        length: R,
        sampler: &Sampler<R>,
    ) -> Option<MediumSegment<R>> {
        let crossed = self.media.as_ref().map(|media| self.integrate_media(media, ray, length, sampler));
        let Some(fog) = &self.scene.fog else { return crossed };
        let (zero, one) = (length.constant(0.0), length.constant(1.0));
        let nothing = MediumSegment { color: vec3(zero, zero, zero), transmittance: one, evaluations: zero };
        let MediumSegment { color, transmittance, evaluations } = crossed.unwrap_or(nothing);
        let clear = fog.transmittance(ray, length);
        let veil = self.fog_color(fog, ray.direction) * (transmittance * (one - clear));
        Some(MediumSegment { color: color + veil, transmittance: transmittance * clear, evaluations })
    }

    /// Color of the fog in a direction.
    pub(super) fn fog_color<R: Real>(&self, fog: &Fog, direction: Vec3<R>) -> Vec3<R> {
        if let Some(color) = &fog.color {
            return Vec3::uniform(direction.x, color.get());
        }
        let scene = self.scene;
        let sky = if scene.background.is_transparent() { scene.environment() } else { &scene.background };
        sky.radiance(Fog::direction_of_color(direction))
    }

    /// Shades the surface that a path has hit and continues the path.
    fn scatter<R: Real>(&self, path: PathState<R>, marched: &MarchResult<R>, sampler: &Sampler<R>) -> PathState<R> {
        let zero = path.epsilon.constant(0.0);
        let met = self.hit(&path.ray, marched);
        let hit = Hit { t: met.t + path.t, ..met };
        let (light, evaluations) = self.incident_light(&hit, sampler);
        let of_shadow = if self.materials.catches_shadows { self.shade_evaluations() } else { 0.0 };
        let evaluations = path.evaluations + evaluations + self.surface_evaluations() + of_shadow;
        let clear = self.shadow_transparency(&hit, &path.ray, &light);
        let mut path = path;
        if let Some(clear) = clear {
            let behind = self.radiance_behind(path.ray.direction, path.background_weight);
            path.color = path.color + path.throughput.mul_elementwise(behind) * clear;
        }
        let through = clear.map_or(zero, |clear| path.background_weight * clear);
        if !self.sends_on {
            let color = path.color + path.throughput.mul_elementwise(self.shade(&hit, &path.ray, &light));
            return PathState {
                color,
                evaluations,
                background_weight: through,
                is_active: MaskValue(zero.above(0.0)),
                ..path
            };
        }
        let (seen, finish) = self.shade_with_specular(&hit, &path.ray, &light);
        let seen = Vec3::select(path.bounce.above(0.5), clamp_indirect(seen), seen);
        let color = path.color + path.throughput.mul_elementwise(seen);
        let onward = self.sample_bsdf(&hit, -path.ray.direction, &finish, sampler);
        let near = self.tolerance.at(hit.t);
        let side = R::select(onward.is_transmitted.0, near * -4.0, near * 4.0);
        let ray = Ray { origin: hit.normal.mul_add(side, hit.position), direction: onward.direction };
        let throughput = path.throughput.mul_elementwise(onward.weight);
        // Straight transmission leaves the background visible.
        let straight = onward.is_transmitted.0 & (finish.ior - 1.0).abs().below(1e-4);
        let see_through = R::select(straight, path.background_weight * onward.weight.mean(), zero);
        PathState {
            ray,
            epsilon: near,
            t: hit.t,
            throughput,
            color,
            background_weight: if clear.is_some() { see_through + through } else { see_through },
            evaluations,
            bounce: path.bounce + 1.0,
            is_active: MaskValue(throughput.max_element().above(MIN_THROUGHPUT)),
        }
    }

    /// Samples the ray that continues from a surface: reflected or transmitted, chosen at random.
    ///
    /// Bruce Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007.
    fn sample_bsdf<R: Real>(
        &self,
        hit: &Hit<R>,
        to_viewer: Vec3<R>,
        finish: &SpecularBsdf<R>,
        sampler: &Sampler<R>,
    ) -> BsdfSample<R> {
        let (zero, one) = (hit.t.constant(0.0), hit.t.constant(1.0));
        let frame = ShadingFrame::from_normal(hit.normal);
        let viewer = frame.local(to_viewer);
        let viewer = vec3(viewer.x, viewer.y, viewer.z.at_least(1e-3));
        let alpha = alpha_from_roughness(finish.roughness);
        let (u, v) = sampler.get_2d(OF_DIRECTION);
        let facet = sample_visible_normal(viewer, alpha, u, v);
        let cosine = facet.dot(viewer).at_least(1e-4);
        let mirrored = facet.mul_add(cosine + cosine, -viewer);
        let ratio = R::select(hit.is_inside.0, finish.ior, one / finish.ior.at_least(1e-3));
        let beyond = ratio.square() * (one - cosine.square());
        let cosine_beyond = (one - beyond).sqrt();
        let steep = R::select(finish.ior.above(1.0) & hit.is_inside.0, cosine_beyond, cosine);
        let reflected = fresnel(finish.f0, steep);
        let masked = smith_g2_over_g1(alpha, mirrored.z, viewer.z);
        if !self.lets_through {
            let weight = reflected * R::select(mirrored.z.above(1e-4), masked, zero);
            return BsdfSample {
                direction: frame.world(mirrored).normalize(),
                weight,
                is_transmitted: MaskValue(zero.above(0.0)),
            };
        }
        let total = beyond.above(1.0) & finish.transmission.max_element().above(0.0);
        let reflected = Vec3::select(total, vec3(one, one, one), reflected);
        let passed = vec3(one - reflected.x, one - reflected.y, one - reflected.z).mul_elementwise(finish.transmission);
        let (of_mirror, of_passage) = (reflected.mean(), passed.mean());
        let likely = of_mirror / (of_mirror + of_passage).at_least(1e-6);
        // Rarely chosen directions would be noise.
        let likely = R::select(likely.below(0.01), zero, likely);
        let (choice, _) = sampler.get_2d(OF_LOBE);
        let mirrors = choice.lt(likely) | of_passage.below(1e-6);
        let refracted = facet.mul_add(ratio.mul_add(cosine, -cosine_beyond), viewer * -ratio);
        let through = passed * (one / (one - likely).at_least(1e-3));
        let back = reflected * (R::select(mirrored.z.above(1e-4), masked, zero) / likely.at_least(1e-3));
        let direction = Vec3::select(mirrors, mirrored, refracted);
        BsdfSample {
            direction: frame.world(direction).normalize(),
            weight: Vec3::select(mirrors, back, through),
            is_transmitted: MaskValue(!mirrors),
        }
    }

    /// Marches from a surface, or from the camera. `near` is the tolerance at the start.
    pub(super) fn march_from<R: Real>(&self, ray: &Ray<R>, near: R) -> MarchResult<R> {
        near.call(self.key(RayFunction::MarchOn), (*ray, near), |(ray, near)| {
            self.march_in_bounds(&ray, near.uniform(self.tolerance.slope), near, false)
        })
    }
}

/// Color clamped to [`MAX_INDIRECT_RADIANCE`], with the same hue.
fn clamp_indirect<R: Real>(color: Vec3<R>) -> Vec3<R> {
    let brightest = color.max_element().at_least(MAX_INDIRECT_RADIANCE);
    color * (brightest.constant(MAX_INDIRECT_RADIANCE) / brightest)
}

/// Orthonormal frame around a normal.
#[derive(Clone, Copy)]
struct ShadingFrame<R> {
    right: Vec3<R>,
    up: Vec3<R>,
    normal: Vec3<R>,
}

impl<R: Real> ShadingFrame<R> {
    fn from_normal(normal: Vec3<R>) -> Self {
        let (right, up) = orthonormal_basis(normal);
        Self { right, up, normal }
    }

    fn local(&self, v: Vec3<R>) -> Vec3<R> {
        vec3(v.dot(self.right), v.dot(self.up), v.dot(self.normal))
    }

    fn world(&self, v: Vec3<R>) -> Vec3<R> {
        self.normal.mul_add(v.z, self.up.mul_add(v.y, self.right * v.x))
    }
}
