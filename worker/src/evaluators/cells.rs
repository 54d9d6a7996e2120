//! Tests that the cells of a scene, recorded, give the reference's bits, and that a scene's text does not grow with it.

use scene::Integrator;
use scene::bounds::Bounds;
use scene::cells::{CellBuilder, Cells, Program, ScalarBuilder};
use scene::nodes::Node;
use scene::real::vec3;

use super::*;
use crate::cells::FastBuilder;

/// The first frame of a job as cells; it lives as long as the test.
fn cells_of(text: &[u8], how: &dyn CellBuilder) -> Option<&'static Cells<'static>> {
    let job = Box::leak(Box::new(scene::parse(text).expect("a valid job")));
    let at_frame = Box::leak(Box::new(job.at(0).expect("a valid frame")));
    let objects: Vec<_> = (0..at_frame.scene().objects.len()).map(|index| (index, None)).collect();
    let cells = Cells::new(Program::new(at_frame.scene(), &objects)?, Bounds::symmetric(40.0, 40.0, 40.0), how);
    Some(Box::leak(Box::new(cells)))
}

fn formula_of(name: &str, cells: &'static Cells<'static>) -> Formula {
    let at = |[x, y, z]: [Expr; 3]| cells.distance(vec3(x, y, z));
    Formula::new(name, at, |[x, y, z]| cells.whole_distance(vec3(x, y, z)))
}

/// A job of one smooth union of many balls and boxes, some of them painted.
pub(crate) fn many(count: u32) -> String {
    let shape = |index: u32| {
        let place = |salt: u32| (index * salt % 1009) as f32 / 252.0 - 2.0;
        let solid = if index.is_multiple_of(3) {
            r#"{ "box": { "size": [0.1, 0.2, 0.1] } }"#
        } else {
            r#"{ "sphere": { "radius": 0.08 } }"#
        };
        let rotated = format!(r#"{{ "rotate": {{ "degrees": [{}, 0, 20], "child": {solid} }} }}"#, index % 90);
        let rotated = match index % 7 {
            paint @ (2 | 4 | 5) => {
                let material = ["red", "blue", "tiles"][paint as usize / 2 - 1 + paint as usize % 2];
                format!(r#"{{ "paint": {{ "material": "{material}", "child": {rotated} }} }}"#)
            }
            _ => rotated,
        };
        format!(r#"{{ "translate": {{ "by": [{}, {}, {}], "child": {rotated} }} }}"#, place(17), place(101), place(541))
    };
    let shapes: Vec<String> = (0..count).map(shape).collect();
    format!(
        r##"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }}, "materials": {{
             "red": {{ "diffuse": {{ "kd": "#c03020" }} }}, "blue": {{ "diffuse": {{ "kd": "#2040c0" }} }},
             "tiles": {{ "diffuse": {{ "kd": {{ "checker": {{ "cell": 0.05, "colors": ["#b5432f", "#e8dcc0"] }} }} }} }} }},
           "objects": [ {{ "shape": {{ "union": {{ "smooth": 0.05, "of": [{}] }} }} }},
           {{ "shape": {{ "plane": {{ "normal": [0, 1, 0], "offset": -0.6 }} }} }},
           {{ "shape": {{ "copies": {{ "child": {{ "union": {{ "of": [
                {{ "sphere": {{ "radius": 0.2 }} }}, {{ "box": {{ "size": [0.5, 0.1, 0.1] }} }} ] }} }},
              "at": [ {{ "by": [1, 1, 1], "scale": 0.5 }}, {{ "by": [-1, 0.5, 1.5], "degrees": [0, 40, 0] }} ] }} }} }}
           ] }}, "image": {{ "width": 8, "height": 8 }} }}"##,
        shapes.join(",")
    )
}

#[test]
fn cells_of_every_shipped_scene_give_the_reference_bits() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes");
    for entry in std::fs::read_dir(folder).expect("the scenes are there") {
        let path = entry.expect("a folder can be read").path();
        if path.extension().is_some_and(|extension| extension == "json")
            && let Some(cells) = cells_of(&std::fs::read(&path).expect("a job file"), &FastBuilder::UNLIMITED)
        {
            compare_packets(&formula_of(&path.display().to_string(), cells), 2);
        }
    }
}

