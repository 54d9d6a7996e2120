//! Appearance of surfaces: the registry of materials, and the trait that each implements.
//!
//! Like a node, a material is one documented struct, one `impl` of [`Shade`] and one entry in the list.

#[cfg(feature = "added")]
mod added;
pub mod bsdf;
mod diffuse;
mod material_ref;
pub mod microfacet;
mod param;
mod shadow_catcher;
mod surface;
pub mod texture;
mod unlit;
mod volume;

#[cfg(feature = "added")]
pub use added::AddedMaterial;
pub use diffuse::Diffuse;
pub use material_ref::MaterialRef;
pub use material_ref::MaterialSlots;
pub use param::{ColorParam, ScalarKind, ScalarParam, TexturedScalar};
pub use shadow_catcher::ShadowCatcher;
pub use surface::Surface;
pub use texture::Texture;
pub use unlit::{Flat, Normals};
pub use volume::MediumScattering;
pub use volume::{Clouds, MediumMaterial, Volume};

pub use crate::kinds::Example;
use crate::kinds::family;
use bsdf::{Bsdf, Lobes};

use crate::real::{MaskValue, Real, Vec3, bundle};

/// Shading point: the input of a material at a hit.
#[derive(Clone, Copy, Debug)]
pub struct ShadingPoint<R: Real> {
    /// The surface's normal, of length 1, on the viewer's side.
    pub normal: Vec3<R>,
    /// The direction to the viewer, of length 1.
    pub to_viewer: Vec3<R>,
    /// The point in the space of textures: the space of the `paint` that names the material, else the scene's.
    pub local_point: Vec3<R>,
    /// The normal in that space.
    pub local_normal: Vec3<R>,
    /// Distance from the camera, along the ray.
    pub camera_t: R,
    /// Footprint of one sample on the surface, in the space of textures: two vectors of half its width from
    /// `local_point`.
    pub footprint: [Vec3<R>; 2],
    /// Whether the surface is seen from inside its shape.
    pub is_inside: MaskValue<R>,
}

impl<R: Real> ShadingPoint<R> {
    /// Width of the footprint along a direction of length 1.
    pub(crate) fn width_along(&self, direction: Vec3<f32>) -> R {
        let [across, along] = self.footprint;
        let squared = across.dot_uniform(direction).square() + along.dot_uniform(direction).square();
        squared.sqrt() * 2.0
    }

    /// Width of the footprint along its longer axis.
    pub fn width(&self) -> R {
        let [across, along] = self.footprint;
        across.length_squared().max(along.length_squared()).sqrt() * 2.0
    }
}

/// Light that arrives at a point from one direction.
#[derive(Clone, Copy, Debug)]
pub struct LightSample<R> {
    /// Toward the light, of length 1.
    pub direction: Vec3<R>,
    /// Linear RGB radiance at the point; 0 in shadow.
    pub radiance: Vec3<R>,
}

bundle!(LightSample { direction, radiance });

/// Light that arrives at a point.
#[derive(Clone, Debug, Default)]
pub struct IncidentLight<R> {
    /// Light from single directions.
    pub lights: Vec<LightSample<R>>,
    /// Ambient light, as reflected by a white matte surface; `None` without any.
    pub ambient: Option<Vec3<R>>,
    /// Ambient visibility at the point, 0 (occluded) to 1; `None` if the scene has no `ambient_occlusion`.
    pub ambient_visibility: Option<R>,
    /// Fraction of the light on a matte surface that shadows and ambient occlusion take away; `None` if no material
    /// shows shadows alone.
    pub shadow: Option<R>,
}

/// Specular BSDF at a shading point: F0, roughness, transmission and index of refraction. Direct light is in `shade`.
#[derive(Clone, Copy, Debug)]
pub struct SpecularBsdf<R> {
    /// Fraction of the light reflected at normal incidence, by channel (Fresnel's F0).
    pub f0: Vec3<R>,
    /// Roughness, 0 to 1: the square root of the GGX model's α.
    pub roughness: R,
    /// Fraction of the light that is not reflected but transmitted, by channel.
    pub transmission: Vec3<R>,
    /// Index of refraction inside over that outside.
    pub ior: R,
}

bundle!(SpecularBsdf { f0, roughness, transmission, ior });

family! {
    /// Reflection and emission of a surface: an object whose member is the material's name.
    pub enum Material {
        Flat(Flat),
        Normals(Normals),
        Diffuse(Diffuse),
        Surface(Surface),
        ShadowCatcher(ShadowCatcher),
        Clouds(Clouds),
        Volume(Volume),
        #[cfg(feature = "added")]
        AddedMaterial(AddedMaterial),
    }

    /// A material.
    pub trait Shade {
        /// Radiance toward the viewer, linear RGB.
        fn shade<R: Real>(&self, place: &ShadingPoint<R>, light: &IncidentLight<R>) -> Vec3<R>;

        /// Albedo: the surface's own color, without light.
        fn albedo<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R>;

        /// Scattering and emission, for paths of light.
        fn bsdf<R: Real>(&self, place: &ShadingPoint<R>) -> Bsdf<R>;

        /// Terms of `bsdf` that it may have besides the diffuse one.
        fn lobes(&self) -> Lobes = Lobes::default();

        /// Emitted radiance, if it is the same in all directions and everywhere on the surface, and not always black.
        fn uniform_emission(&self) -> Option<Vec3<f32>> = None;

        /// Whether `shade` or `transparency` uses the lights.
        fn is_lit(&self) -> bool;

        /// Whether it uses the lights, on its surface or inside. If no material does, a scene with lights gets a warning.
        fn uses_lights(&self) -> bool = self.is_lit();

        /// Whether it says something about ambient light, which paths of light do not have.
        fn has_own_ambient(&self) -> bool = false;

        /// Whether it is black or nearly so without lights. If all materials are, a scene without lights gets a warning.
        fn is_black_without_light(&self) -> bool = self.is_lit();

        /// Specular BSDF at a shading point; `None` if it never reflects or transmits rays.
        fn specular<R: Real>(&self, place: &ShadingPoint<R>) -> Option<SpecularBsdf<R>> = None;

        /// Whether `specular` ever reflects or transmits a ray.
        fn is_specular(&self) -> bool = false;

        /// Whether a ray may enter the shape.
        fn is_transmissive(&self) -> bool = false;

        /// The medium inside an object, if it is one.
        fn as_medium(&self) -> Option<MediumMaterial<'_>> = None;

        /// Textures of its parameters.
        fn textures(&self) -> Vec<&Texture> = Vec::new();

        /// Whether it uses `ShadingPoint::local_point`.
        fn is_textured(&self) -> bool = !self.textures().is_empty();
    }
}

impl Material {
    /// Whether it is a medium inside an object instead of covering its surface.
    pub fn is_medium(&self) -> bool {
        self.as_medium().is_some()
    }

    /// Whether it uses `ShadingPoint::footprint`.
    pub fn needs_footprint(&self) -> bool {
        self.textures().into_iter().any(Texture::needs_footprint)
    }

    /// Whether it uses `ShadingPoint::local_normal`, which is expensive.
    pub fn needs_local_normal(&self) -> bool {
        self.textures().into_iter().any(Texture::needs_own_normal)
    }
}
