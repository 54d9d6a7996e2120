//! The scattering of a surface as path tracing needs it: values, densities and samples of one model for all materials.
//!
//! Values are the BSDF's, times π and the cosine, because lights leave π out. Densities are per steradian.

use std::f32::consts::PI;

use super::microfacet::{
    ggx_distribution, orthonormal_basis, sample_visible_normal, schlick_weight, smith_g2_over_g1, smith_visibility,
    visible_normal_density,
};
use crate::real::{FunctionKey, MaskValue, Real, Vec3, bundle, vec3};

/// F0 of a clear coat, whose index of refraction is 1.5.
pub(super) const CLEARCOAT_F0: f32 = 0.04;
/// Minimum cosine to the viewer: less is due to rounding.
const MIN_VIEWER_COSINE: f32 = 1e-3;

/// Scattering and emission of a surface at a point.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf<R> {
    /// Emitted radiance toward the viewer.
    pub emission: Vec3<R>,
    /// Reflectance of the diffuse term, without the terms that depend on directions.
    pub diffuse: Vec3<R>,
    /// Share of the diffuse term that is under a boundary, which reflects some of the light: 1 for a dielectric, 0 for a
    /// surface after Lambert.
    pub border: R,
    /// Fresnel's reflectance at normal incidence, by channel.
    pub f0: Vec3<R>,
    /// α of the GGX distribution.
    pub alpha: R,
    /// Fraction of the surface under a clear coat.
    pub coat: R,
    /// The clear coat's α.
    pub coat_alpha: R,
    /// Fraction of the light that is not reflected but transmitted, by channel.
    pub transmission: Vec3<R>,
    /// Index of refraction inside over that outside.
    pub ior: R,
}

bundle!(Bsdf { emission, diffuse, border, f0, alpha, coat, coat_alpha, transmission, ior });

/// The terms of the model that some material of a scene has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lobes {
    /// Reflection by microfacets.
    pub reflection: bool,
    /// A clear coat.
    pub coat: bool,
    /// Transmission.
    pub transmission: bool,
}

/// Directions at a point of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Geometry<R: Real> {
    /// The normal, on the viewer's side.
    pub normal: Vec3<R>,
    /// Toward the viewer.
    pub to_viewer: Vec3<R>,
    /// Whether the surface is seen from inside its shape.
    pub is_inside: MaskValue<R>,
}

bundle!(Geometry { normal, to_viewer, is_inside });

/// Light scattered from a direction to the viewer.
#[derive(Clone, Copy, Debug)]
pub struct Scattered<R> {
    /// The BSDF times π and the cosine.
    pub value: Vec3<R>,
    /// Density with which [`Bsdf::sample`] samples the direction.
    pub density: R,
}

bundle!(Scattered { value, density });

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub struct ScatteredRay<R: Real> {
    /// The direction, of length 1.
    pub direction: Vec3<R>,
    /// The BSDF times the cosine, over the density.
    pub weight: Vec3<R>,
    /// Density of the direction.
    pub density: R,
    /// Whether the direction leads to the other side.
    pub is_transmitted: MaskValue<R>,
}

bundle!(ScatteredRay { direction, weight, density, is_transmitted });

/// Probabilities of the terms, which add up to 1.
struct Shares<R> {
    diffuse: R,
    coat: R,
    /// Reflection or transmission at the boundary.
    boundary: R,
}

/// Scattering of light by a microfacet.
struct Facet<R> {
    /// Reflectance.
    reflected: Vec3<R>,
    /// Transmittance; black without transmission.
    passed: Vec3<R>,
    /// Probability that a sample is reflected.
    likely: R,
    /// Relative index of refraction, and cosine on the other side.
    ratio: R,
    cosine_beyond: R,
}

impl Lobes {
    /// Terms that either has.
    pub fn or(self, other: Self) -> Self {
        Self {
            reflection: self.reflection || other.reflection,
            coat: self.coat || other.coat,
            transmission: self.transmission || other.transmission,
        }
    }
}

