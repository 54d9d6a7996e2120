//! Warnings about differences that are empty.

use math::real::{Vec3, vec3};
use picture::animation::JobAtFrame;
use picture::kinds::Exactness;
use picture::nodes::Node;
use picture::scene::child_pointers;

/// Maximum number of boxes tested in one difference.
const MAX_BOXES: usize = 512;
/// Maximum number of boxes tested in all differences of a scene.
const MAX_ALL_BOXES: usize = 8192;
/// Objects with a higher evaluation cost are not tested.
const MAX_EVALUATIONS: f32 = 2000.0;

/// A difference that is empty.
pub(super) fn difference(at_frame: &JobAtFrame<'_>) -> Option<String> {
    let scene = at_frame.scene();
    let mut boxes_left = MAX_ALL_BOXES;
    scene.objects.iter().enumerate().find_map(|(index, object)| {
        let mut pointer = format!("/scene/objects/{index}/shape");
        let place = empty_difference(&object.shape, &mut pointer, &mut boxes_left)?;
        let place = at_frame.pointer_in_document(&place);
        Some(format!(
            "{place} is empty: the shapes subtracted from the first one remove all of it; change their order or their sizes"
        ))
    })
}

fn empty_difference(node: &Node, pointer: &mut String, boxes_left: &mut usize) -> Option<String> {
    if node.subtracts() && is_empty(node, boxes_left) {
        return Some(format!("{pointer}/{}", node.name()));
    }
    let length = pointer.len();
    node.children().iter().zip(child_pointers(node)).find_map(|(child, step)| {
        step.push_to(pointer);
        let found = empty_difference(child, pointer, boxes_left);
        pointer.truncate(length);
        found
    })
}

/// Whether a shape provably has no inside: a box is outside it if the distance at the box's center, over the Lipschitz
/// factor, is more than half its diagonal. Other boxes are halved.
fn is_empty(node: &Node, boxes_left: &mut usize) -> bool {
    let bounds = node.bounds(0.0);
    let lipschitz = node.lipschitz();
    if !bounds.is_finite()
        || node.exactness() == Exactness::Estimate
        || node.evaluation_cost() > MAX_EVALUATIONS
        || lipschitz.is_nan()
    {
        return false;
    }
    let mut boxes = vec![(bounds.min, bounds.max)];
    for _ in 0..MAX_BOXES.min(*boxes_left) {
        let Some((low, high)) = boxes.pop() else { return true };
        *boxes_left -= 1;
        let middle: Vec3<f32> = (low + high) * 0.5;
        let half = (high - low) * 0.5;
        let distance = node.distance(middle);
        if distance <= 0.0 || distance.is_nan() {
            return false;
        }
        if distance > lipschitz * half.length() {
            continue;
        }
        boxes.extend(halves(low, high, half));
    }
    false
}

/// Both halves of a box, cut across its longest edge.
fn halves(low: Vec3<f32>, high: Vec3<f32>, half: Vec3<f32>) -> [(Vec3<f32>, Vec3<f32>); 2] {
    let longest = half.x.max(half.y).max(half.z);
    let cut = |from: Vec3<f32>, by: f32| {
        if half.x >= longest {
            vec3(from.x + by * half.x, from.y, from.z)
        } else if half.y >= longest {
            vec3(from.x, from.y + by * half.y, from.z)
        } else {
            vec3(from.x, from.y, from.z + by * half.z)
        }
    };
    [(low, cut(high, -1.0)), (cut(low, 1.0), high)]
}
