//! Where light comes from.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::real::{Real, Vec3};
use crate::values::{Color, Direction, Point};

/// A light: keyed by its name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Light {
    /// See [`Directional`].
    Directional(Directional),
    /// See [`PointLight`].
    Point(PointLight),
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

/// A light as it arrives at a place.
#[derive(Clone, Copy, Debug)]
pub struct Incoming<R> {
    /// Towards the light, of length 1.
    pub direction: Vec3<R>,
    /// Its linear RGB there; 0 in shadow.
    pub radiance: Vec3<R>,
}

impl Light {
    /// How the light arrives at `p` with nothing in its way, and how far it has come
    /// (at most `farthest`, for light from far away).
    #[inline(always)]
    pub fn arriving<R: Real>(&self, p: Vec3<R>, farthest: R) -> (Incoming<R>, R) {
        match self {
            Self::Directional(light) => {
                let direction = Vec3::given(p.x, light.direction.unit());
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
        }
    }

    /// Whether things cast shadows in it.
    pub fn casts_shadows(&self) -> bool {
        match self {
            Self::Directional(light) => light.shadow,
            Self::Point(light) => light.shadow,
        }
    }
}

/// The lights of a scene that names none.
pub(crate) fn default_lights() -> Vec<Light> {
    let direction = serde_json::from_str("[0.6, 0.7, 0.5]").expect("a direction");
    vec![Light::Directional(Directional { direction, color: white(), shadow: true })]
}

fn white() -> Color {
    Color::new(1.0, 1.0, 1.0)
}

fn yes() -> bool {
    true
}
