//! A physically based material: metal, plastic, lacquer, glass and emitters.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::bsdf::{Bsdf, CLEARCOAT_F0, Lobes};
use super::microfacet::{alpha_from_roughness, f0_from_ior, ggx_distribution, schlick_weight, smith_visibility};
use super::param::lerp;
use super::{ColorParam, IncidentLight, ScalarParam, Shade, ShadingPoint, SpecularBsdf, Texture};
use crate::materials::LightSample;
use crate::real::{FunctionKey, Real, Vec3, bundle, vec3};
use crate::seek::Seek;
use crate::values::{Fraction, RefractiveIndex};

/// A physically based surface: a dielectric or metal, with an optional clear coat.
///
/// Parameters follow glTF 2.0 and its extensions `KHR_materials_ior`, `clearcoat` and `transmission`
/// (<https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#appendix-b-brdf-implementation>), after Brent Burley,
/// "Physically based shading at Disney", 2012. Highlights are single-scattering GGX with Smith's height-correlated
/// shadowing and Schlick's Fresnel. The diffuse term gets only light that is not reflected, on the way in and out, so
/// that the surface conserves energy and is reciprocal. Reflected and transmitted rays show the scene, up to
/// `march.max_bounces` bounces.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// Diffuse color, or the color of a metal's reflections; channels above 1 count as 1.
    #[serde(default = "default_base_color")]
    pub base_color: ColorParam,
    /// Metalness: 1 is a metal, 0 a dielectric.
    #[serde(default = "default_fraction")]
    pub metallic: ScalarParam<Fraction>,
    /// Roughness: 0 is a mirror, 1 is matte. Its square is the α of GGX, at least 0.002.
    #[serde(default = "default_roughness")]
    pub roughness: ScalarParam<Fraction>,
    /// Index of refraction.
    #[serde(default = "default_ior")]
    pub ior: ScalarParam<RefractiveIndex>,
    /// Emitted light.
    #[serde(default = "ColorParam::black")]
    pub emission: ColorParam,
    /// Fraction of the surface under a clear coat, whose index of refraction is 1.5.
    #[serde(default = "default_fraction")]
    pub clearcoat: ScalarParam<Fraction>,
    /// Roughness of the clear coat.
    #[serde(default = "default_clearcoat_roughness")]
    pub clearcoat_roughness: ScalarParam<Fraction>,
    /// Fraction of the light entering the surface that is transmitted, tinted by the square root of `base_color` on
    /// the way in and out.
    #[serde(default = "default_fraction")]
    pub transmission: ScalarParam<Fraction>,
}

/// A clear coat at a shading point.
#[derive(Clone, Copy)]
struct Clearcoat<R> {
    amount: R,
    alpha: R,
}

bundle!(Clearcoat { amount, alpha });

impl<R: Real> Clearcoat<R> {
    /// Fraction of the light that it reflects, for the cosine's [`schlick_weight`].
    fn mirrored(&self, grazing: R) -> R {
        self.amount * grazing.mul_add(grazing.constant(1.0 - CLEARCOAT_F0), grazing.constant(CLEARCOAT_F0))
    }

    /// Fraction of the light that it transmits.
    fn transmitted(&self, grazing: R) -> R {
        grazing.constant(1.0) - self.mirrored(grazing)
    }
}

/// Terms of the surface at a shading point, as the formulas use them.
#[derive(Clone, Copy)]
struct SurfaceTerms<R: Real> {
    to_viewer: Vec3<R>,
    normal: Vec3<R>,
    /// Cosine to the viewer.
    n_dot_v: R,
    /// Its [`schlick_weight`].
    viewer_schlick: R,
    /// Reflectance at the normal.
    f0: Vec3<R>,
    /// Diffuse color, without the terms that depend on directions.
    diffuse_color: Vec3<R>,
    alpha: R,
    clearcoat: Option<Clearcoat<R>>,
}

bundle!(SurfaceTerms { to_viewer, normal, n_dot_v, viewer_schlick, f0, diffuse_color, alpha, clearcoat });

