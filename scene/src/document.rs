//! The job document: a job as written in its file. Nothing is rendered from it; it is resolved to a
//! [`Job`](crate::Job).
//!
//! Here materials are referenced by name and tracks are freshly parsed. `scene.rs` has the types derived from it.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ambient_occlusion::AmbientOcclusion;
use crate::backgrounds::Background;
use crate::camera::Camera;
use crate::fog::Fog;
use crate::job::{Frames, Image, priority};
use crate::json_scan;
use crate::lights::{Light, default_lights};
use crate::limits::MAX_LIGHTS;
use crate::materials::{Material, MaterialRef};
use crate::nodes::Node;
use crate::scene::{March, Object, Scene, child_pointers};

/// Body of a job submission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename = "Job", deny_unknown_fields)]
pub(crate) struct JobDocument {
    /// Name of the job, for people.
    #[serde(default = "default_name")]
    #[schemars(length(max = crate::limits::MAX_NAME_CHARS))]
    pub name: String,
    /// The scene to render.
    pub scene: SceneDocument,
    /// The pictures' size and file format.
    pub image: Image,
    /// Number and rate of the pictures.
    #[serde(default)]
    pub frames: Frames,
    /// Jobs with higher priority start first.
    #[serde(default, deserialize_with = "priority")]
    #[schemars(range(min = -100, max = 100))]
    pub priority: i32,
}

/// The scene to render.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename = "Scene", deny_unknown_fields)]
pub(crate) struct SceneDocument {
    /// The camera.
    pub camera: Camera,
    /// The background, seen by rays that hit nothing.
    #[serde(default)]
    pub background: Background,
    /// The lights; an empty list means no light.
    #[serde(default = "default_lights")]
    #[schemars(length(max = MAX_LIGHTS))]
    pub lights: Vec<Light>,
    /// Fog; none when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fog: Option<Fog>,
    /// Ambient occlusion: darkens ambient and sky light in corners; off when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ambient_occlusion: Option<AmbientOcclusion>,
    /// Materials by name.
    #[serde(default)]
    pub materials: BTreeMap<String, Material>,
    /// The objects, one or more. The nearest one is visible; if several are equally near, the first of them.
    #[schemars(length(min = 1))]
    pub objects: Vec<Object>,
    /// Limits of ray marching.
    #[serde(default)]
    pub march: March,
}

/// Result of resolving a document's scene.
#[derive(Debug)]
pub(crate) struct Resolved {
    /// The scene, before precomputation.
    pub scene: Scene,
    /// JSON pointer in the scene, for each material in use.
    pub material_pointers: Vec<String>,
    /// Names of materials that no object and no node uses.
    pub unused_names: Vec<String>,
    /// Undefined material names: their JSON pointers in the scene, and the names.
    pub unknown: Vec<(String, String)>,
}

impl SceneDocument {
    /// Scene with every material in its slot and defaults filled in.
    pub(crate) fn resolve(self) -> Resolved {
        // Without `..`, so that a new field does not compile until it is stored in the scene.
        let Self { mut camera, background, lights, fog, ambient_occlusion, materials: named, mut objects, march } =
            self;
        camera.fill_defaults();
        let mut slots = MaterialResolver {
            named: &named,
            used: Vec::new(),
            by_name: BTreeMap::new(),
            material_pointers: Vec::new(),
            unknown: Vec::new(),
        };
        for (index, object) in objects.iter_mut().enumerate() {
            slots.resolve_object(object, index);
        }
        let MaterialResolver { used: materials, by_name, material_pointers: places, unknown, .. } = slots;
        let unused = named.keys().filter(|name| !by_name.contains_key(*name)).cloned().collect();
        let scene = Scene { camera, background, lights, fog, ambient_occlusion, materials, objects, march };
        Resolved { scene, material_pointers: places, unused_names: unused, unknown }
    }
}

/// Assigns slots to materials in the order of first use, so that equal scenes hash alike.
struct MaterialResolver<'a> {
    named: &'a BTreeMap<String, Material>,
    used: Vec<Material>,
    by_name: BTreeMap<String, u32>,
    material_pointers: Vec<String>,
    unknown: Vec<(String, String)>,
}

impl MaterialResolver<'_> {
    fn resolve_object(&mut self, object: &mut Object, index: usize) {
        self.resolve(&mut object.material, || format!("/objects/{index}/material"));
        self.resolve_tree(&mut object.shape, &mut Vec::new(), index);
    }

    fn resolve(&mut self, material: &mut MaterialRef, pointer: impl Fn() -> String) {
        let place = match material {
            MaterialRef::Name(name) => format!("/materials/{}", json_scan::escape(name)),
            MaterialRef::InPlace(_) | MaterialRef::Slot(_) => pointer(),
        };
        if let Err(name) = material.resolve(self.named, &mut self.used, &mut self.by_name) {
            self.unknown.push((pointer(), name));
        }
        if self.material_pointers.len() < self.used.len() {
            self.material_pointers.push(place);
        }
    }

    fn resolve_tree(&mut self, node: &mut Node, path: &mut Vec<String>, object: usize) {
        let name = node.name();
        if let Some(material) = node.material_mut() {
            self.resolve(material, || format!("/objects/{object}/shape{}/{name}/material", path.concat()));
        }
        let steps = child_pointers(node);
        for (child, step) in node.children_mut().iter_mut().zip(steps) {
            path.push(step);
            self.resolve_tree(child, path, object);
            path.pop();
        }
    }
}

fn default_name() -> String {
    "untitled".to_owned()
}
