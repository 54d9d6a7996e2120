//! Textures: colors that vary over space. They are solid: most depend only on the point, none needs a mapping.
//!
//! A texture is one documented struct, an `impl` of [`Pattern`], and one entry in the list.

#[cfg(feature = "added")]
mod added;
mod bricks;
mod checker;
mod gradient;
mod noise;
mod ramp;
mod stripes;
mod wave;

#[cfg(feature = "added")]
pub use added::AddedTexture;
pub use bricks::Bricks;
pub use checker::{Axes, Checker};
pub use gradient::{Gradient, GradientBy};
pub use noise::{Marble, NoiseRamp, Wood};
pub use ramp::{Ramp, RampStop};
pub use stripes::Stripes;

use super::{ColorParam, ShadingPoint};
use crate::kinds::family;
use crate::real::{Real, Vec3};

family! {
    /// A color that varies over space: an object whose member is the texture's name.
    pub enum Texture {
        Noise(NoiseRamp),
        Marble(Marble),
        Wood(Wood),
        Checker(Checker),
        Stripes(Stripes),
        Bricks(Bricks),
        Gradient(Gradient),
        #[cfg(feature = "added")]
        Added(AddedTexture),
    }

    /// Behavior of a texture.
    pub trait Pattern {
        /// Color at a shading point, linear RGB.
        fn color<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R>;

        /// Its colors, which may be textures.
        fn color_params(&self) -> Vec<&ColorParam>;

        /// Whether it uses `ShadingPoint::local_normal` directly.
        fn uses_local_normal(&self) -> bool = false;

        /// Whether it uses `ShadingPoint::footprint` directly.
        fn looks_at_footprint(&self) -> bool = false;
    }
}

impl Texture {
    /// Whether a texture has this name in JSON.
    pub fn is_name(name: &str) -> bool {
        Self::kinds().iter().any(|kind| kind.name == name)
    }

    /// Nesting depth of its textures, itself included.
    pub fn depth(&self) -> usize {
        let inside = self.color_params().into_iter().filter_map(ColorParam::texture);
        1 + inside.map(Self::depth).max().unwrap_or(0)
    }

    /// Number of textures in it, itself included.
    pub fn count(&self) -> u32 {
        let inside = self.color_params().into_iter().filter_map(ColorParam::texture);
        inside.map(Self::count).fold(1, u32::saturating_add)
    }

    /// Whether it, or a texture in it, uses `ShadingPoint::local_normal`.
    pub fn needs_own_normal(&self) -> bool {
        self.uses_local_normal()
            || self.color_params().into_iter().filter_map(ColorParam::texture).any(Self::needs_own_normal)
    }

    /// Whether it, or a texture in it, uses `ShadingPoint::footprint`.
    pub fn needs_footprint(&self) -> bool {
        self.looks_at_footprint()
            || self.color_params().into_iter().filter_map(ColorParam::texture).any(Self::needs_footprint)
    }
}

/// Black and white: the colors of textures without a `colors` member.
fn default_colors() -> [ColorParam; 2] {
    [ColorParam::black(), ColorParam::white()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::{MaskValue, vec3};

    /// A shading point on a face toward the viewer.
    pub(super) fn at(x: f32, y: f32, z: f32) -> ShadingPoint<f32> {
        let facing = vec3(0.0, 0.0, 1.0);
        let point = vec3(x, y, z);
        let footprint = [vec3(0.0, 0.0, 0.0); 2];
        let inside = MaskValue(false);
        ShadingPoint {
            normal: facing,
            to_viewer: facing,
            local_point: point,
            local_normal: facing,
            camera_t: 4.0,
            footprint,
            is_inside: inside,
        }
    }

    #[test]
    fn nested_textures_count_and_can_need_the_normal() {
        let texture: Texture = serde_json::from_str(
            r#"{ "checker": { "cell": 1, "colors": [[0, 0, 0],
                 { "stripes": { "width": 1, "colors": [{ "bricks": {} }, [1, 1, 1]] } }] } }"#,
        )
        .unwrap();
        assert_eq!(texture.depth(), 3);
        assert_eq!(texture.count(), 3);
        assert!(texture.needs_own_normal());
    }
}