impl Surface {
    fn base<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        if let Some(color) = self.base_color.as_constant() {
            let color = color.in_frame();
            return Vec3::uniform(place.normal.x, vec3(color.x.min(1.0), color.y.min(1.0), color.z.min(1.0)));
        }
        self.base_color.at(place).map(|c| c.at_most(1.0))
    }

    /// F0 of the surface: of the dielectric, and by channel with metalness.
    fn f0<R: Real>(&self, place: &ShadingPoint<R>, base: Vec3<R>) -> (R, Vec3<R>) {
        let border = match &self.ior {
            ScalarParam::Constant(ior) => base.x.uniform(f0_from_ior(ior.in_frame())),
            ScalarParam::Textured(_) => f0_from_ior(self.ior.at(place)),
        };
        if self.metallic.is_zero() {
            return (border, vec3(border, border, border));
        }
        let metallic = self.metallic.at(place);
        let whole = base.map(|c| lerp(border, c, metallic));
        (border, whole)
    }

    /// Diffuse fraction of the light, and transmitted fraction.
    fn diffuse_and_transmitted<R: Real>(&self, place: &ShadingPoint<R>) -> (R, R) {
        let one = place.normal.x.constant(1.0);
        let body = if self.metallic.is_zero() { one } else { one - self.metallic.at(place) };
        if self.transmission.is_zero() {
            return (body, one.constant(0.0));
        }
        let through = body * self.transmission.at(place);
        (body - through, through)
    }

    /// Fraction of the light that enters and is transmitted, by channel.
    fn transmitted<R: Real>(&self, place: &ShadingPoint<R>, base: Vec3<R>) -> Vec3<R> {
        let zero = base.x.constant(0.0);
        if self.transmission.is_zero() {
            return vec3(zero, zero, zero);
        }
        let (_, through) = self.diffuse_and_transmitted(place);
        base.map(|c| c.sqrt() * through)
    }

    fn clearcoat<R: Real>(&self, place: &ShadingPoint<R>) -> Option<Clearcoat<R>> {
        if self.clearcoat.is_zero() {
            return None;
        }
        Some(Clearcoat {
            amount: self.clearcoat.at(place),
            alpha: alpha_from_roughness(self.clearcoat_roughness.at(place)),
        })
    }

    fn layers<R: Real>(&self, place: &ShadingPoint<R>) -> SurfaceTerms<R> {
        let base = self.base(place);
        let (border, at_normal) = self.f0(place, base);
        let (scattered, _) = self.diffuse_and_transmitted(place);
        let coat = self.clearcoat(place);
        let facing = place.normal.dot(place.to_viewer).at_least(0.0);
        // Light that leaves is reflected back at the boundary by its average reflectance, 1/21 above F₀, and scattered
        // again. So the diffuse color is divided by the average transmittance.
        let share = match coat {
            None => scattered * (21.0 / 20.0),
            Some(coat) => scattered / average_transmittance(coat.amount),
        };
        let share = share * (share.constant(1.0) - border);
        SurfaceTerms {
            to_viewer: place.to_viewer,
            normal: place.normal,
            n_dot_v: facing,
            viewer_schlick: schlick_weight(facing),
            f0: at_normal,
            diffuse_color: base * share,
            alpha: alpha_from_roughness(self.roughness.at(place)),
            clearcoat: coat,
        }
    }
}

/// Average over all directions, weighted by cosine, of (1 − s)·(1 − c·(f + (1 − f)·s)): the transmittance of the
/// boundary and the clear coat, s = (1 − cosine)⁵, without the boundary's factor 1 − F₀. The averages of s and s² are
/// 1/21 and 1/66.
fn average_transmittance<R: Real>(amount: R) -> R {
    const CLEARCOAT_LOSS: f32 = CLEARCOAT_F0 * (20.0 / 21.0) + (1.0 - CLEARCOAT_F0) * (1.0 / 21.0 - 1.0 / 66.0);
    amount.mul_add(amount.constant(-CLEARCOAT_LOSS), amount.constant(20.0 / 21.0))
}

impl<R: Real> SurfaceTerms<R> {
    /// Transmittance of boundary and clear coat between the diffuse term and one direction, without the factor 1 − F₀.
    fn transmitted(&self, grazing: R) -> R {
        let border = grazing.constant(1.0) - grazing;
        match self.clearcoat {
            None => border,
            Some(coat) => border * coat.transmitted(grazing),
        }
    }

    /// Ambient light reflected by the diffuse term.
    fn reflect_ambient(&self, light: Vec3<R>) -> Vec3<R> {
        // Over all directions, the incoming light cancels the division by the average transmittance.
        let share = match self.clearcoat {
            None => self.viewer_schlick.constant(20.0 / 21.0),
            Some(coat) => average_transmittance(coat.amount),
        };
        self.diffuse_color.mul_elementwise(light) * (self.transmitted(self.viewer_schlick) * share)
    }

