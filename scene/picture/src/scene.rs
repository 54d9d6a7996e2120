//! A scene: camera, background, lights, materials and objects, ready to be rendered.

mod light_groups;

use std::fmt::Write as _;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use crate::ambient_occlusion::AmbientOcclusion;
use crate::backgrounds::Background;
use crate::camera::Camera;
use crate::fog::Fog;
use crate::kinds::NodeError;
use crate::light_groups::LightGroup;
use crate::lights::{AmbientLight, PlacedLight};
use crate::limits::{MAX_BOUNCES, MAX_STEPS};
use crate::materials::{Material, MaterialRef};
use crate::nodes::{Node, material_pointer};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::transport::Transport;
use crate::values::{Length, integer_in_range};
use crate::visible::Visible;
pub use light_groups::LightGroups;

/// The scene to render: materials are in slots, and every number is evaluated at one time.
///
/// Its serialized form is hashed to identify pictures, so no field may be missing there.
#[derive(Clone, Debug, PartialEq, Serialize, Seek)]
pub struct Scene {
    /// The camera.
    pub camera: Camera,
    /// The background, seen by rays that hit nothing.
    pub background: Background,
    /// The environment, whose light sky lights and suns give and which reflected and refracted rays see; the
    /// background when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub environment: Option<Background>,
    /// The lights; an empty list means no light.
    pub lights: Vec<PlacedLight>,
    /// Fog, if there is any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fog: Option<Fog>,
    /// Ambient occlusion: darkens ambient and sky light in corners; off when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ambient_occlusion: Option<AmbientOcclusion>,
    /// The materials in use, in the order of their first use.
    pub materials: Vec<Material>,
    /// The objects, one or more. The nearest one is visible; if several are equally near, the first of them.
    pub objects: Vec<Object>,
    /// Limits of ray marching.
    pub march: March,
    /// How light travels.
    #[serde(skip_serializing_if = "Transport::is_default")]
    pub integrator: Transport,
}

/// A shape and its material.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Object {
    /// The material: a name from `materials`, or one in place; gray when absent.
    #[serde(default = "MaterialRef::default_of_objects")]
    pub material: MaterialRef,
    /// The shape.
    pub shape: Node,
    /// Name of the object, for people: errors, warnings and the object layer of an EXR mention it.
    #[serde(default, skip_serializing)]
    #[schemars(length(min = 1, max = crate::limits::MAX_NAME_CHARS))]
    pub name: Option<String>,
    /// Which rays see the object: the camera's, shadows', reflected and refracted ones.
    #[serde(default, skip_serializing_if = "Visible::is_full")]
    #[schemars(extend("default" = { "camera": true, "shadow": true, "reflection": true }))]
    pub visible: Visible,
    /// Light group of the light that the object sends out, which an EXR has in layers of its own (`image.light_groups`).
    #[serde(default, skip_serializing)]
    pub light_group: Option<LightGroup>,
}

/// Limits of ray marching.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields, default)]
pub struct March {
    /// Distance after which a ray misses, in scene units.
    pub max_distance: Length,
    /// Maximum number of steps of a ray.
    #[serde(deserialize_with = "max_steps")]
    #[schemars(range(min = 1, max = MAX_STEPS))]
    pub max_steps: u32,
    /// Maximum number of reflections and refractions of a ray; after that, the background's radiance is used.
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
    /// The materials in use; a [`MaterialRef`] is an index into this list.
    pub fn used_materials(&self) -> &[Material] {
        &self.materials
    }

    /// The material named by an object.
    pub fn material_of(&self, object: usize) -> &Material {
        &self.materials[self.objects[object].material.slot() as usize]
    }

    /// The scene without its surfaces and their materials: with its clouds and volumes only.
    pub(crate) fn without_surfaces(&self) -> Self {
        let mut media = self.clone();
        (media.objects, media.materials) = (Vec::new(), Vec::new());
        for (index, object) in self.objects.iter().enumerate() {
            let material = self.material_of(index);
            if material.is_medium() {
                let material_ref = MaterialRef::Slot(media.materials.len() as u32);
                media.objects.push(Object { material: material_ref, ..object.clone() });
                media.materials.push(material.clone());
            }
        }
        media
    }

    /// Nodes of all objects.
    pub fn nodes(&self) -> u32 {
        self.objects.iter().map(|object| object.shape.node_count()).sum()
    }

    /// The environment that lights and deflected rays meet; the background, if the scene names none.
    pub fn environment(&self) -> &Background {
        self.environment.as_ref().unwrap_or(&self.background)
    }

