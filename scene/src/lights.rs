//! Where light comes from.
//!
//! A light's colour is such that a matt white surface that faces it sends back the colour: the light's
//! irradiance over π. Area lights are sampled: each pixel sample takes one point on the light.

mod shaped;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use shaped::{SphereLight, SpotLight};

use crate::materials::microfacet::frame;
use crate::real::{Real, Vec3, bundle};
use crate::sky::{Background, Day};
use crate::values::{Aperture, Color, Direction, Point, Strength};

/// A light: keyed by its name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Light {
    /// See [`Directional`].
    Directional(Directional),
    /// See [`PointLight`].
    Point(PointLight),
    /// See [`SpotLight`].
    Spot(SpotLight),
    /// See [`SphereLight`].
    Sphere(SphereLight),
    /// See [`Sun`].
    Sun(Sun),
    /// See [`SkyLight`].
    Sky(SkyLight),
}

/// Light from far away, the same everywhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Directional {
    /// Towards the light; of any length.
    pub direction: Direction,
    /// Its colour and strength.
    #[serde(default = "white")]
    pub color: Color,
    /// How wide it is, in degrees: shadows have soft edges. The sun is 0.53 wide.
    #[serde(default = "narrow")]
    pub angle: Aperture,
    /// Whether things cast shadows in it.
    #[serde(default = "yes")]
    pub shadow: bool,
}

/// Light from a point; its strength falls as 1/d².
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PointLight {
    /// Where it is.
    pub position: Point,
    /// Its colour, and its strength at a distance of 1.
    #[serde(default = "white")]
    pub color: Color,
    /// Whether things cast shadows in it.
    #[serde(default = "yes")]
    pub shadow: bool,
}

/// The sun of the background's `day`: its direction and its colour come from there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sun {
    /// How bright it is beside the sky.
    #[serde(default = "full")]
    pub strength: Strength,
    /// How wide it is, in degrees.
    #[serde(default = "sun_wide")]
    pub angle: Aperture,
    /// Whether things cast shadows in it.
    #[serde(default = "yes")]
    pub shadow: bool,
}

/// Light from all around, as the background shows it.
///
/// With shadows each sample looks in one direction, chosen by the cosine; without, a colour or a gradient
/// is summed in closed form, and `ambient_occlusion` darkens it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SkyLight {
    /// How bright it is beside what is seen of it.
    #[serde(default = "full")]
    pub strength: Strength,
    /// What shines, where it is not the background.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<Background>,
    /// Whether things cast shadows in it.
    #[serde(default = "yes")]
    pub shadow: bool,
}

/// A light as it arrives at a place.
#[derive(Clone, Copy, Debug)]
pub struct Incoming<R> {
    /// Towards the light, of length 1.
    pub direction: Vec3<R>,
    /// Its linear RGB there; 0 in shadow.
    pub radiance: Vec3<R>,
}

bundle!(Incoming { direction, radiance });

impl Light {
    /// How the light arrives at `p` with nothing in its way, and how far it has come
    /// (at most `farthest`, for light from far away). Of a light with a size, the point that the pair
    /// of numbers from 0 to 1 tells. `None` of light from all around, and of the sun of no day.
    #[inline(always)]
    pub fn arriving<R: Real>(
        &self,
        p: Vec3<R>,
        farthest: R,
        day: Option<&Day>,
        pair: impl FnOnce() -> (R, R),
    ) -> Option<(Incoming<R>, R)> {
        let arriving = match self {
            Self::Directional(light) => {
                let direction = wide(p.x, light.direction.unit(), light.angle, pair);
                let radiance = Vec3::given(p.x, light.color.get());
                (Incoming { direction, radiance }, farthest)
            }
            Self::Point(light) => {
                let towards = Vec3::given(p.x, light.position.get()) - p;
                let distance = towards.length().at_least(1e-6);
                let per_distance = p.x.splat(1.0) / distance;
                let radiance = Vec3::given(p.x, light.color.get()) * per_distance.square();
                (Incoming { direction: towards * per_distance, radiance }, distance)
            }
            Self::Spot(light) => light.arriving(p),
            Self::Sphere(light) => light.arriving(p, pair()),
            Self::Sun(light) => {
                let day = day?;
                let direction = wide(p.x, day.sun.unit(), light.angle, pair);
                let (color, strength) = (day.sun_color(), light.strength.get());
                let radiance = Vec3::given(p.x, color.map(|channel| channel * strength));
                (Incoming { direction, radiance }, farthest)
            }
            Self::Sky(_) => return None,
        };
        Some(arriving)
    }

