//! The family of lights, and the trait that each light implements.
//!
//! A light is one documented struct in a file under `lights/`, one `impl` of [`LightSource`], and one entry in the list.
//! A matte white surface that faces a light reflects the light's color: the color is its irradiance over π. Area lights
//! are sampled: each pixel sample takes one point on the light.

#[cfg(feature = "added")]
mod added;
mod body;
mod directional;
mod flat;
mod local;
mod placed;
mod point;
mod sky_light;
mod sun;

#[cfg(feature = "added")]
pub use added::AddedLight;
pub use body::{LightBody, LightShape, NEVER};
pub use directional::Directional;
pub use flat::{DiscLight, RectangleLight};
pub use local::{SphereLight, SpotLight};
pub use placed::PlacedLight;
pub use point::PointLight;
pub use sky_light::SkyLight;
pub use sun::Sun;

use crate::backgrounds::{Background, Day};
use crate::kinds::{NodeError, family};
use crate::light_groups::LightGroup;
pub use crate::materials::LightSample;
use crate::materials::microfacet::orthonormal_basis;
use crate::real::{Real, Vec3};
use crate::values::{Color, FullAngle, Point, Strength};

/// Ambient light: from all directions at once.
#[derive(Clone, Copy, Debug)]
pub struct AmbientLight<'a> {
    /// Background that emits the light.
    pub from: &'a Background,
    /// Factor of the background's radiance.
    pub strength: f32,
}

/// Properties that all lights have.
#[derive(Clone, Copy, Debug)]
pub struct LightOptions<'a> {
    /// Its light group, if it has one.
    pub group: Option<&'a LightGroup>,
    /// Whether objects cast shadows in this light.
    pub casts_shadows: bool,
    /// Whether the light is black in every frame. If all lights are, the scene gets a warning.
    pub is_dark: bool,
}

family! {
    /// A light: an object whose member is the light's name.
    pub enum Light {
        Directional(Directional),
        Point(PointLight),
        Spot(SpotLight),
        Sphere(SphereLight),
        Rectangle(RectangleLight),
        Disc(DiscLight),
        Sun(Sun),
        Sky(SkyLight),
        #[cfg(feature = "added")]
        Added(AddedLight),
    }

    /// Behavior of a light.
    pub trait LightSource {
        /// Light that arrives at `p` unoccluded, and its distance, which is `farthest` for distant lights. For an area
        /// light, the pair of numbers from 0 to 1 chooses the point on the light. `None` for ambient light, and for a sun
        /// if the background is not a day.
        fn sample<R: Real>(
            &self,
            p: Vec3<R>,
            farthest: R,
            day: Option<&Day>,
            pair: impl FnOnce() -> (R, R),
        ) -> Option<(LightSample<R>, R)>;

        /// The properties that all lights have.
        fn options(&self) -> LightOptions<'_>;

        /// Center and radius of a ball around it, if it has a place.
        fn place(&self) -> Option<(Vec3<f32>, f32)> = None;

        /// Its shape and radiance, if it is seen.
        fn body(&self) -> Option<LightBody> = None;

        /// About how much light arrives at `p` unoccluded, never 0 where some does: a light is chosen by it.
        fn strength<R: Real>(&self, p: Vec3<R>, day: Option<&Day>) -> R;

        /// Whether it is light of the environment, which has no place of its own.
        fn is_of_environment(&self) -> bool = false;

        /// Error in the light's parameters with this background, if there is one.
        fn validate(&self, background: &Background) -> Option<NodeError> = None;

        /// Precomputes values that all points use.
        fn precompute(&mut self) = ();
    }
}

impl Light {
    /// Error in the light's parameters with this background, with its pointer in the light's JSON.
    pub(crate) fn fault(&self, background: &Background) -> Option<NodeError> {
        self.validate(background).map(|error| error.inside(self.name()))
    }
}

/// Direction inside a cone of this full angle, with uniform probability.
fn sample_cone<R: Real>(like: R, axis: Vec3<f32>, angle: &FullAngle, pair: impl FnOnce() -> (R, R)) -> Vec3<R> {
    if angle.is_zero() {
        return Vec3::uniform(like, axis);
    }
    let (u, v) = pair();
    let half = Real::sin(angle.in_frame() * (std::f32::consts::PI / 720.0));
    // 1 − cos θ, uniform from 0 to 1 − cos(angle/2) = 2 sin²(angle/4).
    let versine = u * like.uniform(2.0 * half * half);
    let (right, up) = orthonormal_basis(axis);
    direction_around(Vec3::uniform(like, axis), Vec3::uniform(like, right), Vec3::uniform(like, up), versine, v)
}

/// Direction from a versine (1 − cosine) to an axis, and an angle around it as a fraction of a revolution.
pub fn direction_around<R: Real>(axis: Vec3<R>, right: Vec3<R>, up: Vec3<R>, versine: R, turn: R) -> Vec3<R> {
    let (sine, cosine) = (turn * std::f32::consts::TAU).sin_cos();
    let away = (versine * (versine.constant(2.0) - versine)).sqrt();
    let along = axis.mul_add(versine.constant(1.0) - versine, right * (away * cosine));
    up.mul_add(away * sine, along)
}

/// Strength at `p` of a light of some color and size around a point.
fn strength_of_point<R: Real>(p: Vec3<R>, position: &Point, color: &Color, size: f32) -> R {
    let square = (Vec3::uniform(p.x, position.get()) - p).length_squared();
    p.x.uniform(color.in_frame().mean()) / square.at_least(1e-12).max(p.x.uniform(size * size))
}

/// The lights of a scene without a `lights` member.
pub fn default_lights() -> Vec<Light> {
    let direction = serde_json::from_str("[0.6, 0.7, 0.5]").expect("a direction");
    vec![Light::Directional(Directional {
        direction,
        color: default_color(),
        angle: default_angle(),
        shadow: true,
        group: None,
    })]
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
