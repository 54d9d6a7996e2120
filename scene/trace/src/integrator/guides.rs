//! Guides of the denoiser: the surface that a pixel shows, in mirrors too.

use super::{Hit, Integrator};
use crate::materials::bsdf::Bsdf;
use crate::ray::Ray;
use crate::real::{Bundle, MaskValue, Real, Vec3, bundle, vec3};
use crate::sampling::{PixelSampler, Sampler};

/// Maximum number of samples of a pixel that guides are averaged over.
const MAX_SAMPLES: u32 = 16;
/// Maximum number of mirrors that a ray is followed through.
const MAX_MIRRORS: u32 = 3;
/// The GGX distribution's α below which a surface is a mirror.
const MIRROR_ALPHA: f32 = 0.02;
/// Reflectance and transmittance below which a term does not count.
const NO_TERM: f32 = 1e-3;

/// Guides of a pixel: means over its first samples.
#[derive(Clone, Copy, Debug)]
pub struct Guides<R> {
    /// Albedo, times the color of the mirrors on the way; 0 where nothing is hit.
    pub albedo: Vec3<R>,
    /// Normal, toward the viewer's side; 0 where nothing is hit.
    pub normal: Vec3<R>,
    /// 1 over the length of the way; 0 where nothing is hit.
    pub inverse_depth: R,
}

bundle!(Guides { albedo, normal, inverse_depth });

/// A ray on its way to the surface that a pixel shows.
#[derive(Clone, Copy)]
struct Following<R: Real> {
    ray: Ray<R>,
    epsilon: R,
    t: R,
    throughput: Vec3<R>,
    guides: Guides<R>,
    is_active: MaskValue<R>,
}

bundle!(Following { ray, epsilon, t, throughput, guides, is_active });

impl<R: Real> Guides<R> {
    fn nothing(like: R) -> Self {
        let zero = like.constant(0.0);
        let black = vec3(zero, zero, zero);
        Self { albedo: black, normal: black, inverse_depth: zero }
    }
}

impl Integrator<'_> {
    /// Guides of the pixel in column `x` and row `y`.
    pub fn guides<R: Real>(&self, x: R, y: R) -> Guides<R> {
        let (sum, share) = self.fold_first_samples([x, y], MAX_SAMPLES, Guides::nothing(x), |sum, pixel, sampler| {
            let one = self.guides_of_sample(pixel, sampler);
            Guides {
                albedo: sum.albedo + one.albedo,
                normal: sum.normal + one.normal,
                inverse_depth: sum.inverse_depth + one.inverse_depth,
            }
        });
        Guides { albedo: sum.albedo * share, normal: sum.normal * share, inverse_depth: sum.inverse_depth * share }
    }

    /// Adds the first samples of a pixel to a state, at most `most` of them; also returns one over their number.
    pub(super) fn fold_first_samples<R: Real, T: Bundle<R>>(
        &self,
        [x, y]: [R; 2],
        most: u32,
        start: T,
        add: impl Fn(T, &PixelSampler<R>, &Sampler<R>) -> T,
    ) -> (T, R) {
        let [x, y] = self.in_whole_picture(x, y);
        let pixel = PixelSampler::new(x, y, self.samples, self.frame_key);
        let count = self.samples.min(most) as f32;
        let (end, share) = (x.uniform(count), x.uniform(1.0 / count));
        let (_, sum) = R::repeat(most, (x.constant(0.0), start), |(sample, sum)| {
            let (sum, next) = (add(sum, &pixel, &pixel.sample(sample)), sample + 1.0);
            (next.lt(end), (next, sum))
        });
        (sum, share)
    }

    fn guides_of_sample<R: Real>(&self, pixel: &PixelSampler<R>, sampler: &Sampler<R>) -> Guides<R> {
        let ray = self.ray_of_sample(pixel, sampler);
        let (zero, one) = (ray.direction.x.constant(0.0), ray.direction.x.constant(1.0));
        let start = Following {
            ray,
            epsilon: zero.uniform(self.tolerance.floor),
            t: zero,
            throughput: vec3(one, one, one),
            guides: Guides::nothing(zero),
            is_active: MaskValue(zero.below(1.0)),
        };
        let mirrors = if self.sends_on { MAX_MIRRORS } else { 0 };
        let end = R::repeat(mirrors + 1, start, |following| {
            let next = self.follow_to_surface(following);
            (next.is_active.0, next)
        });
        end.guides
    }

    /// Follows a ray to the next surface, and on from it if it is a mirror.
    fn follow_to_surface<R: Real>(&self, following: Following<R>) -> Following<R> {
        let zero = following.epsilon.constant(0.0);
        let marched = self.march_from(&following.ray, following.epsilon);
        let ended = Following { is_active: MaskValue(zero.above(0.0)), ..following };
        R::when(marched.hit.0, ended, || {
            let met = self.hit(&following.ray, &marched);
            let t = following.t + met.t;
            let hit = Hit { t, ..met };
            let bsdf = self.bsdf(&hit, &following.ray, self.object_at(&hit));
            let throughput = following.throughput;
            let guides = Guides {
                albedo: throughput.mul_elementwise(albedo_of(&bsdf)),
                normal: hit.normal,
                inverse_depth: t.constant(1.0) / t.at_least(1e-6),
            };
            if !self.sends_on {
                return Following { guides, ..ended };
            }
            let is_mirror = bsdf.alpha.below(MIRROR_ALPHA)
                & bsdf.diffuse.max_element().below(NO_TERM)
                & bsdf.transmission.max_element().below(NO_TERM)
                & bsdf.f0.max_element().above(NO_TERM);
            let near = self.start_tolerance(&met);
            let direction = following.ray.direction;
            let reflected = hit.normal.mul_add(direction.dot(hit.normal) * -2.0, direction);
            let origin = hit.normal.mul_add(near * 4.0, hit.position);
            Following {
                ray: Ray { origin, direction: reflected },
                epsilon: near,
                t,
                throughput: Vec3::select(is_mirror, throughput.mul_elementwise(bsdf.f0), throughput),
                guides,
                is_active: MaskValue(is_mirror),
            }
        })
    }
}

/// The color of a surface under white light from all sides, roughly; white for glass.
fn albedo_of<R: Real>(bsdf: &Bsdf<R>) -> Vec3<R> {
    let color = bsdf.diffuse + bsdf.f0 + bsdf.transmission;
    color.map(|channel| channel.at_most(1.0))
}
