//! Provenance of a picture: everything needed to render it again.
//!
//! It has no times and machines, because they would make equal pictures differ.

use serde::{Deserialize, Serialize};

use crate::animation::JobAtFrame;
use crate::cache_key::PICTURE_VERSION;
use crate::film::{Format, Layer};
use crate::json_text::ascii_json;

/// Maximum size of the names of objects in a file; longer lists are left out.
const MAX_NAMES_BYTES: usize = 8 << 10;

/// Provenance of a picture, stored in its file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// BLAKE3 of the canonical scene, in hex.
    pub scene: String,
    /// Picture version that it was rendered with.
    pub picture_version: u32,
    /// The frame, from 0.
    pub frame: u32,
    /// Seed of the samples.
    pub seed: u32,
    /// Names of the objects by index, in an EXR with the layer of objects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub objects: Option<Vec<Option<String>>>,
}

impl Provenance {
    /// Provenance of a job's frame.
    pub fn new(at_frame: &JobAtFrame<'_>) -> Self {
        Self {
            scene: at_frame.scene_hash().to_hex().to_string(),
            picture_version: PICTURE_VERSION,
            frame: at_frame.frame(),
            seed: at_frame.image().seed,
            objects: at_frame.stored_object_names(),
        }
    }

    /// Provenance as JSON in ASCII, as it is written to files.
    pub fn json(&self) -> String {
        ascii_json(self)
    }
}

impl JobAtFrame<'_> {
    /// Names of the objects by index, if the frame's picture stores them.
    pub(crate) fn stored_object_names(&self) -> Option<Vec<Option<String>>> {
        let (image, objects) = (self.image(), &self.scene().objects);
        if image.format != Format::Exr || !image.layers.contains(&Layer::Object) {
            return None;
        }
        let size: usize = objects.iter().map(|object| object.name.as_ref().map_or(5, |name| 6 * name.len() + 3)).sum();
        let has_names = objects.iter().any(|object| object.name.is_some());
        (has_names && size <= MAX_NAMES_BYTES).then(|| objects.iter().map(|object| object.name.clone()).collect())
    }
}
