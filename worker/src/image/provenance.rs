//! Provenance of a picture: everything needed to render it again.
//!
//! It has no times, names or machines, because they would make equal pictures differ.

use scene::JobAtFrame;
use serde::{Deserialize, Serialize};

/// Name of the PNG chunk and of the EXR attribute.
pub const KEYWORD: &str = "sdfarm";

/// Provenance of a picture.
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
}

impl Provenance {
    /// Provenance of a job's frame.
    pub fn new(still: &JobAtFrame<'_>) -> Self {
        Self {
            scene: still.scene_hash().to_hex().to_string(),
            picture_version: scene::PICTURE_VERSION,
            frame: still.frame(),
            seed: still.image().seed,
        }
    }

    /// Provenance as JSON, as it is written to files.
    pub fn json(&self) -> String {
        serde_json::to_string(self).expect("strings and numbers are JSON")
    }
}
