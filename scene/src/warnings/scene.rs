//! Warnings about shapes, materials and lights that do not fit together.

use super::objects;
use math::real::vec3;
use picture::animation::JobAtFrame;
use picture::job::Job;
use picture::lights::{PlacedLight, default_lights};
use picture::limits::MAX_MEDIUM_STEPS;
use picture::materials::Material;
use picture::nodes::Node;
use picture::scene::{Scene, child_pointers};
use picture::transport::Transport;
use picture::visible::RayKind;

/// Lipschitz factor above which a shape gets a warning.
const STEEPEST: f32 = 20.0;
/// Evaluation cost, in nodes, above which an object gets a warning.
const MAX_COST: f32 = 1e6;
/// Maximum optical depth of one step of a medium: exp(−8), about 1/3000 of the light, is left.
const MAX_STEP_DEPTH: f32 = 8.0;
/// Bounces needed to enter and leave a transparent object.
const MIN_GLASS_BOUNCES: u32 = 2;

/// Nested copies that take too long.
pub(super) fn high_cost(scene: &Scene) -> Option<String> {
    let works: Vec<f32> = scene.objects.iter().map(|object| object.shape.evaluation_cost()).collect();
    let heavy: Vec<usize> = (0..works.len()).filter(|&index| works[index] > MAX_COST).collect();
    if heavy.is_empty() {
        return None;
    }
    Some(format!(
        "one evaluation of {} visits more than {MAX_COST:e} nodes, nested copies included, and rendering may take too long: repeat shapes smaller than their cell, and use fewer copies of copies",
        objects(scene, &heavy)
    ))
}

/// Objects whose Lipschitz factor makes steps tiny.
pub(super) fn high_lipschitz(at_frame: &JobAtFrame<'_>) -> Option<String> {
    let scene = at_frame.scene();
    let all: Vec<f32> = scene.objects.iter().map(|object| object.shape.lipschitz()).collect();
    let steep: Vec<usize> = (0..all.len()).filter(|&index| all[index] > STEEPEST).collect();
    let steepest = steep.iter().copied().reduce(|a, b| if all[b] > all[a] { b } else { a })?;
    let mut pointer = format!("/scene/objects/{steepest}/shape");
    let cure = main_cause(&scene.objects[steepest].shape, &mut pointer).lipschitz_advice();
    let pointer = at_frame.pointer_in_document(&pointer);
    let others = if steep.len() > 1 { format!(" (also near {})", objects(scene, &steep)) } else { String::new() };
    let lipschitz = all[steepest];
    let part = if lipschitz < 1e6 { format!("1/{lipschitz:.0}") } else { "less than a millionth".to_owned() };
    Some(format!("steps near {pointer} are {part} of the distance{others}, and rendering is slow: {cure}"))
}

/// The node that causes most of an object's Lipschitz factor, and its JSON pointer.
fn main_cause<'a>(node: &'a Node, pointer: &mut String) -> &'a Node {
    let own = node.lipschitz();
    let children = node.children().iter().zip(child_pointers(node));
    match children.reduce(|a, b| if b.0.lipschitz() > a.0.lipschitz() { b } else { a }) {
        Some((child, step)) if child.lipschitz() > 0.5 * own => {
            step.push_to(pointer);
            main_cause(child, pointer)
        }
        _ => {
            pointer.push('/');
            pointer.push_str(node.name());
            node
        }
    }
}

/// Whether lights are the default ones, of a scene that names none.
fn is_default(lights: &[PlacedLight]) -> bool {
    lights.iter().all(|light| light.placements.is_empty())
        && lights.iter().map(|light| &light.light).eq(&default_lights())
}

/// Lights without effect, and materials without light.
pub(super) fn light(scene: &Scene) -> Option<String> {
    let used = scene.used_materials();
    if !scene.lights.is_empty() && !is_default(&scene.lights) && !used.iter().any(Material::uses_lights) {
        return Some(
            "the lights have no effect, because no material in use depends on light: choose diffuse or surface, or remove lights"
                .to_owned(),
        );
    }
    let shines = scene.lights.iter().any(|light| !light.options().is_dark)
        || (scene.integrator.is_path() && (shines_itself(scene) || is_sky_bright(scene)));
    if !shines && used.iter().any(Material::is_black_without_light) {
        let lack = if scene.lights.is_empty() { "there is no light" } else { "all lights are black" };
        return Some(format!(
            "{lack}, and the materials need light: add a light to scene.lights, or remove lights for the default lights"
        ));
    }
    None
}

