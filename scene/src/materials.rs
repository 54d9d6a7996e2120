//! What surfaces look like: the list of materials, and what a material must say of itself.
//!
//! Like a node, a material is one documented struct, one `impl` of [`Shade`] and one word in the list.

mod volume;

use std::borrow::Cow;
use std::collections::BTreeMap;
mod diffuse;
mod material_use;
pub mod microfacet;
mod plain;
mod surface;
pub mod texture;
mod tint;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use diffuse::Diffuse;
pub use material_use::MaterialUse;
pub use plain::{Flat, Normals};
pub use surface::Surface;
pub use texture::Texture;
pub use tint::{Level, Parameter, Tint, Varied};

use crate::lights::Incoming;
use crate::nodes::snake_case;
use crate::real::{Flag, Real, Vec3, bundle};

pub(crate) use volume::Filling;
pub use volume::{Clouds, Volume};

/// What a material needs to know of the place it colours.
#[derive(Clone, Copy, Debug)]
pub struct Place<R: Real> {
    /// The surface's normal, of length 1, towards the viewer's side.
    pub normal: Vec3<R>,
    /// The direction to the viewer, of length 1.
    pub to_viewer: Vec3<R>,
    /// The point as textures see it: in the space of the `paint` that says the material, else in the scene's.
    pub point: Vec3<R>,
    /// The normal in that space.
    pub own_normal: Vec3<R>,
    /// Distance from the camera, along the ray.
    pub distance: R,
    /// Whether the surface is seen from inside its shape.
    pub inside: Flag<R>,
}

/// The light that arrives at a place.
#[derive(Clone, Debug, Default)]
pub struct Lighting<R> {
    /// Light from single directions.
    pub lights: Vec<Incoming<R>>,
    /// Light from all around, as a white matt surface would send it back; `None` where there is none.
    pub surrounding: Option<Vec3<R>>,
    /// How open the place is to light from all around, 0 to 1; `None` where nobody asks.
    pub openness: Option<R>,
}

/// How a surface sends a ray on, beside what it scatters of the lights.
#[derive(Clone, Copy, Debug)]
pub struct Finish<R> {
    /// Share of the light that is mirrored when it arrives along the normal, by channel (Fresnel's F0).
    pub mirrored: Vec3<R>,
    /// Roughness, 0 to 1: the square root of the GGX model's α.
    pub roughness: R,
    /// Share of the light that is not mirrored which goes through, by channel.
    pub passed: Vec3<R>,
    /// Index of refraction inside over that outside.
    pub ior: R,
}

bundle!(Finish { mirrored, roughness, passed, ior });

/// What a material means.
pub trait Shade {
    /// The light that leaves the surface towards the viewer, linear RGB.
    fn shade<R: Real>(&self, place: &Place<R>, light: &Lighting<R>) -> Vec3<R>;

    /// The surface's own colour, without light: the `albedo` layer.
    fn albedo<R: Real>(&self, place: &Place<R>) -> Vec3<R>;

    /// Whether `shade` looks at the lights at all.
    fn is_lit(&self) -> bool;

    /// How it sends rays on; `None` if it never does.
    fn finish<R: Real>(&self, place: &Place<R>) -> Option<Finish<R>> {
        let _ = place;
        None
    }

    /// Whether `finish` ever sends a ray on.
    fn sends_on(&self) -> bool {
        false
    }

    /// Whether a ray may get inside the shape.
    fn lets_through(&self) -> bool {
        false
    }

    /// Whether it fills an object instead of covering it.
    fn is_medium(&self) -> bool {
        false
    }

    /// Whether it looks at `Place::point`.
    fn is_textured(&self) -> bool {
        false
    /// The textures that its parameters have.
    fn textures(&self) -> Vec<&Texture> {
        Vec::new()
    }

    /// Whether it looks at `Place::own_normal`, which is dear to find.
    fn needs_own_normal(&self) -> bool {
        self.textures().into_iter().any(Texture::needs_own_normal)
    }
}

/// What a material or a texture shows of itself.
pub trait Exemplary {
    /// A small valid value, as a user would write it: the picture in docs/materials.md and the contract tests use it.
    const EXAMPLE: &'static str;

    /// Further values that take other ways through the formula, drawn and tested like the first.
    const MORE: &'static [&'static str] = &[];
}

/// A material or a texture to look at and to test with.
#[derive(Clone, Debug)]
pub struct Example {
    /// Its type, as in the schema.
    pub kind: &'static str,
    /// Its name in JSON.
    pub name: String,
    /// Its place among the examples of its type, from 0.
    pub number: usize,
    /// Its JSON.
    pub json: String,
}

