//! A scene: camera, background, lights, materials and objects, as a job file says them.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use crate::camera::Camera;
use crate::lights::{Light, default_lights};
use crate::limits::{MAX_BOUNCES, MAX_LIGHTS, MAX_STEPS};
use crate::materials::{Material, MaterialUse, Shade};
use crate::nodes::Node;
use crate::sky::{Background, Day};
use crate::surroundings::{AmbientOcclusion, Fog};
use crate::values::{Length, whole};

/// What there is to see.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scene {
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
    /// Ambient occlusion: darkens ambient and sky light in corners; off when absent.
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
    /// The materials in use, in the order of their first use.
    #[serde(skip)]
    pub(crate) slots: Vec<Material>,
    /// Names of materials that are not in use.
    #[serde(skip)]
    unused: Vec<String>,
}

/// A shape and its material.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Object {
    /// The material: a name from `materials`, or one in place; grey when absent.
    #[serde(default = "grey")]
    pub material: MaterialUse,
    /// The shape.
    pub shape: Node,
}

/// How far and how long rays march.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct March {
    /// Where a ray misses, in scene units.
    pub max_distance: Length,
    /// Steps after which a ray gives up.
    #[serde(deserialize_with = "max_steps")]
    #[schemars(range(min = 1, max = MAX_STEPS))]
    pub max_steps: u32,
    /// How often a ray is mirrored or refracted at most; what would come after is taken from the background.
    #[serde(deserialize_with = "max_bounces")]
    #[schemars(range(min = 0, max = MAX_BOUNCES))]
    pub max_bounces: u32,
}

impl Default for March {
    fn default() -> Self {
        Self { max_distance: Length::new(1000.0).expect("1000 is in range"), max_steps: 512, max_bounces: 4 }
    }
}

impl Scene {
    /// The materials in use; a [`MaterialUse`] has its place in this list.
    #[inline(always)]
    pub fn slots(&self) -> &[Material] {
        &self.slots
    }

    /// The material that an object says.
    pub(crate) fn material_of(&self, object: usize) -> &Material {
        &self.slots[self.objects[object].material.slot() as usize]
    }

    /// Names of materials that no object and no node uses.
    pub(crate) fn unused_materials(&self) -> impl Iterator<Item = &str> {
        self.unused.iter().map(String::as_str)
    }

    /// Finds what makes its objects faster to look at; `moves` is whether frames differ in their numbers.
    pub(crate) fn prepare(&mut self, moves: bool) {
        self.objects.iter_mut().for_each(|object| object.shape.prepare(moves));
        self.background.prepare();
        self.lights.iter_mut().for_each(Light::prepare);
    }

    /// What lights, sky and materials mean wrongly together: JSON pointers in the scene, and why.
    pub(crate) fn faults(&self) -> Vec<(String, String)> {
        let mut faults = Vec::new();
        if let Some(message) = self.background.day().and_then(Day::fault) {
            faults.push(("/background/day/sun".to_owned(), message.to_owned()));
        }
        for (index, light) in self.lights.iter().enumerate() {
            if let Some((place, message)) = light.fault(&self.background) {
                faults.push((format!("/lights/{index}/{place}"), message.to_owned()));
            }
        }
        for (index, object) in self.objects.iter().enumerate() {
            self.filled_paints(&object.shape, &mut format!("/objects/{index}/shape"), &mut faults);
        }
        faults
    }

    /// Finds paints of what fills a whole object.
    fn filled_paints(&self, node: &Node, pointer: &mut String, faults: &mut Vec<(String, String)>) {
        let material = node.material().and_then(|material| self.slots.get(material.slot() as usize));
        if material.is_some_and(Shade::is_medium) {
            let message =
                "fills a whole object and can't be painted on a part of one: make the part an object of its own";
            faults.push((format!("{pointer}/{}/material", node.name()), message.to_owned()));
        }
        let length = pointer.len();
        for (child, step) in node.children().iter().zip(child_steps(node)) {
            pointer.push_str(&step);
            self.filled_paints(child, pointer, faults);
            pointer.truncate(length);
        }
    }

    /// Gives every use of a material its slot; reports each unknown name with its JSON pointer in the scene.
    pub(crate) fn resolve_materials(&mut self) -> Vec<(String, String)> {
        let mut resolver =
            Resolver { named: &self.materials, used: Vec::new(), slots: BTreeMap::new(), unknown: Vec::new() };
        for (index, object) in self.objects.iter_mut().enumerate() {
            resolver.resolve(&mut object.material, || format!("/objects/{index}/material"));
            resolver.resolve_tree(&mut object.shape, &mut Vec::new(), index);
        }
        let Resolver { used, unknown, slots, .. } = resolver;
        self.unused = self.materials.keys().filter(|name| !slots.contains_key(*name)).cloned().collect();
        self.slots = used;
        unknown
    }
}

/// Assigns slots to materials in the order of first use, so that equal scenes hash alike.
struct Resolver<'a> {
    named: &'a BTreeMap<String, Material>,
    used: Vec<Material>,
    slots: BTreeMap<String, u32>,
    unknown: Vec<(String, String)>,
}

impl Resolver<'_> {
    fn resolve(&mut self, material: &mut MaterialUse, pointer: impl FnOnce() -> String) {
        if let Err(name) = material.resolve(self.named, &mut self.used, &mut self.slots) {
            self.unknown.push((pointer(), name));
        }
    }

    fn resolve_tree(&mut self, node: &mut Node, path: &mut Vec<String>, object: usize) {
        let name = node.name();
        if let Some(material) = node.material_mut() {
            self.resolve(material, || format!("/objects/{object}/shape{}/{name}/material", path.concat()));
        }
        let steps = child_steps(node);
        for (child, step) in node.children_mut().iter_mut().zip(steps) {
            path.push(step);
            self.resolve_tree(child, path, object);
            path.pop();
        }
    }
}

/// The JSON pointers from a node to each of its children.
pub(crate) fn child_steps(node: &Node) -> Vec<String> {
    let name = node.name();
    if node.has_list() {
        (0..node.children().len()).map(|index| format!("/{name}/of/{index}")).collect()
    } else {
        node.children().iter().map(|_| format!("/{name}/child")).collect()
    }
}

fn grey() -> MaterialUse {
    serde_json::from_str(r#"{ "diffuse": {} }"#).expect("a material")
}

fn max_steps<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole(deserializer, 1, MAX_STEPS, "steps")
}

fn max_bounces<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole(deserializer, 0, MAX_BOUNCES, "bounces")
}
