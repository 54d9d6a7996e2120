//! Warnings about numbers in another tool's units: colors from 0 to 255, and angles in radians.

use serde_json::Value;

use picture::animation::JobAtFrame;
use picture::nodes::Node;
use picture::scene::{Scene, child_pointers};
use picture::values::FieldOfView;

/// Names of colors that are reflectances, which cannot be much above 1.
const REFLECTANCES: [&str; 7] = ["albedo", "base_color", "colors", "ka", "kd", "ks", "ramp"];
/// Minimum integer channel that indicates a range of 0 to 255.
const MIN_OF_255: f64 = 16.0;
/// A field of view below this, in degrees, is probably in radians.
const MIN_FOV: f32 = 3.2;
/// Angles in radians are expected to be multiples of π over this number.
const PARTS_OF_PI: f64 = 12.0;
/// Maximum deviation from such a multiple, in multiples.
const MAX_BESIDE: f64 = 0.01;

/// Colors whose channels have a range of 0 to 255.
pub(super) fn colors_of_255(scene: &Scene) -> Option<String> {
    for (index, object) in scene.objects.iter().enumerate() {
        let material = scene.used_materials().get(object.material.slot() as usize)?;
        if material.is_medium() {
            continue;
        }
        let value = serde_json::to_value(material).ok()?;
        if let Some((pointer, color)) = color_of_255(&value, &mut String::new(), false) {
            let [red, green, blue] = color.map(|channel| (channel / 255.0 * 1000.0).round() / 1000.0);
            let [r, g, b] = color;
            return Some(format!(
                "the color [{r}, {g}, {b}] at {pointer} of the material of object {index} has a range of 0 to 255, but colors go from 0 to 1: write [{red}, {green}, {blue}], or \"#{:02x}{:02x}{:02x}\" if it is in sRGB",
                r as u8, g as u8, b as u8
            ));
        }
    }
    None
}

fn color_of_255(value: &Value, pointer: &mut String, is_reflectance: bool) -> Option<(String, [f64; 3])> {
    let length = pointer.len();
    match value {
        Value::Array(entries) => {
            let channels: Vec<f64> = entries.iter().filter_map(Value::as_f64).collect();
            if let (true, &[r, g, b]) = (is_reflectance && entries.len() == 3, channels.as_slice()) {
                let is_whole = channels.iter().all(|channel| channel.fract() == 0.0 && *channel <= 255.0);
                let is_large = channels.iter().any(|channel| *channel >= MIN_OF_255);
                return (is_whole && is_large).then(|| (pointer.clone(), [r, g, b]));
            }
            entries.iter().enumerate().find_map(|(index, entry)| {
                pointer.push('/');
                pointer.push_str(&index.to_string());
                let found = color_of_255(entry, pointer, is_reflectance);
                pointer.truncate(length);
                found
            })
        }
        Value::Object(members) => members.iter().find_map(|(key, value)| {
            pointer.push('/');
            pointer.push_str(key);
            let found = color_of_255(value, pointer, REFLECTANCES.contains(&key.as_str()));
            pointer.truncate(length);
            found
        }),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => None,
    }
}

/// Angles that are in radians.
pub(super) fn radians(at_frame: &JobAtFrame<'_>) -> Option<String> {
    let scene = at_frame.scene();
    if let Some(fov) = scene.camera.fov.as_ref().and_then(FieldOfView::constant).filter(|&fov| fov < MIN_FOV) {
        let degrees = f64::from(fov).to_degrees().round();
        return Some(format!(
            "/scene/camera/fov is {fov} degrees, a very narrow view: if it is in radians, write {degrees}, its degrees"
        ));
    }
    scene.objects.iter().enumerate().find_map(|(index, object)| {
        let mut pointer = format!("/scene/objects/{index}/shape");
        let (place, rest) = rotation_in_radians(&object.shape, &mut pointer)?;
        Some(format!("{}{rest}", at_frame.pointer_in_document(&place)))
    })
}

/// JSON pointer of a rotation whose angles are in radians, and the rest of the warning.
fn rotation_in_radians(node: &Node, pointer: &mut String) -> Option<(String, String)> {
    if node.name() == "rotate"
        && let Some(angles) = angles_of(node).filter(|angles| are_radians(angles))
    {
        let degrees: Vec<String> = angles.iter().map(|angle| format!("{}", angle.to_degrees().round())).collect();
        let angles: Vec<String> = angles.iter().map(ToString::to_string).collect();
        let rest = format!(
            " is [{}], which looks like radians: write [{}], the degrees",
            angles.join(", "),
            degrees.join(", ")
        );
        return Some((format!("{pointer}/rotate/degrees"), rest));
    }
    let length = pointer.len();
    node.children().iter().zip(child_pointers(node)).find_map(|(child, step)| {
        step.push_to(pointer);
        let found = rotation_in_radians(child, pointer);
        pointer.truncate(length);
        found
    })
}

/// Angles of a constant rotation, as written.
fn angles_of(node: &Node) -> Option<Vec<f64>> {
    let value = serde_json::to_string(node.rotation()?).ok()?;
    let angles: Vec<Value> = serde_json::from_str(&value).ok()?;
    angles.iter().map(Value::as_f64).collect()
}

/// Whether all angles other than 0 are unusual in degrees and fractions of π in radians.
fn are_radians(angles: &[f64]) -> bool {
    let mut nonzero = angles.iter().filter(|angle| **angle != 0.0).peekable();
    nonzero.peek().is_some()
        && nonzero.all(|angle| {
            let parts = angle / std::f64::consts::PI * PARTS_OF_PI;
            angle.abs() < 6.3
                && angle.fract() != 0.0
                && parts.round() != 0.0
                && (parts - parts.round()).abs() < MAX_BESIDE
        })
}