    /// Whether things cast shadows in it.
    pub fn casts_shadows(&self) -> bool {
        match self {
            Self::Directional(light) => light.shadow,
            Self::Point(light) => light.shadow,
            Self::Spot(light) => light.shadow,
            Self::Sphere(light) => light.shadow,
            Self::Sun(light) => light.shadow,
            Self::Sky(light) => light.shadow,
        }
    }

    /// What is wrong with it before this background, if anything: the place in it, and why.
    pub(crate) fn fault(&self, background: &Background) -> Option<(&'static str, &'static str)> {
        match self {
            Self::Sun(_) if background.day().is_none() => {
                Some(("sun", "shines only by day: make the background a `day`, or use a `directional` light"))
            }
            Self::Sky(SkyLight { from: None, .. }) if *background == Background::Transparent => {
                Some(("sky", "comes from a background that is transparent: say what shines by `from`"))
            }
            Self::Sky(SkyLight { from: Some(Background::Transparent), .. }) => {
                Some(("sky/from", "is nothing that shines: choose a color, a gradient or a day"))
            }
            Self::Sky(SkyLight { from: Some(background), .. }) => {
                Some(("sky/from/day/sun", background.day()?.fault()?))
            }
            Self::Directional(_) | Self::Point(_) | Self::Spot(_) | Self::Sphere(_) | Self::Sun(_) | Self::Sky(_) => {
                None
            }
        }
    }

    /// Finds what all places share.
    pub(crate) fn prepare(&mut self) {
        if let Self::Sky(SkyLight { from: Some(background), .. }) = self {
            background.prepare();
        }
    }
}

/// A direction inside a cone of this whole angle, each as likely as any other.
#[inline(always)]
fn wide<R: Real>(like: R, axis: Vec3<f32>, angle: Aperture, pair: impl FnOnce() -> (R, R)) -> Vec3<R> {
    if angle.is_zero() {
        return Vec3::given(like, axis);
    }
    let (u, v) = pair();
    let half = Real::sin(angle.get() * (std::f32::consts::PI / 720.0));
    // 1 − cos θ, evenly from 0 to 1 − cos(angle/2) = 2 sin²(angle/4).
    let versine = u * like.given(2.0 * half * half);
    let (right, up) = frame(axis);
    around(Vec3::given(like, axis), Vec3::given(like, right), Vec3::given(like, up), versine, v)
}

/// The direction at a versine (1 − cosine) from an axis and a share of a turn around it.
#[inline(always)]
pub(crate) fn around<R: Real>(axis: Vec3<R>, right: Vec3<R>, up: Vec3<R>, versine: R, turn: R) -> Vec3<R> {
    let (sine, cosine) = (turn * std::f32::consts::TAU).sin_cos();
    let away = (versine * (versine.splat(2.0) - versine)).sqrt();
    let along = axis.mul_add(versine.splat(1.0) - versine, right * (away * cosine));
    up.mul_add(away * sine, along)
}

/// The lights of a scene that names none.
pub(crate) fn default_lights() -> Vec<Light> {
    let direction = serde_json::from_str("[0.6, 0.7, 0.5]").expect("a direction");
    vec![Light::Directional(Directional { direction, color: white(), angle: narrow(), shadow: true })]
}

pub(crate) fn white() -> Color {
    Color::new(1.0, 1.0, 1.0)
}

pub(crate) fn yes() -> bool {
    true
}

fn full() -> Strength {
    Strength::new(1.0).expect("1 is in range")
}

fn narrow() -> Aperture {
    Aperture::new(0.0).expect("0 is in range")
}

fn sun_wide() -> Aperture {
    Aperture::new(0.53).expect("0.53 is in range")
}
