//! What surfaces look like: the list of materials, and what a material must say of itself.
//!
//! Like a node, a material is one documented struct, one `impl` of [`Shade`] and one word in the list.

mod diffuse;
mod material_use;
pub mod microfacet;
mod plain;
mod surface;
pub mod texture;
mod tint;
mod volume;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use diffuse::Diffuse;
pub use material_use::MaterialUse;
pub use plain::{Flat, Normals};
pub use surface::Surface;
pub use texture::Texture;
pub use tint::{Level, Parameter, Tint, Varied};
pub(crate) use volume::Filling;
pub use volume::{Clouds, Volume};

use crate::lights::Incoming;
use crate::nodes::snake_case;
use crate::real::{Flag, Real, Vec3, bundle};

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
    /// Ambient visibility at the point, 0 (occluded) to 1; `None` if the scene has no `ambient_occlusion`.
    pub openness: Option<R>,
}

/// Specular BSDF at a shading point: F0, roughness, transmission and index of refraction. Direct light is in `shade`.
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

    /// The textures that its parameters have.
    fn textures(&self) -> Vec<&Texture> {
        Vec::new()
    }

    /// Whether it looks at `Place::point`.
    fn is_textured(&self) -> bool {
        !self.textures().is_empty()
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

            fn textures(&self) -> Vec<&Texture> {
                match self { $(Self::$Kind(material) => material.textures()),* }
            }

            fn is_textured(&self) -> bool {
                match self { $(Self::$Kind(material) => material.is_textured()),* }
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

materials![Flat, Normals, Diffuse, Surface, Clouds, Volume];
