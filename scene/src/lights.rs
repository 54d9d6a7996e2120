//! Where light comes from: the list of lights, and what a light must say of itself.
//!
//! A light is one documented struct in a file under `lights/`, one `impl` of [`LightSource`] and of [`HasExamples`],
//! and one entry in the list. A light's color is such that a matte white surface that faces it sends back the color:
//! the light's irradiance over π. Area lights are sampled: each pixel sample takes one point on the light.

#[cfg(test)]
mod added;
mod directional;
mod local;
mod point;
mod sky_light;
mod sun;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

#[cfg(test)]
pub use added::AddedLight;
pub use directional::Directional;
pub use local::{SphereLight, SpotLight};
pub use point::PointLight;
pub use sky_light::SkyLight;
pub use sun::Sun;

use crate::backgrounds::{Background, Day};
pub use crate::kinds::{Example, HasExamples};
use crate::materials::microfacet::orthonormal_basis;
use crate::nodes::{NodeError, snake_case};
use crate::real::{Real, Vec3, bundle};
use crate::seek::Seek;
use crate::values::{Color, FullAngle, Strength};

/// A light as it arrives at a place.
#[derive(Clone, Copy, Debug)]
pub struct LightSample<R> {
    /// Toward the light, of length 1.
    pub direction: Vec3<R>,
    /// Its linear RGB there; 0 in shadow.
    pub radiance: Vec3<R>,
}

bundle!(LightSample { direction, radiance });

/// Light from all directions at once.
#[derive(Clone, Copy, Debug)]
pub struct AmbientLight<'a> {
    /// What shines.
    pub from: &'a Background,
    /// How bright it is beside what is seen of it.
    pub strength: f32,
}

/// What a light means.
pub trait LightSource {
    /// How the light arrives at `p` with nothing in its way, and how far it has come
    /// (at most `farthest`, for light from far away). Of a light with a size, the point that the pair
    /// of numbers from 0 to 1 tells. `None` of light from all around, and of the sun of no day.
    fn sample<R: Real>(
        &self,
        p: Vec3<R>,
        farthest: R,
        day: Option<&Day>,
        pair: impl FnOnce() -> (R, R),
    ) -> Option<(LightSample<R>, R)>;

    /// Light from all directions before this background, if that is what it is.
    fn ambient<'a>(&'a self, background: &'a Background) -> Option<AmbientLight<'a>> {
        let _ = background;
        None
    }

    /// Whether things cast shadows in it.
    fn casts_shadows(&self) -> bool;

    /// Whether it is black in every frame: a scene with no other lights gets a warning.
    fn is_dark(&self) -> bool;

    /// What is wrong with it before this background, if anything.
    fn validate(&self, background: &Background) -> Option<NodeError> {
        let _ = background;
        None
    }

    /// Finds what all places share.
    fn precompute(&mut self) {}
}

/// The list: each light's name, and its struct.
macro_rules! lights {
    ($($(#[$attribute:meta])* $Kind:ident: $Struct:ident),* $(,)?) => {
        /// A light: keyed by its name.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
        #[serde(rename_all = "snake_case")]
        pub enum Light {
            $($(#[$attribute])* #[doc = concat!("See [`", stringify!($Struct), "`].")] $Kind($Struct)),*
        }

        impl LightSource for Light {
            #[inline(always)]
            fn sample<R: Real>(
                &self,
                p: Vec3<R>,
                farthest: R,
                day: Option<&Day>,
                pair: impl FnOnce() -> (R, R),
            ) -> Option<(LightSample<R>, R)> {
                match self { $($(#[$attribute])* Self::$Kind(light) => light.sample(p, farthest, day, pair)),* }
            }

            fn ambient<'a>(&'a self, background: &'a Background) -> Option<AmbientLight<'a>> {
                match self { $($(#[$attribute])* Self::$Kind(light) => light.ambient(background)),* }
            }

            fn casts_shadows(&self) -> bool {
                match self { $($(#[$attribute])* Self::$Kind(light) => light.casts_shadows()),* }
            }

            fn is_dark(&self) -> bool {
                match self { $($(#[$attribute])* Self::$Kind(light) => light.is_dark()),* }
            }

            /// The same, at its place in the light's JSON.
            fn validate(&self, background: &Background) -> Option<NodeError> {
                match self {
                    $($(#[$attribute])* Self::$Kind(light) => {
                        light.validate(background).map(|validate| validate.inside(&snake_case(stringify!($Kind))))
                    })*
                }
            }

            fn precompute(&mut self) {
                match self { $($(#[$attribute])* Self::$Kind(light) => light.precompute()),* }
            }
        }

        impl Light {
            /// Each kind's examples, as a user would write the whole light.
            pub fn examples() -> Vec<Example> {
                let mut examples = Vec::new();
                $(
                    $(#[$attribute])*
                    examples.extend(Example::keyed::<$Struct>(stringify!($Struct), stringify!($Kind)));
                )*
                examples
            }
        }
    };
}

lights![
    Directional: Directional,
    Point: PointLight,
    Spot: SpotLight,
    Sphere: SphereLight,
    Sun: Sun,
    Sky: SkyLight,
    #[cfg(test)]
    Added: AddedLight,
];

/// A direction inside a cone of this whole angle, each as likely as any other.
#[inline(always)]
fn sample_cone<R: Real>(like: R, axis: Vec3<f32>, angle: &FullAngle, pair: impl FnOnce() -> (R, R)) -> Vec3<R> {
    if angle.is_zero() {
        return Vec3::uniform(like, axis);
    }
    let (u, v) = pair();
    let half = Real::sin(angle.get() * (std::f32::consts::PI / 720.0));
    // 1 − cos θ, evenly from 0 to 1 − cos(angle/2) = 2 sin²(angle/4).
    let versine = u * like.uniform(2.0 * half * half);
    let (right, up) = orthonormal_basis(axis);
    direction_around(Vec3::uniform(like, axis), Vec3::uniform(like, right), Vec3::uniform(like, up), versine, v)
}

/// The direction at a versine (1 − cosine) from an axis and a share of a turn around it.
#[inline(always)]
pub(crate) fn direction_around<R: Real>(axis: Vec3<R>, right: Vec3<R>, up: Vec3<R>, versine: R, turn: R) -> Vec3<R> {
    let (sine, cosine) = (turn * std::f32::consts::TAU).sin_cos();
    let away = (versine * (versine.constant(2.0) - versine)).sqrt();
    let along = axis.mul_add(versine.constant(1.0) - versine, right * (away * cosine));
    up.mul_add(away * sine, along)
}

/// The lights of a scene that names none.
pub(crate) fn default_lights() -> Vec<Light> {
    let direction = serde_json::from_str("[0.6, 0.7, 0.5]").expect("a direction");
    vec![Light::Directional(Directional { direction, color: default_color(), angle: default_angle(), shadow: true })]
}

pub(crate) fn default_color() -> Color {
    Color::new(1.0, 1.0, 1.0)
}

pub(crate) fn default_shadow() -> bool {
    true
}

fn default_strength() -> Strength {
    Strength::new(1.0).expect("1 is in range")
}

fn default_angle() -> FullAngle {
    FullAngle::new(0.0).expect("0 is in range")
}
