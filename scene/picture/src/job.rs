//! A job: a scene, and the pictures to render of it.

use std::sync::Arc;

use serde::{Deserializer, de};

use crate::film::{Frames, ImageSpec};
use crate::json_text;
use crate::scene::Scene;
use crate::values::integer;
use crate::written::WrittenNodes;

/// A parsed and validated job: a scene, and the pictures to render of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// Name of the job, for people.
    pub name: String,
    /// The scene, evaluated at the first frame; [`Job::at`] evaluates it at another.
    pub scene: Scene,
    /// The pictures' size and file format.
    pub image: ImageSpec,
    /// Number and rate of the pictures.
    pub frames: Frames,
    /// Jobs with higher priority start first.
    pub priority: i32,
    /// Whether its frames differ in more than their sampling noise.
    pub is_animated: bool,
    /// JSON pointer in the scene, for each material in use.
    pub material_pointers: Vec<String>,
    /// Names of materials that no object uses.
    pub unused_materials: Vec<String>,
    /// Names of shapes that no object uses.
    pub unused_shapes: Vec<String>,
    /// The nodes as written, if the document has named shapes.
    pub written: Option<Arc<WrittenNodes>>,
}

impl Job {
    /// The same job with another image.
    pub fn with_image(self, image: ImageSpec) -> Self {
        Self { image, ..self }
    }

    /// Camera rays of one frame.
    pub fn rays_per_frame(&self) -> u64 {
        self.image.rays()
    }

    /// JSON pointer in the document of the material in a slot.
    pub fn material_pointer(&self, slot: usize) -> Option<String> {
        let pointer = self.material_pointers.get(slot)?;
        // A shape with numbers of its own is written once, under its own name.
        let in_shape = pointer.strip_prefix("/shapes/").and_then(|rest| rest.split_once('/'));
        let named = in_shape.and_then(|(name, rest)| {
            let shape = self.written.as_ref()?.instances.get(&json_text::unescape(name))?;
            Some(format!("/scene/shapes/{}/{rest}", json_text::escape(shape)))
        });
        Some(named.unwrap_or_else(|| format!("/scene{pointer}")))
    }

    /// Nodes of all objects.
    pub fn nodes(&self) -> u32 {
        self.scene.nodes()
    }

    /// Whether some pixel may be less than opaque.
    pub fn is_transparent(&self) -> bool {
        self.scene.is_transparent()
    }
}

/// Deserializes the priority of a job.
pub fn priority<'de, D: Deserializer<'de>>(deserializer: D) -> Result<i32, D::Error> {
    let value = integer(deserializer)?;
    i32::try_from(value)
        .ok()
        .filter(|value| (-100..=100).contains(value))
        .ok_or_else(|| de::Error::custom(format_args!("must be -100 to 100, not {value}")))
}