impl<R: Real> Geometry<R> {
    /// Cosine between normal and viewer.
    fn viewer_cosine(&self) -> R {
        self.normal.dot(self.to_viewer).at_least(MIN_VIEWER_COSINE)
    }
}

impl<R: Real> Bsdf<R> {
    /// A surface that neither emits nor scatters.
    pub fn black(like: R) -> Self {
        let (zero, one) = (like.constant(0.0), like.constant(1.0));
        let black = vec3(zero, zero, zero);
        Self {
            emission: black,
            diffuse: black,
            border: zero,
            f0: black,
            alpha: one,
            coat: zero,
            coat_alpha: one,
            transmission: black,
            ior: one,
        }
    }

    /// The sum of this and a share of another one.
    pub fn plus(self, other: Self, share: R) -> Self {
        // Without `..`, so that no field is left out.
        let Self { emission, diffuse, border, f0, alpha, coat, coat_alpha, transmission, ior } = other;
        Self {
            emission: emission.mul_add(share, self.emission),
            diffuse: diffuse.mul_add(share, self.diffuse),
            border: border.mul_add(share, self.border),
            f0: f0.mul_add(share, self.f0),
            alpha: alpha.mul_add(share, self.alpha),
            coat: coat.mul_add(share, self.coat),
            coat_alpha: coat_alpha.mul_add(share, self.coat_alpha),
            transmission: transmission.mul_add(share, self.transmission),
            ior: ior.mul_add(share, self.ior),
        }
    }

    /// The start of a sum of shares.
    pub fn nothing(like: R) -> Self {
        let zero = like.constant(0.0);
        Self { alpha: zero, coat_alpha: zero, ior: zero, ..Self::black(like) }
    }

    /// Light scattered to the viewer from a direction on the viewer's side. One function for all.
    pub fn evaluate(self, lobes: Lobes, seen: Geometry<R>, direction: Vec3<R>) -> Scattered<R> {
        self.ior.call(FunctionKey::new("scattering"), (self, (seen, direction)), |(bsdf, (seen, direction))| {
            bsdf.scattered(lobes, &seen, direction)
        })
    }

    fn scattered(&self, lobes: Lobes, seen: &Geometry<R>, direction: Vec3<R>) -> Scattered<R> {
        let zero = self.ior.constant(0.0);
        let toward = seen.normal.dot(direction);
        let black = Scattered { value: vec3(zero, zero, zero), density: zero };
        R::when(toward.above(0.0), black, || {
            let facing = seen.viewer_cosine();
            let shares = self.shares(lobes, facing, seen.is_inside);
            let (rise_in, rise_out) = (schlick_weight(toward), schlick_weight(facing));
            let uncoated = |rise: R| rise.constant(1.0) - self.coat_reflectance(rise);
            let body =
                (rise_in.constant(1.0) - self.border * rise_in) * (rise_out.constant(1.0) - self.border * rise_out);
            let mut value = self.diffuse * body;
            let mut density = shares.diffuse * toward * (1.0 / PI);
            if lobes.reflection || lobes.coat {
                let half = (direction + seen.to_viewer).normalize();
                let cosine = seen.normal.dot(half).at_least(0.0);
                let sine_squared = seen.normal.cross(half).length_squared();
                let bent = seen.to_viewer.dot(half).at_least(0.0);
                if lobes.reflection {
                    let facet = self.facet(lobes, bent, seen.is_inside);
                    let normals = ggx_distribution(self.alpha, cosine, sine_squared);
                    let shine = normals * smith_visibility(self.alpha, toward, facing);
                    value = facet.reflected.mul_add(shine, value);
                    let sampled = normals * visible_normal_density(self.alpha, facing) * facet.likely;
                    density = shares.boundary.mul_add(sampled, density);
                }
                if lobes.coat {
                    let normals = ggx_distribution(self.coat_alpha, cosine, sine_squared);
                    let shine = normals * smith_visibility(self.coat_alpha, toward, facing);
                    let mirrored = self.coat_reflectance(schlick_weight(bent)) * shine;
                    value = (value * (uncoated(rise_in) * uncoated(rise_out))).map(|c| c + mirrored);
                    let sampled = normals * visible_normal_density(self.coat_alpha, facing);
                    density = shares.coat.mul_add(sampled, density);
                }
            }
            Scattered { value: value * toward, density }
        })
    }

