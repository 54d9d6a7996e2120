//! Medium materials inside a shape: clouds and volumes.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use super::bsdf::{Bsdf, Lobes};
use super::microfacet::MIN_ALPHA;
use super::{IncidentLight, Shade, ShadingPoint, SpecularBsdf};
use crate::limits::{MAX_LIGHT_STEPS, MAX_MEDIUM_STEPS};
use crate::noise::Noise;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Anisotropy, Color, Density, Fraction, LengthOrZero, integer_in_range};

/// Clouds as Robles, Lee, Yin and Dhar draw them, "Procedural Rendering with Ray Marching": noise on a
/// surface, or summed along the ray inside the shape.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Clouds {
    /// Density of the clouds by place; its range is mapped to 0 to 1.
    pub noise: Noise,
    /// Whether the noise is on the surface or inside the shape.
    #[serde(default)]
    pub mapping: Mapping,
    /// Color of the clouds. On a surface it is lit like that of `diffuse`.
    #[serde(default = "default_color")]
    pub color: Color,
    /// Inside a shape: the extinction coefficient where the noise is 1, per scene unit.
    #[serde(default = "default_density")]
    pub density: Density,
    /// Noise below this is clear air.
    #[serde(default = "default_threshold")]
    pub threshold: Fraction,
    /// Inside a shape: steps of a ray from corner to corner of its bounds.
    #[serde(default = "default_cloud_steps", deserialize_with = "steps")]
    #[schemars(range(min = 1, max = MAX_MEDIUM_STEPS))]
    pub steps: u32,
}

/// Location of the clouds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum Mapping {
    /// On the surface.
    Surface,
    /// Inside the shape.
    #[default]
    Depth,
}

/// A medium inside an object that scatters and absorbs light: smoke, mist, lit clouds.
///
/// With the integrator `path`, light is scattered any number of times; `orders`, `steps` and `light_steps` have no effect
/// then. With `direct`, transmittance follows the Beer-Lambert law, with single scattering by the phase function of
/// L. G. Henyey and J. L. Greenstein, "Diffuse radiation in the galaxy", Astrophysical Journal 93, 1941. Further orders
/// are approximated as in Magnus Wrenninge et al., "Oz: the great and volumetric", SIGGRAPH 2013 talks: each order has
/// half the light of the previous one, half its optical depth, and half its anisotropy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Volume {
    /// The extinction coefficient at full density, per scene unit.
    pub density: Density,
    /// Noise that varies the density; uniform when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<Noise>,
    /// Fraction of the noise's range that counts as filled.
    #[serde(default = "default_coverage")]
    pub coverage: Fraction,
    /// Depth below its shape's surface at which it reaches full density, in scene units.
    #[serde(default = "default_edge")]
    pub edge: LengthOrZero,
    /// Fraction of the light that is scattered and not absorbed, by channel.
    #[serde(default = "default_color")]
    pub albedo: Color,
    /// Anisotropy: above 0 light is scattered forward, below 0 back.
    #[serde(default = "default_anisotropy")]
    pub anisotropy: Anisotropy,
    /// Orders of scattering: 1 is exact, more are approximated and brighter.
    #[serde(default = "default_orders", deserialize_with = "orders")]
    #[schemars(range(min = 1, max = MAX_ORDERS))]
    pub orders: u32,
    /// Emitted light.
    #[serde(default = "default_emission")]
    pub emission: Color,
    /// Steps of a ray from corner to corner of its shape's bounds.
    #[serde(default = "default_volume_steps", deserialize_with = "steps")]
    #[schemars(range(min = 1, max = MAX_MEDIUM_STEPS))]
    pub steps: u32,
    /// Steps of a ray toward a light.
    #[serde(default = "default_light_steps", deserialize_with = "light_steps")]
    #[schemars(range(min = 1, max = MAX_LIGHT_STEPS))]
    pub light_steps: u32,
}

const MAX_ORDERS: u32 = 8;

