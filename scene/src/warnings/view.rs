//! Warnings about the camera position and about what its rays hit.

use super::{Warning, WarningKind, objects};
use math::real::Vec3;
use picture::animation::JobAtFrame;
use picture::camera::View;
use picture::film::{Film, ImageSpec};
use picture::materials::MaterialRef;
use picture::nodes::Node;
use picture::scene::Scene;
use trace::integrator::Integrator;

/// Maximum fraction of rays that may run out of steps.
const MAX_OUT_OF_STEPS: f32 = 0.01;
/// Scenes with a higher evaluation cost, in simple nodes, are not probed.
const MAX_COST: f32 = 200_000.0;

/// Warning about the view. If nothing is in view, only that is reported.
pub(super) fn of(at_frame: &JobAtFrame<'_>) -> Option<Warning> {
    let (scene, image) = (at_frame.scene(), at_frame.image());
    let &ImageSpec { width, height, .. } = image;
    let view = scene.camera.view(width, height);
    if let Some(text) = nothing_in_view(scene, &view) {
        return Some(Warning { kind: WarningKind::NothingInView, text });
    }
    let work: f32 = scene.objects.iter().map(|object| object.shape.evaluation_cost()).sum();
    if work > MAX_COST {
        return None;
    }
    if let Some(text) = inside(scene, image.film(), &view) {
        return Some(Warning { kind: WarningKind::CameraInside, text });
    }
    let program = Integrator::new(at_frame);
    let share = program.fraction_out_of_steps(width, height, work)?;
    (share > MAX_OUT_OF_STEPS).then(|| Warning { kind: WarningKind::OutOfSteps, text: out_of_steps(scene, share) })
}

fn nothing_in_view(scene: &Scene, view: &View) -> Option<String> {
    let farthest = scene.march.max_distance.in_frame();
    let mut is_one_beyond = false;
    for object in &scene.objects {
        let bounds = object.shape.bounds(0.0);
        if view.is_outside_view(bounds) {
            continue;
        }
        if !view.is_farther_than(bounds, farthest) {
            return None;
        }
        is_one_beyond = true;
    }
    Some(if is_one_beyond {
        format!(
            "no object is visible: all objects in view are farther away than march.max_distance, {farthest}: raise it, or move the camera nearer"
        )
    } else {
        "no object is visible: all objects are outside the view: change camera.position, look_at or the field of view"
            .to_owned()
    })
}

/// Objects that contain the camera, or part of an orthographic picture's plane, or part of the lens.
fn inside(scene: &Scene, film: Film<'_>, view: &View) -> Option<String> {
    let origins = view.ray_origins(film.width, film.height);
    if let Some(around) = solid_around(scene, &origins) {
        let (what, cure) = match origins.as_slice() {
            [_] => ("the camera is inside", "move camera.position out of it"),
            _ => ("part of the picture starts inside", "move camera.position back"),
        };
        return Some(format!("{what} {around}, so that only its inside is visible: {cure}, or cut a room into it"));
    }
    let on_rim: Vec<Vec3<f32>> = origins.into_iter().flat_map(|origin| view.rim_of_lens(origin)).collect();
    let around = solid_around(scene, &on_rim)?;
    Some(format!(
        "part of the lens is inside {around}, whose inside veils the picture: make the aperture of camera.lens smaller, or move camera.position away from it"
    ))
}

/// Opaque objects that contain one of these origins of rays, by their pointers.
fn solid_around(scene: &Scene, origins: &[Vec3<f32>]) -> Option<String> {
    let solid = scene.objects.iter().enumerate().filter(|(_, object)| {
        let material = &scene.used_materials()[object.material.slot() as usize];
        !material.is_medium() && !material.is_transmissive() && !is_transmissive(scene, &object.shape)
    });
    let around: Vec<usize> = solid
        .filter(|(_, object)| {
            let bounds = object.shape.bounds(0.0);
            let mut near = origins.iter().filter(|&&origin| bounds.contains(origin));
            near.any(|&origin| object.shape.distance(origin) <= 0.0)
        })
        .map(|(index, _)| index)
        .collect();
    (!around.is_empty()).then(|| objects(scene, &around))
}

/// Whether a part of a shape is painted with a transmissive material.
fn is_transmissive(scene: &Scene, node: &Node) -> bool {
    let is_clear = |material: &MaterialRef| scene.used_materials()[material.slot() as usize].is_transmissive();
    node.materials().iter().any(|(_, material)| is_clear(material))
        || node.children().iter().any(|child| is_transmissive(scene, child))
}

fn out_of_steps(scene: &Scene, share: f32) -> String {
    let max_steps = scene.march.max_steps;
    let percent = (share * 100.0).round().max(1.0);
    format!(
        "about {percent} % of the rays run out of steps before they hit a surface or miss all of them, and show the background: raise march.max_steps above {max_steps}, or show fewer surfaces at grazing angles"
    )
}