    /// Samples the direction from which light comes, by two pairs of numbers from 0 to 1: for the direction and, of the
    /// other pair, the first for the term. Reflected directions are on the viewer's side, or have a weight of 0.
    pub fn sample(&self, lobes: Lobes, seen: &Geometry<R>, (u, v): (R, R), choice: R) -> ScatteredRay<R> {
        let (zero, one) = (u.constant(0.0), u.constant(1.0));
        let (right, up) = orthonormal_basis(seen.normal);
        let local = |w: Vec3<R>| vec3(w.dot(right), w.dot(up), w.dot(seen.normal));
        let world = |w: Vec3<R>| seen.normal.mul_add(w.z, up.mul_add(w.y, right * w.x)).normalize();
        let matte = sample_cosine(u, v);
        if !(lobes.reflection || lobes.coat) {
            let direction = world(matte);
            let Scattered { value, density } = self.evaluate(lobes, *seen, direction);
            let weight = value * (one / (density * PI).at_least(1e-12));
            return ScatteredRay { direction, weight, density, is_transmitted: MaskValue(zero.above(0.0)) };
        }
        let facing = seen.viewer_cosine();
        let shares = self.shares(lobes, facing, seen.is_inside);
        let viewer = local(seen.to_viewer);
        let viewer = vec3(viewer.x, viewer.y, viewer.z.at_least(MIN_VIEWER_COSINE));
        let is_matte = choice.lt(shares.diffuse);
        let before = shares.diffuse + shares.coat;
        let alpha = if lobes.coat { R::select(choice.lt(before), self.coat_alpha, self.alpha) } else { self.alpha };
        let normal = sample_visible_normal(viewer, alpha, u, v);
        let cosine = normal.dot(viewer).at_least(1e-4);
        let mirrored = normal.mul_add(cosine + cosine, -viewer);
        let reflected = world(Vec3::select(is_matte, matte, mirrored));
        let Scattered { value, density } = self.evaluate(lobes, *seen, reflected);
        let weight = value * (one / (density * PI).at_least(1e-12));
        let back = ScatteredRay { direction: reflected, weight, density, is_transmitted: MaskValue(zero.above(0.0)) };
        if !lobes.transmission {
            return back;
        }
        let facet = self.facet(lobes, cosine, seen.is_inside);
        let rest = (choice - before) / shares.boundary.at_least(1e-6);
        let passes = !choice.lt(before) & !rest.lt(facet.likely) & facet.passed.max_element().above(0.0);
        let refracted = normal.mul_add(facet.ratio.mul_add(cosine, -facet.cosine_beyond), viewer * -facet.ratio);
        let masked = smith_g2_over_g1(self.alpha, (-refracted.z).at_least(1e-4), viewer.z);
        let uncoated = one - self.coat_reflectance(schlick_weight(facing));
        let share = shares.boundary * (one - facet.likely);
        let through = facet.passed * (masked * uncoated.square() / share.at_least(1e-6));
        ScatteredRay {
            direction: Vec3::select(passes, world(refracted), back.direction),
            weight: Vec3::select(passes, through, back.weight),
            density: back.density,
            is_transmitted: MaskValue(passes),
        }
    }

