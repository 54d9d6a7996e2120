//! Warnings about glass and metal: coinciding surfaces, and reflections of an empty background.

use super::objects;
use math::bounds::Bounds;
use math::real::{MaskValue, Vec3, vec3};
use picture::materials::{Material, ShadingPoint};
use picture::nodes::Node;
use picture::scene::Scene;

/// Points tested on each pair of transparent objects.
const GRID_POINTS: usize = 400;
/// Maximum distance of surfaces that count as coinciding, as a fraction of the smaller one's size.
const COINCIDENT: f32 = 2e-5;
/// Maximum number of pairs of objects tested.
const MAX_PAIRS: usize = 32;
/// Objects with a higher evaluation cost are not tested.
const MAX_EVALUATIONS: f32 = 500.0;
/// Fraction of reflected or transmitted light above which a material counts as metal or glass.
const MIN_SENT_ON: f32 = 0.5;

/// Transparent objects whose surfaces coincide.
pub(super) fn touching(scene: &Scene) -> Option<String> {
    let is_clear = |index: &usize| {
        let object = &scene.objects[*index];
        let material = &scene.used_materials()[object.material.slot() as usize];
        material.is_transmissive() && !material.is_medium() && object.shape.evaluation_cost() <= MAX_EVALUATIONS
    };
    let clear: Vec<usize> = (0..scene.objects.len()).filter(is_clear).collect();
    let pairs = clear.iter().enumerate().flat_map(|(n, &one)| clear[n + 1..].iter().map(move |&other| (one, other)));
    let (one, other) = pairs.take(MAX_PAIRS).find(|&(one, other)| {
        let (one, other) = (&scene.objects[one].shape, &scene.objects[other].shape);
        coincide(one, other)
    })?;
    Some(format!(
        "the surfaces of {} coincide, and both transmit light, so that rays cannot tell which they enter: let one overlap the other by a thousandth of its size, or leave a gap",
        objects(scene, &[one, other])
    ))
}

/// Whether two surfaces coincide over an area: then points spread over one of them are on the other.
fn coincide(one: &Node, other: &Node) -> bool {
    let (a, b) = (one.bounds(0.0), other.bounds(0.0));
    let common = a.intersection(b);
    if !common.is_finite() || common.min.x > common.max.x || common.min.y > common.max.y || common.min.z > common.max.z
    {
        return false;
    }
    let size = [a, b].into_iter().filter(|bounds| bounds.is_finite()).map(Bounds::diagonal).fold(f32::MAX, f32::min);
    let tolerance = COINCIDENT * size;
    let mut met = 0;
    for place in 0..GRID_POINTS {
        let Some(p) = on_surface(one, strewn(common, place), tolerance) else { continue };
        if other.distance(p).abs() < tolerance {
            met += 1;
        }
    }
    // Surfaces that only intersect have a line in common, and hardly any point is on that line.
    met >= GRID_POINTS / 40
}

/// A point in a box: Martin Roberts, "The unreasonable effectiveness of quasirandom sequences",
/// <https://extremelearning.com.au/unreasonable-effectiveness-of-quasirandom-sequences/>.
fn strewn(bounds: Bounds, number: usize) -> Vec3<f32> {
    let along = |step: f64, low: f32, high: f32| {
        let share = (0.5 + step * (number + 1) as f64).fract() as f32;
        low + share * (high - low)
    };
    let (low, high) = (bounds.min, bounds.max);
    vec3(
        along(0.819_172_513_396_164_4, low.x, high.x),
        along(0.671_043_606_703_789_2, low.y, high.y),
        along(0.549_700_477_901_970_5, low.z, high.z),
    )
}

/// A point of the surface near `p`, found by Newton's method along the gradient.
fn on_surface(node: &Node, mut p: Vec3<f32>, tolerance: f32) -> Option<Vec3<f32>> {
    for _ in 0..8 {
        let distance = node.distance(p);
        if distance.abs() < tolerance * 0.25 {
            return Some(p);
        }
        let h = (distance.abs() * 0.1).max(tolerance);
        let slope = |offset: Vec3<f32>| (node.distance(p + offset) - node.distance(p - offset)) / (2.0 * h);
        let gradient = vec3(slope(vec3(h, 0.0, 0.0)), slope(vec3(0.0, h, 0.0)), slope(vec3(0.0, 0.0, h)));
        let square = gradient.dot(gradient);
        if square.is_nan() || square < 1e-4 {
            return None;
        }
        p = p - gradient * (distance / square);
    }
    None
}

/// Metal or glass in front of a transparent background, which reflects only other objects.
pub(super) fn nothing_to_mirror(scene: &Scene) -> Option<String> {
    if !scene.is_transparent() || scene.environment.is_some() {
        return None;
    }
    let slots = scene.used_materials();
    let shiny: Vec<usize> = (0..scene.objects.len())
        .filter(|&index| slots.get(scene.objects[index].material.slot() as usize).is_some_and(is_shiny))
        .collect();
    let (first, _) = shiny.split_first()?;
    Some(format!(
        "/scene/background is transparent, and {} of metal or glass reflect it as black (the first is /scene/objects/{first}): give the scene an `environment`, which reflections see and the camera does not",
        objects(scene, &shiny)
    ))
}

fn is_shiny(material: &Material) -> bool {
    let up = vec3(0.0, 0.0, 1.0);
    let place = ShadingPoint {
        normal: up,
        to_viewer: up,
        local_point: vec3(0.0, 0.0, 0.0),
        local_normal: up,
        footprint: [vec3(0.0, 0.0, 0.0); 2],
        camera_t: 1.0,
        is_inside: MaskValue(false),
    };
    material
        .specular(&place)
        .is_some_and(|finish| finish.f0.max_element() > MIN_SENT_ON || finish.transmission.max_element() > MIN_SENT_ON)
}
