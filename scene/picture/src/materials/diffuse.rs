//! Matte material with a highlight, as in the paper.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::bsdf::{Bsdf, Lobes};
use super::microfacet::MIN_ALPHA;
use super::{ColorParam, IncidentLight, ScalarParam, Shade, ShadingPoint, Texture};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Color, Shininess};

/// Phong's model: ka·ambient + Σ lights: kd·le·(N·L) + ks·le·(R·E)^shininess, on both sides.
///
/// Bui Tuong Phong, "Illumination for computer generated pictures", CACM 18(6), 1975.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Diffuse {
    /// Color of scattered light.
    #[serde(default = "default_kd")]
    pub kd: ColorParam,
    /// Color of the highlight.
    #[serde(default = "ColorParam::black")]
    pub ks: ColorParam,
    /// Color for ambient light; `kd` when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ka: Option<ColorParam>,
    /// Ambient light.
    #[serde(default = "default_ambient")]
    pub ambient: ColorParam,
    /// Exponent of the highlight: larger is narrower.
    #[serde(default = "default_shininess")]
    pub shininess: ScalarParam<Shininess>,
}

impl Diffuse {
    /// Reflected ambient light, for the value of `kd` at the point.
    fn ambient<R: Real>(&self, place: &ShadingPoint<R>, kd: Vec3<R>) -> Vec3<R> {
        let answer = self.ka.as_ref().unwrap_or(&self.kd);
        if let (Some(ka), Some(la)) = (answer.as_constant(), self.ambient.as_constant()) {
            let (ka, la) = (ka.in_frame(), la.in_frame());
            return Vec3::uniform(place.normal.x, vec3(ka.x * la.x, ka.y * la.y, ka.z * la.z));
        }
        let ka = match &self.ka {
            Some(ka) => ka.at(place),
            None => kd,
        };
        ka.mul_elementwise(self.ambient.at(place))
    }
}

impl Shade for Diffuse {
    const ALIASES: &'static [&'static str] = &["blinn", "lambert", "matte", "phong"];
    const EXAMPLE: &'static str = r##"{ "kd": "#4f7fb8", "ks": [0.3, 0.3, 0.3], "shininess": 40 }"##;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r##"{ "kd": { "checker": { "cell": 0.4, "colors": ["#b5432f", "#e8dcc0"] } }, "ka": [0.5, 0.5, 0.6],
              "ambient": [0.2, 0.2, 0.2] }"##,
        r##"{ "kd": "#2d2f38",
              "ks": { "stripes": { "direction": [1, 1, 0], "width": 0.2, "colors": ["#000000", "#d0d0c0"] } },
              "ambient": { "gradient": { "by": { "normal": { "direction": [0, 1, 0] } },
                                         "ramp": [[0, [0.05, 0.03, 0.02]], [1, [0.3, 0.4, 0.6]]] } },
              "shininess": { "low": 4, "high": 90, "by": { "checker": { "cell": 0.6 } } } }"##,
    ];

    fn shade<R: Real>(&self, place: &ShadingPoint<R>, light: &IncidentLight<R>) -> Vec3<R> {
        let like = place.normal.x;
        let kd = self.kd.at(place);
        let gloss = if self.ks.is_black() { None } else { Some((self.ks.at(place), self.shininess.at(place))) };
        let mut sum = self.ambient(place, kd);
        if let Some(openness) = light.ambient_visibility {
            sum = sum * openness;
        }
        if let Some(around) = light.ambient {
            sum = kd.mul_add_elementwise(around, sum);
        }
        for light in &light.lights {
            let facing = place.normal.dot(light.direction).at_least(0.0);
            let scattered = light.radiance * facing;
            sum = kd.mul_add_elementwise(scattered, sum);
            if let Some((ks, shininess)) = gloss {
                let mirrored = place.normal.mul_add(facing + facing, -light.direction);
                let toward = mirrored.dot(place.to_viewer).at_least(0.0);
                let highlight = toward.powf(shininess);
                let highlight = R::select(facing.above(0.0), highlight, like.constant(0.0));
                let glossy = light.radiance * highlight;
                sum = ks.mul_add_elementwise(glossy, sum);
            }
        }
        sum
    }

    fn albedo<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        self.kd.at(place)
    }

    /// Light that travels takes the place of the ambient light. A highlight becomes one of microfacets that is as wide
    /// and, where it is brightest, as bright.
    ///
    /// Bruce Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007: α² = 2/(n + 2).
    fn bsdf<R: Real>(&self, place: &ShadingPoint<R>) -> Bsdf<R> {
        let matte = Bsdf { diffuse: self.kd.at(place), ..Bsdf::black(place.camera_t) };
        if self.ks.is_black() {
            return matte;
        }
        let square = place.camera_t.constant(2.0) / (self.shininess.at(place) + 2.0);
        let f0 = self.ks.at(place) * (square * 4.0).at_most(1.0);
        Bsdf { f0, alpha: square.sqrt().at_least(MIN_ALPHA), ..matte }
    }

    fn lobes(&self) -> Lobes {
        Lobes { reflection: !self.ks.is_black(), ..Lobes::default() }
    }

    fn is_lit(&self) -> bool {
        true
    }

    fn has_own_ambient(&self) -> bool {
        self.ka.is_some() || self.ambient != default_ambient()
    }

    fn is_black_without_light(&self) -> bool {
        const FAINT: f32 = 0.1;
        self.ambient.as_constant().and_then(Color::constant).is_some_and(|ambient| ambient.max_element() <= FAINT)
    }

    fn textures(&self) -> Vec<&Texture> {
        let Self { kd, ks, ka, ambient, shininess } = self;
        let colors = [Some(kd), Some(ks), ka.as_ref(), Some(ambient)].into_iter().flatten();
        colors.filter_map(ColorParam::texture).chain(shininess.texture()).collect()
    }
}

fn default_kd() -> ColorParam {
    ColorParam::constant(0.8, 0.8, 0.8)
}

fn default_ambient() -> ColorParam {
    ColorParam::constant(0.1, 0.1, 0.1)
}

fn default_shininess() -> ScalarParam<Shininess> {
    ScalarParam::Constant(Shininess::new(16.0).expect("16 is in range"))
}