    /// Light from one direction, reflected to the viewer. One function for all surfaces and lights.
    fn reflect(self, light: LightSample<R>) -> Vec3<R> {
        self.n_dot_v.call(
            FunctionKey::new(if self.clearcoat.is_some() { "coated_surface" } else { "surface" }),
            (self, light),
            |(layers, light)| layers.reflected(&light),
        )
    }

    fn reflected(&self, light: &LightSample<R>) -> Vec3<R> {
        let like = self.n_dot_v;
        let toward = self.normal.dot(light.direction).at_least(0.0);
        let half = (light.direction + self.to_viewer).normalize();
        let cosine = self.normal.dot(half).at_least(0.0);
        let sine_squared = self.normal.cross(half).length_squared();
        let rise = schlick_weight(self.to_viewer.dot(half));
        let light_grazing = schlick_weight(toward);

        let shine =
            ggx_distribution(self.alpha, cosine, sine_squared) * smith_visibility(self.alpha, toward, self.n_dot_v);
        let border = self.f0.map(|f| (like.constant(1.0) - f).mul_add(rise, f) * shine);
        let body = self.diffuse_color * (self.transmitted(light_grazing) * self.transmitted(self.viewer_schlick));
        let sum = match self.clearcoat {
            None => body + border,
            Some(coat) => {
                let through = coat.transmitted(light_grazing) * coat.transmitted(self.viewer_schlick);
                let shine = ggx_distribution(coat.alpha, cosine, sine_squared)
                    * smith_visibility(coat.alpha, toward, self.n_dot_v);
                let mirrored = coat.mirrored(rise) * shine;
                (border * through + body).map(|c| c + mirrored)
            }
        };
        sum.mul_elementwise(light.radiance * toward)
    }
}

