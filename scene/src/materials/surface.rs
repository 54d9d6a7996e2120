//! A physically based material: metal, plastic, lacquer, glass and what glows.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::microfacet::{alpha, distribution, grazing, reflectance_at_normal, visibility};
use super::param::mix;
use super::{Exemplary, Finish, Level, Lighting, Place, Shade, Texture, Tint};
use crate::lights::Incoming;
use crate::real::{Real, Vec3, bundle, vec3};
use crate::seek::Seek;
use crate::values::{RefractiveIndex, Share};

/// A physically based surface: a matt body under a border that mirrors, or metal; under a clear coat if it has one.
///
/// Parameters are those of glTF 2.0 and its extensions `KHR_materials_ior`, `clearcoat` and `transmission`
/// (<https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#appendix-b-brdf-implementation>), after Brent Burley,
/// "Physically based shading at Disney", 2012. Highlights are single-scattering GGX with Smith's height-correlated
/// shadowing and Schlick's Fresnel. What enters the body was not mirrored, on the way in and out, so that the whole
/// never sends back more than arrives and is the same with light and viewer exchanged.
/// The scene around is mirrored and seen through as far as `march.max_bounces` allows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// Color of the body, or of a metal's reflections; channels above 1 count as 1.
    #[serde(default = "default_base_color")]
    pub base_color: Tint,
    /// Whether it is a metal: 1, or not: 0.
    #[serde(default = "none")]
    pub metallic: Level<Share>,
    /// Roughness: 0 is a mirror, 1 is matte. Its square is the α of GGX, at least 0.002.
    #[serde(default = "default_roughness")]
    pub roughness: Level<Share>,
    /// Index of refraction of the body.
    #[serde(default = "default_ior")]
    pub ior: Level<RefractiveIndex>,
    /// Emitted light.
    #[serde(default = "Tint::black")]
    pub emission: Tint,
    /// Fraction of it under a clear coat, whose index of refraction is 1.5.
    #[serde(default = "none")]
    pub clearcoat: Level<Share>,
    /// Roughness of the clear coat.
    #[serde(default = "default_clearcoat_roughness")]
    pub clearcoat_roughness: Level<Share>,
    /// Fraction of the light that enters the body and is transmitted, tinted by the root of `base_color`
    /// on the way in and out.
    #[serde(default = "none")]
    pub transmission: Level<Share>,
}

/// Reflectance at the normal of a clear coat.
const COAT_AT_NORMAL: f32 = 0.04;

/// A clear coat at a place.
#[derive(Clone, Copy)]
struct Coat<R> {
    amount: R,
    alpha: R,
}

bundle!(Coat { amount, alpha });

impl<R: Real> Coat<R> {
    /// Fraction of the light that it reflects, given the cosine's [`grazing`] part.
    #[inline(always)]
    fn mirrored(&self, grazing: R) -> R {
        self.amount * grazing.mul_add(grazing.splat(1.0 - COAT_AT_NORMAL), grazing.splat(COAT_AT_NORMAL))
    }

    /// Fraction of the light that it transmits.
    #[inline(always)]
    fn passed(&self, grazing: R) -> R {
        grazing.splat(1.0) - self.mirrored(grazing)
    }
}

/// The surface at a place: its parameters as the formulas want them.
#[derive(Clone, Copy)]
struct Layers<R: Real> {
    to_viewer: Vec3<R>,
    normal: Vec3<R>,
    /// Cosine to the viewer.
    facing: R,
    /// Its [`grazing`] part.
    viewer_grazing: R,
    /// Reflectance at the normal.
    at_normal: Vec3<R>,
    /// Color of the light that the body scatters, without the terms that depend on directions.
    body: Vec3<R>,
    alpha: R,
    coat: Option<Coat<R>>,
}

bundle!(Layers { to_viewer, normal, facing, viewer_grazing, at_normal, body, alpha, coat });

impl Surface {
    #[inline(always)]
    fn base<R: Real>(&self, place: &Place<R>) -> Vec3<R> {
        if let Some(color) = self.base_color.plain() {
            let color = color.get();
            return Vec3::given(place.normal.x, vec3(color.x.min(1.0), color.y.min(1.0), color.z.min(1.0)));
        }
        self.base_color.at(place).map(
            #[inline(always)]
            |c| c.at_most(1.0),
        )
    }

    /// Reflectance at the normal, of the border and by channel of the whole.
    #[inline(always)]
    fn at_normal<R: Real>(&self, place: &Place<R>, base: Vec3<R>) -> (R, Vec3<R>) {
        let border = match &self.ior {
            Level::Plain(ior) => base.x.given(reflectance_at_normal(ior.get())),
            Level::Varied(_) => reflectance_at_normal(self.ior.at(place)),
        };
        if self.metallic.is_zero() {
            return (border, vec3(border, border, border));
        }
        let metallic = self.metallic.at(place);
        let whole = base.map(
            #[inline(always)]
            |c| mix(border, c, metallic),
        );
        (border, whole)
    }

