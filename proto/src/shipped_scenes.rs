//! Shipped scenes, as the server lists them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The shipped scenes, by name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SceneList {
    /// The scenes.
    pub scenes: Vec<SceneView>,
}

/// A shipped scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SceneView {
    /// Name, as commands take it: `csg`, `paper/csg`.
    pub name: String,
    /// Name for people.
    pub title: String,
    /// Size of its job file.
    pub bytes: u64,
    /// Path of its job file.
    pub address: String,
}
