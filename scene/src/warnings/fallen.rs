//! Warnings about scattered copies that missed what they should be on.

use picture::animation::JobAtFrame;
use picture::nodes::Node;
use picture::scene::child_pointers;

/// A scatter with some copies far below most others.
pub(super) fn copies(at_frame: &JobAtFrame<'_>) -> Option<String> {
    at_frame.scene().objects.iter().enumerate().find_map(|(index, object)| {
        let mut pointer = format!("/scene/objects/{index}/shape");
        let (middle, lowest) = fallen(&object.shape, &mut pointer)?;
        let place = at_frame.pointer_in_document(&pointer);
        Some(format!(
            "{place} puts copies at a height of {lowest}, but most at {middle} or above: they missed what the others are on; make `within` smaller, or `on` larger"
        ))
    })
}

fn fallen(node: &Node, pointer: &mut String) -> Option<(f32, f32)> {
    if let Some(heights) = node.fallen_copies() {
        pointer.push('/');
        pointer.push_str(node.name());
        return Some(heights);
    }
    let length = pointer.len();
    node.children().iter().zip(child_pointers(node)).find_map(|(child, step)| {
        pointer.truncate(length);
        step.push_to(pointer);
        fallen(child, pointer)
    })
}