    /// Fraction of the light that enters and is scattered by the body, and fraction that is transmitted.
    #[inline(always)]
    fn entering<R: Real>(&self, place: &Place<R>) -> (R, R) {
        let one = place.normal.x.splat(1.0);
        let body = if self.metallic.is_zero() { one } else { one - self.metallic.at(place) };
        if self.transmission.is_zero() {
            return (body, one.splat(0.0));
        }
        let through = body * self.transmission.at(place);
        (body - through, through)
    }

    #[inline(always)]
    fn coat<R: Real>(&self, place: &Place<R>) -> Option<Coat<R>> {
        if self.clearcoat.is_zero() {
            return None;
        }
        Some(Coat { amount: self.clearcoat.at(place), alpha: alpha(self.clearcoat_roughness.at(place)) })
    }

    #[inline(always)]
    fn layers<R: Real>(&self, place: &Place<R>) -> Layers<R> {
        let base = self.base(place);
        let (border, at_normal) = self.at_normal(place, base);
        let (scattered, _) = self.entering(place);
        let coat = self.coat(place);
        let facing = place.normal.dot(place.to_viewer).at_least(0.0);
        // Light that leaves is mirrored back at the border by its average, 1/21 above that at the normal,
        // and scattered again: so the body is divided by what passes on average.
        let share = match coat {
            None => scattered * (21.0 / 20.0),
            Some(coat) => scattered / average_passed(coat.amount),
        };
        let share = share * (share.splat(1.0) - border);
        Layers {
            to_viewer: place.to_viewer,
            normal: place.normal,
            facing,
            viewer_grazing: grazing(facing),
            at_normal,
            body: base * share,
            alpha: alpha(self.roughness.at(place)),
            coat,
        }
    }
}

/// The average over all directions, by cosine, of (1 − s)·(1 − c·(f + (1 − f)·s)): what passes the border and the
/// coat, s = (1 − cosine)⁵, without the border's 1 − F₀. The averages of s and s² are 1/21 and 1/66.
#[inline(always)]
fn average_passed<R: Real>(amount: R) -> R {
    const LOST: f32 = COAT_AT_NORMAL * (20.0 / 21.0) + (1.0 - COAT_AT_NORMAL) * (1.0 / 21.0 - 1.0 / 66.0);
    amount.mul_add(amount.splat(-LOST), amount.splat(20.0 / 21.0))
}

impl<R: Real> Layers<R> {
    /// Fraction of the light between the body and one direction that passes border and coat, without 1 −
    /// F₀.
    #[inline(always)]
    fn passed(&self, grazing: R) -> R {
        let border = grazing.splat(1.0) - grazing;
        match self.coat {
            None => border,
            Some(coat) => border * coat.passed(grazing),
        }
    }

    /// Light from all around, sent back by the body.
    #[inline(always)]
    fn around(&self, light: Vec3<R>) -> Vec3<R> {
        // Over all directions the light that enters makes up for the division by what passes on average.
        let share = match self.coat {
            None => self.viewer_grazing.splat(20.0 / 21.0),
            Some(coat) => average_passed(coat.amount),
        };
        self.body.by_channel(light) * (self.passed(self.viewer_grazing) * share)
    }

    /// Light from one direction, sent back to the viewer: one step for all surfaces and lights.
    #[inline(always)]
    fn answer(self, light: Incoming<R>) -> Vec3<R> {
        self.facing.shared(
            if self.coat.is_some() { "coated_surface" } else { "surface" },
            (self, light),
            #[inline(always)]
            |(layers, light)| layers.reflected(&light),
        )
    }

    #[inline(always)]
    fn reflected(&self, light: &Incoming<R>) -> Vec3<R> {
        let like = self.facing;
        let towards = self.normal.dot(light.direction).at_least(0.0);
        let half = (light.direction + self.to_viewer).normalize();
        let cosine = self.normal.dot(half).at_least(0.0);
        let sine_squared = self.normal.cross(half).length_squared();
        let rise = grazing(self.to_viewer.dot(half));
        let light_grazing = grazing(towards);

        let shine = distribution(self.alpha, cosine, sine_squared) * visibility(self.alpha, towards, self.facing);
        let border = self.at_normal.map(
            #[inline(always)]
            |f| (like.splat(1.0) - f).mul_add(rise, f) * shine,
        );
        let body = self.body * (self.passed(light_grazing) * self.passed(self.viewer_grazing));
        let sum = match self.coat {
            None => body + border,
            Some(coat) => {
                let through = coat.passed(light_grazing) * coat.passed(self.viewer_grazing);
                let shine =
                    distribution(coat.alpha, cosine, sine_squared) * visibility(coat.alpha, towards, self.facing);
                let mirrored = coat.mirrored(rise) * shine;
                (border * through + body).map(
                    #[inline(always)]
                    |c| c + mirrored,
                )
            }
        };
        sum.by_channel(light.radiance * towards)
    }
}

