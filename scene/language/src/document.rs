//! The job document: a job as written in its file. Nothing is rendered from it; it is resolved to a
//! [`Job`](crate::job::Job).
//!
//! Here materials are referenced by name and tracks are freshly parsed. `scene.rs` has the types derived from it.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ambient_occlusion::AmbientOcclusion;
use crate::backgrounds::Background;
use crate::camera::Camera;
use crate::film::{Frames, ImageSpec};
use crate::fog::Fog;
use crate::groups::Group;
use crate::job::priority;
use crate::json_text;
use crate::lights::{Light, PlacedLight, default_lights};
use crate::limits::MAX_LIGHTS;
use crate::materials::{Material, MaterialRef, MaterialSlots};
use crate::nodes::{Node, material_pointer};
use crate::scene::{March, Object, Scene, child_pointers};
use crate::transport::Transport;
use crate::values::NamedNumber;
use crate::written::WrittenNodes;

/// Body of a job submission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename = "Job", deny_unknown_fields)]
pub(crate) struct JobDocument {
    /// Address of a JSON Schema, for editors.
    #[serde(default, rename = "$schema", skip_serializing_if = "Option::is_none")]
    pub schema: Option<String>,
    /// Name of the job, for people.
    #[serde(default = "default_name")]
    #[schemars(length(max = crate::limits::MAX_NAME_CHARS))]
    pub name: String,
    /// The scene to render.
    pub scene: SceneDocument,
    /// The pictures' size and file format.
    pub image: ImageSpec,
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
    /// The environment, whose light sky lights and suns give and which reflected and refracted rays see; the
    /// background when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [{ "gradient": { "bottom": "#3a3530", "top": "#dfe9ff" } }]))]
    pub environment: Option<Background>,
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
    /// Numbers by name, for formulas: a number, a formula as text, or a track.
    #[serde(default)]
    pub numbers: BTreeMap<String, NamedNumber>,
    /// Materials by name.
    #[serde(default)]
    pub materials: BTreeMap<String, Material>,
    /// Shapes by name: `{ "use": name }` stands for one anywhere in an object or in another shape.
    #[serde(default)]
    pub shapes: BTreeMap<String, Node>,
    /// Groups of objects, lights and the camera that move together.
    #[serde(default)]
    pub groups: Vec<Group>,
    /// The objects, one or more. The nearest one is visible; if several are equally near, the first of them.
    #[schemars(length(min = 1))]
    pub objects: Vec<Object>,
    /// Limits of ray marching.
    #[serde(default)]
    pub march: March,
    /// How light travels: `direct` or `path`.
    #[serde(default, skip_serializing_if = "Transport::is_default")]
    #[schemars(extend("default" = "direct"))]
    pub integrator: Transport,
}

/// The named shapes of a document, after each `use` in its objects has been replaced.
#[derive(Debug)]
pub(crate) struct NamedShapes {
    /// The nodes as written, if there are named shapes.
    pub written: Option<WrittenNodes>,
    /// Names of the shapes that no object uses.
    pub unused_names: Vec<String>,
    /// Shapes that no object uses, by name; those in other ones are left out.
    pub unused: Vec<(String, Node)>,
}

/// Result of resolving a document's scene.
#[derive(Debug)]
pub(crate) struct Resolved {
    /// The scene, before precomputation.
    pub scene: Scene,
    /// Number of materials in use; the scene has no more than are allowed.
    pub material_count: usize,
    /// JSON pointer in the scene, for each material in use.
    pub material_pointers: Vec<String>,
    /// Names of materials that no object and no node uses.
    pub unused_names: Vec<String>,
    /// Undefined material names by their JSON pointers in the document's scene.
    pub unknown: BTreeMap<String, String>,
}

impl SceneDocument {
    /// Scene with every material in its slot and defaults filled in. Each `use` and all groups have been replaced;
    /// `lights` are all lights.
    pub(crate) fn resolve(self, lights: Vec<PlacedLight>, shapes: &mut NamedShapes) -> Resolved {
        // Without `..`, so that a new field does not compile until it is stored in the scene.
        let Self {
            mut camera,
            background,
            environment,
            lights: _,
            fog,
            ambient_occlusion,
            numbers: _,
            materials: named,
            shapes: _,
            groups: _,
            mut objects,
            march,
            integrator,
        } = self;
        camera.fill_defaults();
        let mut slots = MaterialResolver::new(&named, shapes.written.as_ref());
        for (index, object) in objects.iter_mut().enumerate() {
            slots.resolve(&mut object.material, || format!("/objects/{index}/material"));
            slots.resolve_tree(&mut object.shape, &mut format!("/objects/{index}/shape"));
        }
        let MaterialResolver { slots, material_pointers: places, mut unknown, .. } = slots;
        let mut in_unused = MaterialResolver::new(&named, shapes.written.as_ref());
        for (name, shape) in &mut shapes.unused {
            in_unused.resolve_tree(shape, &mut format!("/shapes/{}", json_text::escape(name)));
        }
        unknown.extend(in_unused.unknown);
        let MaterialSlots { used: materials, count: material_count, by_name, .. } = slots;
        let unused = named.keys().filter(|name| !by_name.contains_key(*name)).cloned().collect();
        let scene = Scene {
            camera,
            background,
            environment,
            lights,
            fog,
            ambient_occlusion,
            materials,
            objects,
            march,
            integrator,
        };
        Resolved { scene, material_count, material_pointers: places, unused_names: unused, unknown }
    }
}

/// Assigns slots to materials in the order of first use, so that equal scenes hash alike.
struct MaterialResolver<'a> {
    named: &'a BTreeMap<String, Material>,
    written: Option<&'a WrittenNodes>,
    slots: MaterialSlots,
    material_pointers: Vec<String>,
    unknown: BTreeMap<String, String>,
}

impl<'a> MaterialResolver<'a> {
    fn new(named: &'a BTreeMap<String, Material>, written: Option<&'a WrittenNodes>) -> Self {
        let (slots, material_pointers) = (MaterialSlots::default(), Vec::new());
        Self { named, written, slots, material_pointers, unknown: BTreeMap::new() }
    }

    fn resolve(&mut self, material: &mut MaterialRef, pointer: impl Fn() -> String) {
        let written = self.written;
        let pointer = || written.map_or_else(&pointer, |written| written.pointer(&pointer()));
        let named = match material {
            MaterialRef::Name(name) => Some(format!("/materials/{}", json_text::escape(name))),
            MaterialRef::InPlace(_) | MaterialRef::Slot(_) => None,
        };
        if let Err(name) = material.resolve(self.named, &mut self.slots) {
            self.unknown.insert(pointer(), name);
        }
        if self.material_pointers.len() < self.slots.used.len() {
            self.material_pointers.push(named.unwrap_or_else(pointer));
        }
    }

    fn resolve_tree(&mut self, node: &mut Node, pointer: &mut String) {
        let name = node.name();
        for (placement, material) in node.materials_mut() {
            self.resolve(material, || format!("{pointer}/{name}{}", material_pointer(placement)));
        }
        let (length, steps) = (pointer.len(), child_pointers(node));
        for (child, step) in node.children_mut().iter_mut().zip(steps) {
            step.push_to(pointer);
            self.resolve_tree(child, pointer);
            pointer.truncate(length);
        }
    }
}

fn default_name() -> String {
    "untitled".to_owned()
}