    /// Fraction of the light that goes through a surface, as if it were not bent, by channel.
    pub fn straight_transmittance(&self, lobes: Lobes, seen: &Geometry<R>) -> Vec3<R> {
        let facing = seen.viewer_cosine();
        let uncoated = facing.constant(1.0) - self.coat_reflectance(schlick_weight(facing));
        self.facet(lobes, facing, seen.is_inside).passed * uncoated.square()
    }

    /// Reflectance of the clear coat, for a [`schlick_weight`].
    fn coat_reflectance(&self, rise: R) -> R {
        self.coat * rise.mul_add(rise.constant(1.0 - CLEARCOAT_F0), rise.constant(CLEARCOAT_F0))
    }

    /// Probabilities of the terms: about the light that each scatters.
    fn shares(&self, lobes: Lobes, facing: R, is_inside: MaskValue<R>) -> Shares<R> {
        let (zero, one) = (facing.constant(0.0), facing.constant(1.0));
        if !(lobes.reflection || lobes.coat) {
            return Shares { diffuse: one, coat: zero, boundary: zero };
        }
        let rise = schlick_weight(facing);
        let coat = if lobes.coat { self.coat_reflectance(rise) } else { zero };
        let uncoated = (one - coat).square();
        let facet = self.facet(lobes, facing, is_inside);
        let boundary = (facet.reflected.mean() + facet.passed.mean()) * uncoated;
        let diffuse = self.diffuse.mean() * (one - self.border * rise) * uncoated;
        let per_sum = one / (coat + boundary + diffuse).at_least(1e-6);
        Shares { diffuse: diffuse * per_sum, coat: coat * per_sum, boundary: boundary * per_sum }
    }

    /// Reflection and transmission at a microfacet, by the cosine between its normal and the viewer.
    fn facet(&self, lobes: Lobes, cosine: R, is_inside: MaskValue<R>) -> Facet<R> {
        let (zero, one) = (cosine.constant(0.0), cosine.constant(1.0));
        if !lobes.transmission {
            let reflected = fresnel(self.f0, cosine);
            return Facet { reflected, passed: vec3(zero, zero, zero), likely: one, ratio: one, cosine_beyond: cosine };
        }
        let ratio = R::select(is_inside.0, self.ior, one / self.ior.at_least(1e-3));
        let beyond = ratio.square() * (one - cosine.square()).at_least(0.0);
        let cosine_beyond = (one - beyond).sqrt();
        let steep = R::select(self.ior.above(1.0) & is_inside.0, cosine_beyond, cosine);
        let is_total = beyond.above(1.0) & self.transmission.max_element().above(0.0);
        let reflected = Vec3::select(is_total, vec3(one, one, one), fresnel(self.f0, steep));
        let passed = reflected.map(|c| one - c).mul_elementwise(self.transmission);
        let (of_mirror, of_passage) = (reflected.mean(), passed.mean());
        let likely = of_mirror / (of_mirror + of_passage).at_least(1e-6);
        Facet { reflected, passed, likely: R::select(of_passage.above(0.0), likely, one), ratio, cosine_beyond }
    }
}

/// Direction around +z, with a density of the cosine over π: a point of the unit disc, projected onto the hemisphere.
fn sample_cosine<R: Real>(u: R, v: R) -> Vec3<R> {
    let (sine, cosine) = v.sin_cos_turns();
    let away = u.sqrt();
    vec3(away * cosine, away * sine, (u.constant(1.0) - u).sqrt())
}

/// Schlick's approximation of Fresnel's equations; a material that reflects almost nothing does so at every angle.
///
/// Sébastien Lagarde, "Memo on Fresnel equations", 2013:
/// <https://seblagarde.wordpress.com/2013/04/29/memo-on-fresnel-equations/>.
pub fn fresnel<R: Real>(head_on: Vec3<R>, cosine: R) -> Vec3<R> {
    let most = (head_on.max_element() * 50.0).at_most(1.0);
    let rise = schlick_weight(cosine);
    head_on.map(|channel| (most - channel).at_least(0.0).mul_add(rise, channel))
}