/// Medium inside an object.
#[derive(Clone, Copy, Debug)]
pub enum MediumMaterial<'a> {
    /// Clouds inside a shape.
    Clouds(&'a Clouds),
    /// A volume.
    Volume(&'a Volume),
}

/// How a medium scatters paths of light.
#[derive(Clone, Copy, Debug)]
pub struct MediumScattering {
    /// Fraction of the light that goes on.
    pub albedo: Vec3<f32>,
    /// Emitted radiance per unit of extinction.
    pub emission: Vec3<f32>,
    /// The mean cosine of scattered light.
    pub anisotropy: f32,
}

impl MediumMaterial<'_> {
    /// Number of steps of a ray.
    pub fn steps(&self) -> u32 {
        match self {
            Self::Clouds(clouds) => clouds.steps,
            Self::Volume(volume) => volume.steps,
        }
    }

    /// The extinction coefficient at full density.
    pub fn density(&self) -> f32 {
        match self {
            Self::Clouds(clouds) => clouds.density.in_frame(),
            Self::Volume(volume) => volume.density.in_frame(),
        }
    }

    /// Number of steps of a ray to a light.
    pub fn light_steps(&self) -> u32 {
        match self {
            Self::Clouds(_) => 1,
            Self::Volume(volume) => volume.light_steps,
        }
    }

    /// Extinction coefficient at a point at this depth inside the shape.
    pub fn extinction<R: Real>(&self, p: Vec3<R>, depth: R) -> R {
        match self {
            Self::Clouds(clouds) => clouds.density_at(p) * p.x.uniform(clouds.density.get()),
            Self::Volume(volume) => volume.extinction(p, depth),
        }
    }

    /// Emission per unit of extinction.
    pub fn emission<R: Real>(&self, like: R) -> Vec3<R> {
        match self {
            Self::Clouds(clouds) => Vec3::uniform(like, clouds.color.get()),
            Self::Volume(volume) => Vec3::uniform(like, volume.emission.get()),
        }
    }

    /// How paths are scattered.
    pub fn scattering(&self) -> MediumScattering {
        let black = vec3(0.0, 0.0, 0.0);
        match self {
            Self::Clouds(clouds) => {
                MediumScattering { albedo: clouds.color.in_frame(), emission: black, anisotropy: 0.0 }
            }
            Self::Volume(volume) => MediumScattering {
                albedo: volume.albedo.in_frame(),
                emission: volume.emission.in_frame(),
                anisotropy: volume.anisotropy.in_frame(),
            },
        }
    }

    /// The volume, if it scatters light.
    pub fn as_scattering(&self) -> Option<&Volume> {
        match self {
            Self::Clouds(_) => None,
            Self::Volume(volume) => Some(volume),
        }
    }
}

/// Noise value at `p`, scaled from its range to 0 to 1.
fn normalized_noise<R: Real>(noise: &Noise, p: Vec3<R>) -> R {
    let (low, high) = noise.range();
    let per_range = 1.0 / (high - low).max(1e-6);
    noise.value(p).mul_add(p.x.uniform(per_range), p.x.uniform(-low * per_range)).at_least(0.0).at_most(1.0)
}

/// Excess of a fraction above a threshold, scaled to 0 to 1.
fn above_threshold<R: Real>(share: R, threshold: f32) -> R {
    let per_rest = 1.0 / (1.0 - threshold).max(1e-3);
    share.mul_add(share.uniform(per_rest), share.uniform(-threshold * per_rest)).at_least(0.0)
}

impl Clouds {
    /// Density at `p`, 0 to 1.
    fn density_at<R: Real>(&self, p: Vec3<R>) -> R {
        above_threshold(normalized_noise(&self.noise, p), self.threshold.in_frame())
    }
}

impl Shade for Clouds {
    const ALIASES: &'static [&'static str] = &["cloud"];
    const EXAMPLE: &'static str =
        r#"{ "noise": { "perlin": { "scale": 2, "octaves": 4 } }, "density": 6, "threshold": 0.35 }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "noise": { "perlin": { "scale": 2, "octaves": 4 } }, "mapping": "surface", "threshold": 0.4 }"#,
        r#"{ "noise": { "gardner": {} }, "density": 4 }"#,
        r#"{ "noise": { "gardner": {} }, "mapping": "surface" }"#,
    ];

    fn shade<R: Real>(&self, place: &ShadingPoint<R>, light: &IncidentLight<R>) -> Vec3<R> {
        const AMBIENT: f32 = 0.1;
        let like = place.camera_t;
        let ambient = light.ambient_visibility.map_or(like.constant(AMBIENT), |openness| openness * AMBIENT);
        let mut sum = vec3(ambient, ambient, ambient);
        if let Some(around) = light.ambient {
            sum = sum + around;
        }
        for light in &light.lights {
            let facing = place.normal.dot(light.direction).at_least(0.0);
            sum = light.radiance.mul_add(facing, sum);
        }
        sum.mul_elementwise(Vec3::uniform(like, self.color.get())) * self.coverage_at(place)
    }

    fn albedo<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        Vec3::uniform(place.camera_t, self.color.get())
    }

    /// Lit like a surface after Lambert where it is covered, and clear elsewhere.
    fn bsdf<R: Real>(&self, place: &ShadingPoint<R>) -> Bsdf<R> {
        let (one, covered) = (place.camera_t.constant(1.0), self.coverage_at(place));
        let passed = one - covered;
        Bsdf {
            diffuse: self.albedo(place) * covered,
            transmission: vec3(passed, passed, passed),
            alpha: one.constant(MIN_ALPHA),
            ..Bsdf::black(one)
        }
    }

    fn lobes(&self) -> Lobes {
        Lobes { reflection: true, transmission: true, ..Lobes::default() }
    }

    fn is_lit(&self) -> bool {
        true
    }

    fn specular<R: Real>(&self, place: &ShadingPoint<R>) -> Option<SpecularBsdf<R>> {
        let (zero, one) = (place.camera_t.constant(0.0), place.camera_t.constant(1.0));
        let passed = one - self.coverage_at(place);
        Some(SpecularBsdf {
            f0: vec3(zero, zero, zero),
            roughness: zero,
            transmission: vec3(passed, passed, passed),
            ior: one,
        })
    }

    fn is_specular(&self) -> bool {
        true
    }

    fn is_transmissive(&self) -> bool {
        true
    }

    fn uses_lights(&self) -> bool {
        self.as_medium().is_none()
    }

    fn is_black_without_light(&self) -> bool {
        self.as_medium().is_none()
    }

    fn as_medium(&self) -> Option<MediumMaterial<'_>> {
        (self.mapping == Mapping::Depth).then_some(MediumMaterial::Clouds(self))
    }

    fn is_textured(&self) -> bool {
        true
    }
}