impl Example {
    /// The examples of one type, each under its name.
    fn of<E: Exemplary>(kind: &'static str, name: &str) -> impl Iterator<Item = Self> {
        std::iter::once(&E::EXAMPLE).chain(E::MORE).enumerate().map(move |(number, value)| Self {
            kind,
            name: name.to_owned(),
            number,
            json: format!("{{ \"{name}\": {value} }}"),
        })
    }
}

macro_rules! materials {
    ($($Kind:ident),* $(,)?) => {
        /// How a surface answers light: keyed by its name.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum Material {
            $(#[doc = concat!("See [`", stringify!($Kind), "`].")] $Kind($Kind)),*
        }

        impl Shade for Material {
            #[inline(always)]
            fn shade<R: Real>(&self, place: &Place<R>, light: &Lighting<R>) -> Vec3<R> {
                match self { $(Self::$Kind(material) => material.shade(place, light)),* }
            }

            #[inline(always)]
            fn albedo<R: Real>(&self, place: &Place<R>) -> Vec3<R> {
                match self { $(Self::$Kind(material) => material.albedo(place)),* }
            }

            fn is_lit(&self) -> bool {
                match self { $(Self::$Kind(material) => material.is_lit()),* }
            }

            #[inline(always)]
            fn finish<R: Real>(&self, place: &Place<R>) -> Option<Finish<R>> {
                match self { $(Self::$Kind(material) => material.finish(place)),* }
            }

            fn sends_on(&self) -> bool {
                match self { $(Self::$Kind(material) => material.sends_on()),* }
            }

            fn lets_through(&self) -> bool {
                match self { $(Self::$Kind(material) => material.lets_through()),* }
            }

            fn is_medium(&self) -> bool {
                match self { $(Self::$Kind(material) => material.is_medium()),* }
            }

            fn is_textured(&self) -> bool {
                match self { $(Self::$Kind(material) => material.is_textured()),* }
            fn textures(&self) -> Vec<&Texture> {
                match self { $(Self::$Kind(material) => material.textures()),* }
            }

            fn needs_own_normal(&self) -> bool {
                match self { $(Self::$Kind(material) => material.needs_own_normal()),* }
            }
        }

        impl Material {
            /// Each kind's examples, as a user would write the whole material.
            pub fn examples() -> Vec<Example> {
                let mut examples = Vec::new();
                $(examples.extend(Example::of::<$Kind>(stringify!($Kind), &snake_case(stringify!($Kind))));)*
                examples
            }
        }
    };
}

materials![Flat, Normals, Diffuse, Clouds, Volume];

/// One colour, whatever the light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Flat {
    /// The colour.
    pub color: Color,
}

impl Shade for Flat {
    #[inline(always)]
    fn shade<R: Real>(&self, place: &Place<R>, _: &Lighting<R>) -> Vec3<R> {
        self.albedo(place)
    }

    #[inline(always)]
    fn albedo<R: Real>(&self, place: &Place<R>) -> Vec3<R> {
        Vec3::given(place.normal.x, self.color.get())
    }

    fn is_lit(&self) -> bool {
        false
    }
}

/// The normal N as a colour: (N + 1)/2.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Normals {}

impl Shade for Normals {
    #[inline(always)]
    fn shade<R: Real>(&self, place: &Place<R>, _: &Lighting<R>) -> Vec3<R> {
        self.albedo(place)
    }

    #[inline(always)]
    fn albedo<R: Real>(&self, place: &Place<R>) -> Vec3<R> {
        place.normal.map(
            #[inline(always)]
            |c| c.mul_add(c.splat(0.5), c.splat(0.5)),
        )
    }

    fn is_lit(&self) -> bool {
        false
    }
}

/// Phong's model: ka·ambient + Σ lights: kd·le·(N·L) + ks·le·(R·E)^shininess, on both sides.
///
/// Bui Tuong Phong, "Illumination for computer generated pictures", CACM 18(6), 1975.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Diffuse {
    /// Colour of scattered light.
    #[serde(default = "default_kd")]
    pub kd: Color,
    /// Colour of the highlight.
    #[serde(default = "black")]
    pub ks: Color,
    /// Colour of ambient light's answer; as `kd` when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ka: Option<Color>,
    /// Ambient light.
    #[serde(default = "default_ambient")]
    pub ambient: Color,
    /// How narrow the highlight is.
    #[serde(default = "default_shininess")]
    pub shininess: Shininess,
}