/// Each node as a leaf, in three places: two rows of one formula, and one that is scaled.
#[test]
fn every_node_can_be_a_leaf() {
    let mut cut = 0;
    for example in Node::examples() {
        let text = format!(
            r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }},
               "shapes": {{ "leg": {{ "sphere": {{ "radius": 0.3 }} }} }}, "objects": [ {{ "shape": {{ "union": {{ "of": [
                 {{ "translate": {{ "by": [2, 0, 0], "child": {0} }} }},
                 {{ "translate": {{ "by": [-2, 1, 0], "child": {0} }} }},
                 {{ "scale": {{ "by": 0.5, "child": {0} }} }} ] }} }} }} ] }}, "image": {{ "width": 8, "height": 8 }} }}"#,
            example.json
        );
        if let Some(cells) = cells_of(text.as_bytes(), &FastBuilder::UNLIMITED) {
            cut += 1;
            compare_packets(&formula_of(example.kind, cells), 1);
        }
    }
    assert!(cut > 100, "only {cut} examples were cut into leaves");
}

#[test]
fn the_text_of_many_shapes_is_that_of_few() {
    let [few, many] = [40, 400]
        .map(|count| formula_of("shapes", cells_of(many(count).as_bytes(), &FastBuilder::UNLIMITED).expect("cells")));
    assert!(few.tape.has_same_code(&many.tape), "the tape of 400 shapes differs from that of 40");
    compare_packets(&many, 4);
}

#[test]
fn machine_code_and_the_reference_build_the_same_cells() {
    let job = many(500);
    let [fast, scalar] =
        [&FastBuilder::UNLIMITED as &dyn CellBuilder, &ScalarBuilder].map(|how| cells_of(job.as_bytes(), how));
    let [fast, scalar] = [fast, scalar].map(|cells| {
        let tree = cells.expect("cells").tree();
        tree.words().make_all();
        tree.checksum()
    });
    assert_eq!(fast, scalar, "the cells differ");
}

/// A pixel of 8 × 8 from numbers between -2 and 2.
fn place<R: Real>([x, y, _]: [R; 3]) -> (R, R) {
    ((x * 2.0).floor() + 4.0, (y * 2.0).floor() + 4.0)
}

/// A pixel of a scene with cells, on every back end.
#[test]
fn pixels_by_cells_give_the_reference_bits() {
    let job = Box::leak(Box::new(scene::parse(many(200).as_bytes()).expect("a valid job")));
    let at_frame = Box::leak(Box::new(job.at(0).expect("a valid frame")));
    let [by_cells, without] = [Integrator::of_picture(at_frame, &FastBuilder::UNLIMITED), Integrator::new(at_frame)];
    let (by_cells, without) = (&*Box::leak(Box::new(by_cells)), &*Box::leak(Box::new(without)));
    let light = |all: [Expr; 3]| by_cells.pixel(place(all).0, place(all).1).color.x;
    compare_packets(&Formula::new("light", light, |all| by_cells.pixel(place(all).0, place(all).1).color.x), 4);
    let mut hits = 0;
    for pixel in 0..64 {
        let (x, y) = ((pixel % 8) as f32, (pixel / 8) as f32);
        let (got, want) = (by_cells.layer_values(x, y), without.layer_values(x, y));
        assert_eq!(got.depth.is_finite(), want.depth.is_finite(), "a hit at ({x}, {y})");
        if want.depth.is_finite() {
            hits += 1;
            assert!((got.depth / want.depth - 1.0).abs() < 2e-4, "at ({x}, {y}): {} for {}", got.depth, want.depth);
            assert!(got.object == want.object, "at ({x}, {y})");
            let albedo = [got.albedo, want.albedo];
            assert!((albedo[0] - albedo[1]).length() < 0.05, "at ({x}, {y}): albedos {albedo:?}");
        }
    }
    assert!((10..60).contains(&hits), "{hits} of 64 pixels are hits");
}