    /// The skies that light the scene: of its sky lights, or of the environment if there are none.
    pub fn skies(&self) -> impl Iterator<Item = AmbientLight<'_>> {
        let environment = self.environment();
        let lights = self.lights.iter().filter_map(|light| light.ambient(environment));
        let has_none = lights.clone().next().is_none();
        lights.chain(has_none.then_some(AmbientLight { from: environment, strength: 1.0 }))
    }

    /// Indices of the sky lights.
    pub fn sky_lights(&self) -> impl Iterator<Item = usize> {
        let environment = self.environment();
        let lights = self.lights.iter().enumerate();
        lights.filter(move |(_, light)| light.ambient(environment).is_some()).map(|(index, _)| index)
    }

    /// Radiance of the light that comes from the skies in a direction.
    pub fn light_of_sky<R: Real>(&self, direction: Vec3<R>) -> Vec3<R> {
        let skies = self.skies().map(|sky| sky.from.radiance(direction) * direction.x.uniform(sky.strength));
        skies.reduce(|sum, sky| sum + sky).expect("a scene has a sky")
    }

    /// Whether some pixel may be less than opaque.
    pub fn is_transparent(&self) -> bool {
        self.background.is_transparent()
    }

    /// Precomputes values that speed up the evaluation of its objects; `moves` is whether frames differ in their
    /// numbers.
    pub fn prepare(&mut self, moves: bool) {
        self.objects.iter_mut().for_each(|object| object.shape.precompute(moves));
        self.background.precompute();
        self.environment.iter_mut().for_each(Background::precompute);
        self.lights.iter_mut().for_each(PlacedLight::precompute);
    }

    /// Errors from the combination of lights, sky and materials: JSON pointers in the scene, and messages.
    pub fn validation_errors(&self) -> Vec<(String, String)> {
        let mut faults = Vec::new();
        if let Some(NodeError { pointer: place, message }) = self.background.fault() {
            faults.push((format!("/background/{place}"), message));
        }
        if let Some(environment) = &self.environment {
            if let Some(NodeError { pointer: place, message }) = environment.fault() {
                faults.push((format!("/environment/{place}"), message));
            }
            if environment.is_transparent() {
                let message = "emits no light: choose a color, a gradient or a day";
                faults.push(("/environment".to_owned(), message.to_owned()));
            }
        }
        for (index, light) in self.lights.iter().enumerate() {
            if let Some(NodeError { pointer: place, message }) = light.fault(self.environment()) {
                faults.push((format!("/lights/{index}/{place}"), message));
            }
        }
        for (index, object) in self.objects.iter().enumerate() {
            self.medium_paint_errors(&object.shape, &mut format!("/objects/{index}/shape"), &mut faults);
        }
        faults
    }

    /// Finds `paint` nodes whose material is a medium, which only a whole object can have.
    fn medium_paint_errors(&self, node: &Node, pointer: &mut String, faults: &mut Vec<(String, String)>) {
        for (placement, material) in node.materials() {
            if self.materials.get(material.slot() as usize).is_some_and(Material::is_medium) {
                let message =
                    "fills a whole object and cannot be painted on part of one: make the part an object of its own";
                faults.push((format!("{pointer}/{}{}", node.name(), material_pointer(placement)), message.to_owned()));
            }
        }
        let length = pointer.len();
        for (child, step) in node.children().iter().zip(child_pointers(node)) {
            step.push_to(pointer);
            self.medium_paint_errors(child, pointer, faults);
            pointer.truncate(length);
        }
    }
}

/// The JSON pointer from a node to one of its children.
#[derive(Clone, Copy, Debug)]
pub struct ChildPointer {
    /// Name of the node.
    name: &'static str,
    /// Index of the child, if the node has a list of them.
    index: Option<usize>,
}

impl ChildPointer {
    /// Appends it to the JSON pointer of the node.
    pub fn push_to(self, pointer: &mut String) {
        let written = match self.index {
            Some(index) => write!(pointer, "/{}/of/{index}", self.name),
            None => write!(pointer, "/{}/child", self.name),
        };
        written.expect("a String takes all that is written");
    }
}

/// The JSON pointers from a node to each of its children.
pub fn child_pointers(node: &Node) -> impl Iterator<Item = ChildPointer> + use<> {
    let (name, is_list) = (node.name(), node.has_child_list());
    (0..node.children().len()).map(move |index| ChildPointer { name, index: is_list.then_some(index) })
}

/// The JSON pointer from a node to the node that it measures.
pub fn base_pointer(node: &Node) -> String {
    format!("/{}/on", node.name())
}

/// The child of a node that a JSON pointer leads into, and the length of the pointer's part up to the child.
pub(crate) fn child_at<'n>(node: &'n Node, pointer: &str) -> Option<(&'n Node, usize)> {
    let mut steps = pointer.split('/').skip(1);
    let (name, list) = (steps.next()?, steps.next()?);
    let length = 2 + name.len() + list.len();
    match (list, node.has_child_list()) {
        ("child", false) => Some((node.children().first()?, length)),
        ("of", true) => {
            let index = steps.next()?;
            Some((node.children().get(index.parse::<usize>().ok()?)?, length + 1 + index.len()))
        }
        ("on", _) => Some((node.base()?, length)),
        _ => None,
    }
}

fn max_steps<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 1, MAX_STEPS, "steps")
}

fn max_bounces<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 0, MAX_BOUNCES, "bounces")
}
