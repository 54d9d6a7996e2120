//! The document: a job as its file says it. Nothing is rendered from it; [`Job`](crate::Job) is made of it.
//!
//! Here materials have names and tracks have just been read. What is derived from that is in `scene.rs`.

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

/// What one POSTs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename = "Job", deny_unknown_fields)]
pub(crate) struct JobDocument {
    /// A name for people.
    #[serde(default = "default_name")]
    #[schemars(length(max = crate::limits::MAX_NAME_CHARS))]
    pub name: String,
    /// What there is to see.
    pub scene: SceneDocument,
    /// The pictures' size and file format.
    pub image: Image,
    /// How many pictures.
    #[serde(default)]
    pub frames: Frames,
    /// Jobs of higher priority go first.
    #[serde(default, deserialize_with = "priority")]
    #[schemars(range(min = -100, max = 100))]
    pub priority: i32,
}

/// What there is to see.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename = "Scene", deny_unknown_fields)]
pub(crate) struct SceneDocument {
    /// Where it is seen from.
    pub camera: Camera,
    /// What is seen where nothing is.
    #[serde(default)]
    pub background: Background,
    /// The lights; an empty list is darkness.
    #[serde(default = "default_lights")]
    #[schemars(length(max = MAX_LIGHTS))]
    pub lights: Vec<Light>,
    /// Fog; none when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fog: Option<Fog>,
    /// Darker corners in light from all around; none when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ambient_occlusion: Option<AmbientOcclusion>,
    /// Materials by name.
    #[serde(default)]
    pub materials: BTreeMap<String, Material>,
    /// The objects, one or more; the nearest one is seen, the first of several.
    #[schemars(length(min = 1))]
    pub objects: Vec<Object>,
    /// How far and how long rays march.
    #[serde(default)]
    pub march: March,
}

/// What became of a document's scene.
#[derive(Debug)]
pub(crate) struct Resolved {
    /// The scene, not yet prepared.
    pub scene: Scene,
    /// Where in the document each of the materials in use stands: a JSON pointer in the scene.
    pub material_pointers: Vec<String>,
    /// Names of materials that no object and no node uses.
    pub unused_names: Vec<String>,
    /// Names that no material has: JSON pointers in the scene, and the names.
    pub unknown: Vec<(String, String)>,
}

impl SceneDocument {
    /// The scene with every material in its slot and defaults filled in.
    pub(crate) fn resolve(self) -> Resolved {
        // Without `..`: a field that is new does not compile until it has a place in the scene.
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

/// Hands out slots.
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