impl Exemplary for Surface {
    const EXAMPLE: &'static str = r##"{ "base_color": "#c8452d", "roughness": 0.35 }"##;
    const MORE: &'static [&'static str] = &[
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
}

impl Shade for Surface {
    #[inline(always)]
    fn shade<R: Real>(&self, place: &Place<R>, light: &Lighting<R>) -> Vec3<R> {
        let layers = self.layers(place);
        let like = place.normal.x;
        let mut sum = vec3(like.splat(0.0), like.splat(0.0), like.splat(0.0));
        if !self.emission.is_black() {
            sum = self.emission.at(place);
            if let Some(coat) = layers.coat {
                sum = sum * coat.passed(layers.viewer_grazing);
            }
        }
        if let Some(around) = light.surrounding {
            sum = sum + layers.around(around);
        }
        for &light in &light.lights {
            sum = sum + layers.answer(light);
        }
        sum
    }

    #[inline(always)]
    fn albedo<R: Real>(&self, place: &Place<R>) -> Vec3<R> {
        self.base(place)
    }

    fn is_lit(&self) -> bool {
        true
    }

    fn is_black_without_light(&self) -> bool {
        self.emission.is_black() && self.metallic.is_zero() && self.transmission.is_zero()
    }

    #[inline(always)]
    fn finish<R: Real>(&self, place: &Place<R>) -> Option<Finish<R>> {
        let base = self.base(place);
        let (_, at_normal) = self.at_normal(place, base);
        let roughness = self.roughness.at(place);
        let ior = self.ior.at(place);
        let zero = ior.splat(0.0);
        let passed = if self.transmission.is_zero() {
            vec3(zero, zero, zero)
        } else {
            let (_, through) = self.entering(place);
            base.map(
                #[inline(always)]
                |c| c.sqrt() * through,
            )
        };
        let (mirrored, roughness) =
            if self.clearcoat.is_zero() { (at_normal, roughness) } else { self.coated(place, at_normal, roughness) };
        Some(Finish { mirrored, roughness, passed, ior })
    }

    fn sends_on(&self) -> bool {
        true
    }

    fn lets_through(&self) -> bool {
        !self.transmission.is_zero()
    }

    fn textures(&self) -> Vec<&Texture> {
        let Self { base_color, metallic, roughness, ior, emission, clearcoat, clearcoat_roughness, transmission } =
            self;
        let shares = [metallic, roughness, clearcoat, clearcoat_roughness, transmission];
        let tints = [base_color, emission].into_iter().filter_map(Tint::texture);
        tints.chain(shares.into_iter().filter_map(Level::texture)).chain(ior.texture()).collect()
    }
}

impl Surface {
    /// Combined reflectance of coat and border at normal incidence, and their roughness: the mean
    /// weighted by reflectance.
    #[inline(always)]
    fn coated<R: Real>(&self, place: &Place<R>, at_normal: Vec3<R>, roughness: R) -> (Vec3<R>, R) {
        let coat = self.clearcoat.at(place) * COAT_AT_NORMAL;
        let through = (coat.splat(1.0) - coat).square();
        let border = at_normal * through;
        let weight = (border.x + border.y + border.z) * (1.0 / 3.0);
        // 1e-6 where neither mirrors anything: any roughness will do.
        let whole = (coat + weight).at_least(1e-6);
        let mean = self.clearcoat_roughness.at(place).mul_add(coat, roughness * weight) / whole;
        let mirrored = border.map(
            #[inline(always)]
            |f| f + coat,
        );
        (mirrored, mean)
    }
}

fn default_base_color() -> Tint {
    Tint::plain_of(0.8, 0.8, 0.8)
}

fn share(value: f32) -> Level<Share> {
    Level::Plain(Share::new(value).expect("a share is from 0 to 1"))
}

fn none() -> Level<Share> {
    share(0.0)
}

fn default_roughness() -> Level<Share> {
    share(0.5)
}

fn default_clearcoat_roughness() -> Level<Share> {
    share(0.03)
}

fn default_ior() -> Level<RefractiveIndex> {
    Level::Plain(RefractiveIndex::new(1.5).expect("1.5 is in range"))
}