impl Shade for Diffuse {
    #[inline(always)]
    fn shade<R: Real>(&self, place: &Place<R>, light: &Lighting<R>) -> Vec3<R> {
        let like = place.normal.x;
        let (kd, ks) = (Vec3::given(like, self.kd.get()), self.ks.get());
        let (ka, la) = (self.ka.unwrap_or(self.kd).get(), self.ambient.get());
        let mut sum = Vec3::given(like, vec3(ka.x * la.x, ka.y * la.y, ka.z * la.z));
        if let Some(openness) = light.openness {
            sum = sum * openness;
        }
        if let Some(around) = light.surrounding {
            sum = vec3(kd.x.mul_add(around.x, sum.x), kd.y.mul_add(around.y, sum.y), kd.z.mul_add(around.z, sum.z));
        }
        for light in &light.lights {
            let facing = place.normal.dot(light.direction).at_least(0.0);
            let scattered = light.radiance * facing;
            sum = vec3(
                kd.x.mul_add(scattered.x, sum.x),
                kd.y.mul_add(scattered.y, sum.y),
                kd.z.mul_add(scattered.z, sum.z),
            );
            if !self.ks.is_black() {
                let mirrored = place.normal.mul_add(facing + facing, -light.direction);
                let towards = mirrored.dot(place.to_viewer).at_least(0.0);
                let highlight = towards.powf(like.given(self.shininess.get()));
                let highlight = R::select(facing.above(0.0), highlight, like.splat(0.0));
                let glossy = light.radiance * highlight;
                let ks = Vec3::given(like, ks);
                sum = vec3(ks.x.mul_add(glossy.x, sum.x), ks.y.mul_add(glossy.y, sum.y), ks.z.mul_add(glossy.z, sum.z));
            }
        }
        sum
    }

    #[inline(always)]
    fn albedo<R: Real>(&self, place: &Place<R>) -> Vec3<R> {
        Vec3::given(place.normal.x, self.kd.get())
    }

    fn is_lit(&self) -> bool {
        true
    }
}

fn default_kd() -> Color {
    Color::new(0.8, 0.8, 0.8)
}

fn white() -> Color {
    Color::new(1.0, 1.0, 1.0)
}

fn black() -> Color {
    Color::new(0.0, 0.0, 0.0)
}

fn default_ambient() -> Color {
    Color::new(0.1, 0.1, 0.1)
}

fn default_shininess() -> Shininess {
    Shininess::new(16.0).expect("16 is in range")
}

/// A material where it is used: a name from the scene's `materials`, or one in place.
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialUse {
    given: Given,
    slot: u32,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
enum Given {
    Name(String),
    InPlace(Material),
}

impl MaterialUse {
    /// Which of the scene's materials in use it is.
    #[inline(always)]
    pub fn slot(&self) -> u32 {
        self.slot
    }

    /// Gives it a slot in `used`, the materials in use so far; the name if there is no such material.
    pub(crate) fn resolve(
        &mut self,
        named: &BTreeMap<String, Material>,
        used: &mut Vec<Material>,
        slots: &mut BTreeMap<String, u32>,
    ) -> Result<(), String> {
        self.slot = match &self.given {
            Given::Name(name) => {
                let material = named.get(name).ok_or_else(|| name.clone())?;
                *slots.entry(name.clone()).or_insert_with(|| new_slot(used, material))
            }
            Given::InPlace(material) => new_slot(used, material),
        };
        Ok(())
    }

    /// The same use, named by its slot: what a scene's key is made of.
    pub(crate) fn canonical(&self) -> Self {
        Self { given: Given::Name(self.slot.to_string()), slot: self.slot }
    }
}

fn new_slot(used: &mut Vec<Material>, material: &Material) -> u32 {
    used.push(material.clone());
    used.len() as u32 - 1
}

/// Reads a name or a material; faults inside a material keep their place.
struct MaterialUseVisitor;

impl<'de> Visitor<'de> for MaterialUseVisitor {
    type Value = MaterialUse;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("the name of a material, or a material in place")
    }

    fn visit_str<E>(self, name: &str) -> Result<MaterialUse, E> {
        Ok(MaterialUse { given: Given::Name(name.to_owned()), slot: 0 })
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<MaterialUse, A::Error> {
        let material = Material::deserialize(MapAccessDeserializer::new(map))?;
        Ok(MaterialUse { given: Given::InPlace(material), slot: 0 })
    }
}

impl<'de> Deserialize<'de> for MaterialUse {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(MaterialUseVisitor)
    }
}

impl Serialize for MaterialUse {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.given.serialize(serializer)
    }
}

impl JsonSchema for MaterialUse {
    fn schema_name() -> Cow<'static, str> {
        "MaterialUse".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let material = generator.subschema_for::<Material>();
        json_schema!({
            "description": "The name of an entry of `materials`, or a material in place.",
            "anyOf": [{ "type": "string" }, material]
        })
    }
}
materials![Flat, Normals, Diffuse, Surface];
