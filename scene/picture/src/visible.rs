//! Which rays see an object.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::seek::Seek;

/// Which rays see an object: by default all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields, default)]
pub struct Visible {
    /// Whether rays from the camera see it.
    pub camera: bool,
    /// Whether it casts shadows and darkens corners (`ambient_occlusion`).
    pub shadow: bool,
    /// Whether reflected and refracted rays see it.
    pub reflection: bool,
}

impl Visible {
    /// Whether all rays see the object.
    pub fn is_full(&self) -> bool {
        *self == Self::default()
    }

    /// Whether rays of a kind see the object.
    pub fn to(self, rays: RayKind) -> bool {
        match rays {
            RayKind::Camera => self.camera,
            RayKind::Shadow => self.shadow,
            RayKind::Reflection => self.reflection,
        }
    }
}

impl Default for Visible {
    fn default() -> Self {
        Self { camera: true, shadow: true, reflection: true }
    }
}

/// Kind of a ray, as far as visibility is concerned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RayKind {
    /// From the camera to the first surface.
    Camera,
    /// From a surface toward a light.
    Shadow,
    /// From a surface that reflected or refracted the path.
    Reflection,
}
