//! Microfacet model: distribution, shadowing, Fresnel, and their sampling.
//!
//! The distribution is GGX: Bruce Walter et al., "Microfacet models for refraction through rough
//! surfaces", EGSR 2007, <https://www.graphics.cornell.edu/~bjw/microfacetbsdf.pdf>. Masking and
//! shadowing are Smith's, correlated by height: Eric Heitz, "Understanding the masking-shadowing
//! function in microfacet-based BRDFs", JCGT 3(2), 2014, <https://jcgt.org/published/0003/02/03/>.
//! Cosines are of angles to the normal, 0 to 1. In a local frame the normal is +z.

use std::f32::consts::{PI, TAU};

use crate::real::{Real, Vec3, vec3};

/// Minimum α: below it a highlight would be a point of almost infinite brightness.
pub(crate) const MIN_ALPHA: f32 = 0.002;

/// The α of a roughness from 0 to 1: its square, at least `MIN_ALPHA`.
///
/// Brent Burley, "Physically based shading at Disney", 2012,
/// <https://disneyanimation.com/publications/physically-based-shading-at-disney/>.
pub fn alpha_from_roughness<R: Real>(roughness: R) -> R {
    roughness.square().at_least(MIN_ALPHA)
}

/// π times the GGX distribution of normals D, by a half vector's cosine and its squared sine
/// (which, for a small angle, 1 − cosine² would not give).
pub(crate) fn ggx_distribution<R: Real>(alpha: R, cosine: R, sine_squared: R) -> R {
    let scaled = alpha * cosine;
    let width = scaled.square_add(sine_squared).at_least(1e-7);
    (alpha / width).square()
}

/// √(α² + (1 − α²)·cosine²), a term of Smith's functions, for a direction's cosine.
fn smith_root<R: Real>(alpha_squared: R, cosine: R) -> R {
    (cosine.constant(1.0) - alpha_squared).mul_add(cosine.square(), alpha_squared).sqrt()
}

/// Smith's G₂ of light and viewer, over 4·(N·L)·(N·V).
pub(crate) fn smith_visibility<R: Real>(alpha: R, to_light: R, to_viewer: R) -> R {
    let square = alpha.square();
    let (to_light, to_viewer) = (to_light.at_least(MIN_COSINE), to_viewer.at_least(MIN_COSINE));
    to_light.constant(0.5) / to_light.mul_add(smith_root(square, to_viewer), to_viewer * smith_root(square, to_light))
}

/// Density of light reflected by a normal of [`sample_visible_normal`], over [`ggx_distribution`]: G₁(viewer)/(4π·(N·V)).
pub(crate) fn visible_normal_density<R: Real>(alpha: R, to_viewer: R) -> R {
    let to_viewer = to_viewer.at_least(MIN_COSINE);
    to_viewer.constant(0.5 / PI) / (to_viewer + smith_root(alpha.square(), to_viewer))
}

/// Minimum cosine in divisors.
const MIN_COSINE: f32 = 1e-4;

/// Smith's G₂/G₁(viewer): the weight, next to Fresnel's, of light reflected by a visible normal.
pub fn smith_g2_over_g1<R: Real>(alpha: R, to_light: R, to_viewer: R) -> R {
    let square = alpha.square();
    let (to_light, to_viewer) = (to_light.at_least(MIN_COSINE), to_viewer.at_least(MIN_COSINE));
    let (light, viewer) = (to_viewer * smith_root(square, to_light), to_light * smith_root(square, to_viewer));
    // G₂ = 2·nl·nv/(nl·Sv + nv·Sl) and G₁ = 2·nv/(nv + Sv).
    let masked = to_light.mul_add(to_viewer, viewer);
    masked / (viewer + light)
}

/// Fraction of Fresnel's reflectance that rises toward grazing angles, (1 − cosine)⁵: reflectance is F₀ + (1 − F₀)
/// times this.
///
/// Christophe Schlick, "An inexpensive BRDF model for physically-based rendering", 1994.
pub(crate) fn schlick_weight<R: Real>(cosine: R) -> R {
    let rest = (cosine.constant(1.0) - cosine).at_least(0.0).at_most(1.0);
    let square = rest.square();
    square.square() * rest
}

/// Fresnel's reflectance by Schlick's formula, from F₀ and the cosine between the light and the half vector.
pub fn fresnel<R: Real>(at_normal: Vec3<R>, cosine: R) -> Vec3<R> {
    let rise = schlick_weight(cosine);
    at_normal.map(|f| (f.constant(1.0) - f).mul_add(rise, f))
}

/// Fresnel's reflectance F₀ at normal incidence on a boundary between media: ((n − 1)/(n + 1))².
pub(crate) fn f0_from_ior<R: Real>(ior: R) -> R {
    ((ior - 1.0) / (ior + 1.0)).square()
}

/// Two directions that form a right-handed frame with a normal of length 1: x, y, normal.
///
/// Tom Duff et al., "Building an orthonormal basis, revisited", JCGT 6(1), 2017,
/// <https://jcgt.org/published/0006/01/01/>.
pub fn orthonormal_basis<R: Real>(normal: Vec3<R>) -> (Vec3<R>, Vec3<R>) {
    let one = normal.z.constant(1.0);
    let sign = R::select(normal.z.below(0.0), -one, one);
    let a = -(one / (sign + normal.z));
    let b = normal.x * normal.y * a;
    let x = vec3((sign * normal.x * normal.x).mul_add(a, one), sign * b, -(sign * normal.x));
    let y = vec3(b, (normal.y * normal.y).mul_add(a, sign), -normal.y);
    (x, y)
}

/// Samples a microfacet normal visible to the viewer, in the local frame, from two numbers uniform in 0..1.
/// Light reflected by it has the weight [`fresnel`] · [`smith_g2_over_g1`].
///
/// Jonathan Dupuy and Anis Benyoub, "Sampling visible GGX normals with spherical caps", 2023,
/// <https://arxiv.org/abs/2306.05044>.
pub fn sample_visible_normal<R: Real>(to_viewer: Vec3<R>, alpha: R, u: R, v: R) -> Vec3<R> {
    // Stretched, the microfacets form a hemisphere, whose visible normals are a spherical cap.
    let viewer = vec3(to_viewer.x * alpha, to_viewer.y * alpha, to_viewer.z).normalize();
    let (sine, cosine) = (u * TAU).sin_cos();
    let one = u.constant(1.0);
    let z = (one - v).mul_add(one + viewer.z, -viewer.z);
    let radius = (one - z.square()).at_most(1.0).sqrt();
    let cap = vec3(radius * cosine, radius * sine, z) + viewer;
    vec3(cap.x * alpha, cap.y * alpha, cap.z.at_least(1e-6)).normalize()
}