/// Ambient light of a material's own, which paths of light do not have.
pub(super) fn lost_ambient(job: &Job) -> Option<String> {
    if !job.scene.integrator.is_path() {
        return None;
    }
    let mut materials = job.scene.used_materials().iter().zip(&job.material_pointers);
    let (_, pointer) = materials.find(|(material, _)| material.has_own_ambient())?;
    Some(format!(
        "/scene{pointer} has ambient light of its own, which has no effect with `integrator` path, where light comes from lights and surfaces: use `surface` with `emission` if it shines, or leave out `ka` and `ambient`"
    ))
}

/// Whether a material emits light.
fn shines_itself(scene: &Scene) -> bool {
    scene.used_materials().iter().any(|material| !material.is_black_without_light() && !material.has_own_ambient())
}

/// Whether light comes from the environment: paths of light meet it.
fn is_sky_bright(scene: &Scene) -> bool {
    let directions = [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [-0.6, 0.0, 0.8]];
    directions.into_iter().any(|[x, y, z]| scene.environment().radiance(vec3(x, y, z)).max_element() > 0.0)
}

/// Lights with a place inside an opaque object, which keeps their light.
pub(super) fn enclosed_lights(scene: &Scene) -> Option<String> {
    /// Objects with a higher evaluation cost are not tested.
    const MAX_EVALUATIONS: f32 = 1e4;
    scene.lights.iter().enumerate().find_map(|(index, light)| {
        let options = light.options();
        let (center, radius) = light.place_in_scene().filter(|_| options.casts_shadows && !options.is_dark)?;
        let within = (0..scene.objects.len()).find(|&index| {
            let (material, object) = (scene.material_of(index), &scene.objects[index]);
            let enclosed = -radius - 1e-4 - 1e-3 * radius;
            let is_opaque = !material.is_medium() && !material.is_transmissive() && object.visible.to(RayKind::Shadow);
            is_opaque && object.shape.evaluation_cost() <= MAX_EVALUATIONS && object.shape.distance(center) < enclosed
        })?;
        Some(format!(
            "/scene/lights/{index} is inside {}, which keeps its light: move it, or give the object a `material` that shines",
            objects(scene, &[within])
        ))
    })
}

/// Clouds and volumes that are too dense for their steps.
pub(super) fn dense_media(scene: &Scene) -> Option<String> {
    let depths = scene.objects.iter().enumerate().filter_map(|(index, object)| {
        let filling = scene.material_of(index).as_medium()?;
        let bounds = object.shape.bounds(0.0);
        let length = if bounds.is_finite() { bounds.diagonal() } else { scene.march.max_distance.in_frame() };
        let depth = filling.density() * length;
        (depth > MAX_STEP_DEPTH * filling.steps() as f32).then_some((index, depth, filling.steps()))
    });
    let thick: Vec<(usize, f32, u32)> = depths.collect();
    let &(_, depth, steps) = thick.first()?;
    let indices: Vec<usize> = thick.iter().map(|&(index, ..)| index).collect();
    let enough = (depth / MAX_STEP_DEPTH).ceil();
    let cure = if enough <= MAX_MEDIUM_STEPS as f32 {
        format!("raise its steps to {enough} or more, or lower its density")
    } else {
        "lower its density, or make it smaller".to_owned()
    };
    Some(format!(
        "the medium that fills {} is too dense for its {steps} steps: one step has an optical depth of {:.0} (density × step): {cure}",
        objects(scene, &indices),
        depth / steps as f32
    ))
}

/// Glass through which no ray gets because of the bounce limit.
pub(super) fn bounces(scene: &Scene) -> Option<String> {
    let lets_through = |material: &&Material| material.is_transmissive() && !material.is_medium();
    scene.used_materials().iter().find(lets_through)?;
    let (most, name) = match &scene.integrator {
        Transport::Direct => (scene.march.max_bounces, "march.max_bounces"),
        Transport::Path(path) => (path.max_bounces, "integrator.path.max_bounces"),
    };
    (most < MIN_GLASS_BOUNCES).then(|| {
        format!("rays end inside glass, because {name} is {most} and glass needs {MIN_GLASS_BOUNCES}: raise it")
    })
}
