//! Replaces the groups of a document by objects in `translate` and `rotate` nodes, lights with placements, and a camera
//! with placements.

use std::collections::BTreeMap;

use super::{SemanticErrors, names};
use crate::document::SceneDocument;
use crate::groups::Group;
use crate::lights::PlacedLight;
use crate::limits::MAX_GROUP_DEPTH;
use crate::materials::{Material, MaterialRef};
use crate::nodes::{Node, rotation_error};
use crate::scene::Object;
use crate::values::Placement;
use crate::written::{GroupPointers, Moved};

/// Replaces the groups of a scene; `lights` gets all of its lights. Returns where their contents were.
pub(super) fn flatten(scene: &mut SceneDocument, faults: &mut SemanticErrors) -> (Vec<PlacedLight>, GroupPointers) {
    let mut flat = Flat {
        lights: std::mem::take(&mut scene.lights).into_iter().map(PlacedLight::from).collect(),
        objects: std::mem::take(&mut scene.objects),
        camera: None,
        materials: &scene.materials,
        pointers: GroupPointers::default(),
        faults,
    };
    for (index, group) in std::mem::take(&mut scene.groups).into_iter().enumerate() {
        flat.group(group, &format!("/groups/{index}"), &mut Vec::new());
    }
    let Flat { lights, objects, camera, pointers, .. } = flat;
    scene.objects = objects;
    scene.camera.placements = camera.unwrap_or_default();
    (lights, pointers)
}

struct Flat<'a> {
    lights: Vec<PlacedLight>,
    objects: Vec<Object>,
    camera: Option<Vec<Placement>>,
    materials: &'a BTreeMap<String, Material>,
    pointers: GroupPointers,
    faults: &'a mut SemanticErrors,
}

impl Flat<'_> {
    /// Adds what is in a group; `outer` has the groups around it.
    fn group(&mut self, group: Group, pointer: &str, outer: &mut Vec<(Placement, String)>) {
        self.check(&group, pointer, outer.len());
        outer.push((group.placement(), pointer.to_owned()));
        let Group { objects, lights, camera, groups, name: _, by: _, degrees: _, axis: _, about: _ } = group;
        let placements = || outer.iter().map(|(placement, _)| placement.clone()).collect::<Vec<_>>();
        if camera && self.camera.is_none() {
            self.camera = Some(placements());
        }
        for (index, light) in lights.into_iter().enumerate() {
            let written = format!("{pointer}/lights/{index}");
            if light.is_of_environment() {
                let message = "is the light of the environment, which is in no group: move it to the scene's lights";
                self.faults.push((format!("/scene{written}"), message.to_owned()));
            }
            let place = format!("/lights/{}", self.lights.len());
            self.pointers.moved.insert(place, Moved { written, around: Vec::new() });
            self.lights.push(PlacedLight { light, placements: placements() });
        }
        for (index, object) in objects.into_iter().enumerate() {
            let written = format!("{pointer}/objects/{index}");
            let is_textured = self.is_textured(&object.material);
            let (object, around) = placed(object, outer, is_textured);
            let place = format!("/objects/{}", self.objects.len());
            self.pointers.moved.insert(place, Moved { written, around });
            self.objects.push(object);
        }
        for (index, inner) in groups.into_iter().enumerate() {
            if outer.len() < MAX_GROUP_DEPTH {
                self.group(inner, &format!("{pointer}/groups/{index}"), outer);
            }
        }
        outer.pop();
    }

    fn check(&mut self, group: &Group, pointer: &str, depth: usize) {
        let mut fault = |key: &str, message: String| self.faults.push((format!("/scene{pointer}{key}"), message));
        if let Some(message) = group.name.as_deref().and_then(names::object_name_error) {
            fault("/name", message);
        }
        if depth + 1 == MAX_GROUP_DEPTH && !group.groups.is_empty() {
            fault("/groups", format!("nests groups deeper than {MAX_GROUP_DEPTH}: move them into an outer group"));
        }
        if let Some(error) = group.degrees.as_ref().and_then(|degrees| rotation_error(degrees, group.axis.as_ref())) {
            fault(&format!("/{}", error.pointer), error.message);
        }
        if group.degrees.is_none() && (group.axis.is_some() || group.about.is_some()) {
            let key = if group.axis.is_some() { "/axis" } else { "/about" };
            fault(key, "has no effect without `degrees`: add the angle, or leave it out".to_owned());
        }
        if group.camera && self.camera.is_some() {
            fault("/camera", "the camera belongs to another group already: leave it out of one of them".to_owned());
        }
        let is_empty = group.objects.is_empty() && group.lights.is_empty() && !group.camera && group.groups.is_empty();
        if is_empty {
            fault("", "is empty: add objects, lights, groups or \"camera\": true".to_owned());
        }
    }

    /// Whether a material has textures, which follow the shape only if it is painted.
    fn is_textured(&self, material: &MaterialRef) -> bool {
        let material = match material {
            MaterialRef::Name(name) => self.materials.get(name),
            MaterialRef::InPlace(material) => Some(&**material),
            MaterialRef::Slot(_) => None,
        };
        material.is_some_and(|material| material.is_textured() && !material.is_medium())
    }
}

/// An object inside the nodes that place it, and their names with the pointers of their groups, the outermost first.
fn placed(object: Object, outer: &[(Placement, String)], is_textured: bool) -> (Object, Vec<(&'static str, String)>) {
    let Object { material, mut shape, name, visible, light_group } = object;
    let mut around = Vec::new();
    if is_textured {
        shape = Node::painted(material.clone(), shape);
        around.push(("paint", String::new()));
    }
    for (placement, pointer) in outer.iter().rev() {
        let (placed, names) = shape.placed(placement);
        shape = placed;
        around.extend(names.into_iter().map(|name| (name, pointer.clone())));
    }
    around.reverse();
    (Object { material, shape, name, visible, light_group }, around)
}

/// Number of the lights of some groups.
pub(super) fn light_count(groups: &[Group]) -> usize {
    groups.iter().map(|group| group.lights.len() + light_count(&group.groups)).sum()
}
