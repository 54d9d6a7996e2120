//! A scene: camera, background, lights, materials and objects, as a job file says them.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use crate::camera::Camera;
use crate::lights::{Light, default_lights};
use crate::limits::MAX_STEPS;
use crate::materials::{Material, MaterialUse};
use crate::nodes::Node;
use crate::values::{Color, Length, whole};

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
    pub lights: Vec<Light>,
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

/// What is seen where nothing is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Background {
    /// One colour.
    Color(Color),
    /// From `bottom` to `top` by t = (dir.y + 1)/2 of the ray's direction.
    Gradient {
        /// Straight down.
        bottom: Color,
        /// Straight up.
        top: Color,
    },
    /// Nothing: alpha is 0 there.
    Transparent,
}

impl Default for Background {
    fn default() -> Self {
        Self::Gradient { bottom: Color::new(1.0, 1.0, 1.0), top: Color::new(0.5, 0.7, 1.0) }
    }
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
}

impl Default for March {
    fn default() -> Self {
        Self { max_distance: Length::new(1000.0).expect("1000 is in range"), max_steps: 512 }
    }
}

impl Scene {
    /// The materials in use; a [`MaterialUse`] has its place in this list.
    #[inline(always)]
    pub fn slots(&self) -> &[Material] {
        &self.slots
    }

    /// Names of materials that no object and no node uses.
    pub(crate) fn unused_materials(&self) -> impl Iterator<Item = &str> {
        self.unused.iter().map(String::as_str)
    }

    /// Finds what makes its objects faster to look at; `moves` is whether frames differ in their numbers.
    pub(crate) fn prepare(&mut self, moves: bool) {
        self.objects.iter_mut().for_each(|object| object.shape.prepare(moves));
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

/// Hands out slots.
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
