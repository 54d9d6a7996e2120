//! Warnings about textures that do not follow their animated object.

use picture::animation::JobAtFrame;
use picture::nodes::Node;
use picture::scene::child_pointers;

/// Animated shapes whose texture is fixed in another space.
pub(super) fn swims(at_frame: &JobAtFrame<'_>) -> Option<String> {
    let scene = at_frame.scene();
    scene.objects.iter().enumerate().find_map(|(index, object)| {
        let is_textured = |slot: u32| {
            scene.used_materials().get(slot as usize).is_some_and(|material| material.is_textured() && !material.is_medium())
        };
        let mut pointer = format!("/scene/objects/{index}/shape");
        let place = moves_under(&object.shape, is_textured(object.material.slot()), &is_textured, &mut pointer)?;
        let place = at_frame.pointer_in_document(&place);
        Some(format!(
            "the texture does not follow {place}, which is animated: put a `paint` with the material inside the animated node"
        ))
    })
}

/// The first node that is animated inside a fixed texture.
fn moves_under(
    node: &Node,
    is_under_texture: bool,
    is_textured: &impl Fn(u32) -> bool,
    pointer: &mut String,
) -> Option<String> {
    let is_any_textured = node.materials().iter().any(|(_, material)| is_textured(material.slot()));
    let is_under_texture = is_any_textured || (is_under_texture && node.material().is_none());
    if is_under_texture && node.is_placement_animated() && is_bare(node) {
        return Some(format!("{pointer}/{}", node.name()));
    }
    let length = pointer.len();
    node.children().iter().zip(child_pointers(node)).find_map(|(child, step)| {
        step.push_to(pointer);
        let found = moves_under(child, is_under_texture, is_textured, pointer);
        pointer.truncate(length);
        found
    })
}

/// Whether a part of a shape has no paint of its own.
fn is_bare(node: &Node) -> bool {
    node.material().is_none() && (node.children().is_empty() || node.children().iter().any(is_bare))
}