impl Shade for Surface {
    const ALIASES: &'static [&'static str] =
        &["aluminum", "dielectric", "glass", "metal", "pbr", "principled", "standard"];
    const EXAMPLE: &'static str = r##"{ "base_color": "#c8452d", "roughness": 0.35 }"##;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "base_color": [1.0, 0.71, 0.29], "metallic": 1, "roughness": 0.25 }"#,
        r##"{ "base_color": "#0b3d6b", "roughness": 0.6, "clearcoat": 1, "clearcoat_roughness": 0.05 }"##,
        r##"{ "base_color": "#e8fff4", "roughness": 0, "transmission": 1, "ior": 1.5 }"##,
        r##"{ "base_color": "#101010", "emission": { "stripes": { "direction": [0, 1, 0], "width": 0.12,
              "colors": [[0, 0, 0], [0.2, 1.6, 1.2]] } } }"##,
        r##"{ "base_color": { "checker": { "cell": 0.4, "colors": ["#d8d8d8", "#b87333"] } },
              "metallic": { "low": 0, "high": 1, "by": { "checker": { "cell": 0.4 } } },
              "roughness": { "low": 0.2, "high": 0.7, "by": { "stripes": { "width": 0.1 } } },
              "ior": { "low": 1.3, "high": 1.8, "by": { "stripes": { "width": 0.2 } } },
              "clearcoat": { "low": 0, "high": 1, "by": { "checker": { "cell": 0.8 } } },
              "transmission": { "low": 0, "high": 0.5, "by": { "checker": { "cell": 0.2 } } } }"##,
    ];

    fn shade<R: Real>(&self, place: &ShadingPoint<R>, light: &IncidentLight<R>) -> Vec3<R> {
        let layers = self.layers(place);
        let like = place.normal.x;
        let mut sum = vec3(like.constant(0.0), like.constant(0.0), like.constant(0.0));
        if !self.emission.is_black() {
            sum = self.emission.at(place);
            if let Some(coat) = layers.clearcoat {
                sum = sum * coat.transmitted(layers.viewer_schlick);
            }
        }
        if let Some(around) = light.ambient {
            sum = sum + layers.reflect_ambient(around);
        }
        for &light in &light.lights {
            sum = sum + layers.reflect(light);
        }
        sum
    }

    fn albedo<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        self.base(place)
    }

    fn bsdf<R: Real>(&self, place: &ShadingPoint<R>) -> Bsdf<R> {
        let terms = self.layers(place);
        let like = terms.n_dot_v;
        let zero = like.constant(0.0);
        let mut emission = self.emission.at(place);
        if let Some(coat) = terms.clearcoat {
            emission = emission * coat.transmitted(terms.viewer_schlick);
        }
        // Without a boundary, the body scatters as Lambert's does: the light that a boundary sends back is not made up for.
        let (border, diffuse) = match terms.clearcoat {
            None => {
                let border = (terms.f0.max_element() * 50.0).at_most(1.0);
                (border, terms.diffuse_color * (like.constant(1.0) - (like.constant(1.0) - border) * (1.0 / 21.0)))
            }
            Some(_) => (like.constant(1.0), terms.diffuse_color),
        };
        let coat = terms.clearcoat.unwrap_or(Clearcoat { amount: zero, alpha: like.constant(1.0) });
        Bsdf {
            emission,
            diffuse,
            border,
            f0: terms.f0,
            alpha: terms.alpha,
            coat: coat.amount,
            coat_alpha: coat.alpha,
            transmission: self.transmitted(place, self.base(place)),
            ior: self.ior.at(place),
        }
    }

    fn lobes(&self) -> Lobes {
        Lobes { reflection: true, coat: !self.clearcoat.is_zero(), transmission: !self.transmission.is_zero() }
    }

    fn uniform_emission(&self) -> Option<Vec3<f32>> {
        let emission = self.emission.as_constant().filter(|color| !color.is_black())?;
        self.clearcoat.is_zero().then(|| emission.in_frame())
    }

    fn is_lit(&self) -> bool {
        true
    }

    fn is_black_without_light(&self) -> bool {
        self.emission.is_black() && self.metallic.is_zero() && self.transmission.is_zero()
    }

    fn specular<R: Real>(&self, place: &ShadingPoint<R>) -> Option<SpecularBsdf<R>> {
        let base = self.base(place);
        let (_, at_normal) = self.f0(place, base);
        let roughness = self.roughness.at(place);
        let ior = self.ior.at(place);
        let passed = self.transmitted(place, base);
        let (mirrored, roughness) = if self.clearcoat.is_zero() {
            (at_normal, roughness)
        } else {
            self.combined_f0_and_roughness(place, at_normal, roughness)
        };
        Some(SpecularBsdf { f0: mirrored, roughness, transmission: passed, ior })
    }

    fn is_specular(&self) -> bool {
        true
    }

    fn is_transmissive(&self) -> bool {
        !self.transmission.is_zero()
    }

    fn textures(&self) -> Vec<&Texture> {
        let Self { base_color, metallic, roughness, ior, emission, clearcoat, clearcoat_roughness, transmission } =
            self;
        let shares = [metallic, roughness, clearcoat, clearcoat_roughness, transmission];
        let colors = [base_color, emission].into_iter().filter_map(ColorParam::texture);
        colors.chain(shares.into_iter().filter_map(ScalarParam::texture)).chain(ior.texture()).collect()
    }
}

impl Surface {
    /// Combined F0 of clear coat and surface, and their mean roughness, weighted by F0.
    fn combined_f0_and_roughness<R: Real>(
        &self,
        place: &ShadingPoint<R>,
        at_normal: Vec3<R>,
        roughness: R,
    ) -> (Vec3<R>, R) {
        let coat = self.clearcoat.at(place) * CLEARCOAT_F0;
        let through = (coat.constant(1.0) - coat).square();
        let border = at_normal * through;
        let weight = (border.x + border.y + border.z) * (1.0 / 3.0);
        // 1e-6 if neither reflects anything: any roughness will do.
        let whole = (coat + weight).at_least(1e-6);
        let mean = self.clearcoat_roughness.at(place).mul_add(coat, roughness * weight) / whole;
        let mirrored = border.map(|f| f + coat);
        (mirrored, mean)
    }
}

fn default_base_color() -> ColorParam {
    ColorParam::constant(0.8, 0.8, 0.8)
}

fn constant_fraction(value: f32) -> ScalarParam<Fraction> {
    ScalarParam::Constant(Fraction::new(value).expect("a fraction is from 0 to 1"))
}

fn default_fraction() -> ScalarParam<Fraction> {
    constant_fraction(0.0)
}

fn default_roughness() -> ScalarParam<Fraction> {
    constant_fraction(0.5)
}

fn default_clearcoat_roughness() -> ScalarParam<Fraction> {
    constant_fraction(0.03)
}

fn default_ior() -> ScalarParam<RefractiveIndex> {
    ScalarParam::Constant(RefractiveIndex::new(1.5).expect("1.5 is in range"))
}