impl Clouds {
    /// Fraction of a surface covered by clouds; 0 from inside.
    fn coverage_at<R: Real>(&self, place: &ShadingPoint<R>) -> R {
        R::select(place.is_inside.0, place.camera_t.constant(0.0), self.density_at(place.local_point).at_most(1.0))
    }
}

impl Volume {
    fn extinction<R: Real>(&self, p: Vec3<R>, depth: R) -> R {
        let mut thick = p.x.uniform(self.density.get());
        if !self.edge.is_zero() {
            thick = thick * (depth * p.x.uniform(1.0 / self.edge.in_frame().max(1e-6))).at_least(0.0).at_most(1.0);
        }
        match &self.noise {
            None => thick,
            Some(noise) => above_threshold(normalized_noise(noise, p), 1.0 - self.coverage.in_frame()) * thick,
        }
    }

    /// Fraction of a light's color scattered by an angle of this cosine, through this optical depth. The light's color
    /// is over π, and the phase function over 4π.
    pub fn phase<R: Real>(&self, cosine: R, depth: R) -> R {
        let mut sum = cosine.constant(0.0);
        let mut share = 1.0;
        for _ in 0..self.orders {
            let g = self.anisotropy.in_frame() * share;
            let below = (cosine * cosine.uniform(-2.0 * g) + cosine.uniform(1.0 + g * g)).at_least(1e-4);
            let phase = cosine.uniform(0.25 * (1.0 - g * g)) / (below * below.sqrt());
            let left = (-(depth * share)).exp() * share;
            sum = phase.mul_add(left, sum);
            share *= 0.5;
        }
        sum
    }

    /// Fraction of the light that is scattered.
    pub fn scattering_albedo<R: Real>(&self, like: R) -> Vec3<R> {
        Vec3::uniform(like, self.albedo.get())
    }
}

impl Shade for Volume {
    const EXAMPLE: &'static str = r#"{ "density": 14, "noise": { "perlin": { "scale": 2, "octaves": 4 } }, "edge": 0.3, "anisotropy": 0.3, "orders": 4 }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "density": 1.5, "albedo": [0.9, 0.5, 0.3] }"#,
        r#"{ "density": 2, "edge": 0.5, "emission": [1.5, 0.4, 0.1] }"#,
    ];

    fn shade<R: Real>(&self, place: &ShadingPoint<R>, _: &IncidentLight<R>) -> Vec3<R> {
        Vec3::uniform(place.camera_t, self.emission.get())
    }

    fn albedo<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        Vec3::uniform(place.camera_t, self.albedo.get())
    }

    fn bsdf<R: Real>(&self, place: &ShadingPoint<R>) -> Bsdf<R> {
        Bsdf::black(place.camera_t)
    }

    fn is_lit(&self) -> bool {
        false
    }

    fn uses_lights(&self) -> bool {
        !self.albedo.is_black()
    }

    fn is_black_without_light(&self) -> bool {
        self.emission.is_black()
    }

    fn as_medium(&self) -> Option<MediumMaterial<'_>> {
        Some(MediumMaterial::Volume(self))
    }
}

fn default_color() -> Color {
    Color::new(1.0, 1.0, 1.0)
}

fn default_emission() -> Color {
    Color::new(0.0, 0.0, 0.0)
}

fn default_density() -> Density {
    Density::new(2.0).expect("2 is in range")
}

fn default_threshold() -> Fraction {
    Fraction::new(0.0).expect("0 is in range")
}

fn default_coverage() -> Fraction {
    Fraction::new(0.5).expect("0.5 is in range")
}

fn default_edge() -> LengthOrZero {
    LengthOrZero::new(0.0).expect("0 is in range")
}

fn default_anisotropy() -> Anisotropy {
    Anisotropy::new(0.0).expect("0 is in range")
}

fn default_orders() -> u32 {
    1
}

fn default_light_steps() -> u32 {
    8
}

fn default_cloud_steps() -> u32 {
    32
}

fn default_volume_steps() -> u32 {
    48
}

fn steps<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 1, MAX_MEDIUM_STEPS, "steps")
}

fn light_steps<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 1, MAX_LIGHT_STEPS, "steps")
}

fn orders<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 1, MAX_ORDERS, "orders")
}
