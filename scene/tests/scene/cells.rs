//! The list of a cell gives the value of the whole scene, bit for bit, and its bound is never more than a distance in it.

use std::fs;

use scene::bounds::Bounds;
use scene::cells::{Cells, Program, ScalarBuilder};
use scene::nodes::{DistanceWithMaterials, MaterialWeight, SdfValue};
use scene::real::{Vec3, vec3};
use scene::{Job, Scene, parse};

struct Random(u32);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((self.0 >> ((self.0 >> 28) + 4)) ^ self.0).wrapping_mul(277_803_737);
        (((word >> 22) ^ word) >> 8) as f32 / (1 << 24) as f32
    }

    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.next()
    }

    fn point(&mut self, reach: f32) -> Vec3<f32> {
        vec3(self.between(-reach, reach), self.between(-reach, reach), self.between(-reach, reach))
    }
}

/// Coordinates of the points that the cells of these tests contain.
const REACH: f32 = 40.0;

/// Box with corners at ±`reach`.
fn around(reach: f32) -> Bounds {
    Bounds::symmetric(reach, reach, reach)
}

/// Spheres that fill a ball, in the order of chance, in a smooth union with other shapes.
fn ball_of_spheres(count: u32, others: &[&str]) -> Job {
    let mut random = Random(5);
    let mut spheres: Vec<String> = others.iter().map(ToString::to_string).collect();
    while spheres.len() < others.len() + count as usize {
        let Vec3 { x, y, z } = random.point(1.0);
        if x * x + y * y + z * z < 1.0 {
            let child = format!(r#"{{ "sphere": {{ "radius": {} }} }}"#, random.between(0.06, 0.09));
            spheres.push(format!(r#"{{ "translate": {{ "by": [{x}, {y}, {z}], "child": {child} }} }}"#));
        }
    }
    let job = format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }}, "objects": [{{ "shape":
            {{ "union": {{ "smooth": 0.04, "of": [{}] }} }} }}] }}, "image": {{ "width": 8, "height": 8 }} }}"#,
        spheres.join(",")
    );
    parse(job.as_bytes()).expect("a valid job")
}

/// Shapes in a group of eight are anywhere, so that the group's nearest one may be distant.
#[test]
fn shapes_that_matter_only_in_their_groups_are_left_out() {
    let job = ball_of_spheres(600, &[]);
    let at_frame = job.at(0).expect("the first frame");
    let program = Program::new(at_frame.scene(), &[(0, None)]).expect("few families");
    let cells = Cells::new(program, around(1.2), &ScalarBuilder);
    let words = cells.tree().words().used();
    println!("{words} words");
    // They are 918,000; without cutoffs that pass through joins, 1,486,000.
    assert!(words < 1_000_000, "lists are long: {words} words");
}

/// A floor that is a thousand times as large as the other shapes, or one of them far away, must not make their lists long.
#[test]
fn small_shapes_among_large_and_distant_ones_have_short_lists() {
    let floor = r#"{ "translate": { "by": [0, -2, 0], "child": { "box": { "size": [2000, 0.2, 2000] } } } }"#;
    let moon = r#"{ "translate": { "by": [0, 0, -3000], "child": { "sphere": { "radius": 0.1 } } } }"#;
    for (others, reach) in [(&[][..], 1.2), (&[floor][..], 1000.0), (&[moon][..], 3001.0), (&[floor, moon][..], 3001.0)]
    {
        let job = ball_of_spheres(600, others);
        let at_frame = job.at(0).expect("the first frame");
        let program = Program::new(at_frame.scene(), &[(0, None)]).expect("few families");
        let cells = Cells::new(program, around(reach), &ScalarBuilder);
        let mut random = Random(8);
        let longest = (0..2000).map(|_| cells.list_length(random.point(1.0))).max();
        println!("{longest:?} operations with {others:?}");
        assert!(longest < Some(120), "with {others:?}, a list has {longest:?} operations of 600");
    }
}

/// Compares cells with the whole program at random points, and on the faces of cells.
fn check(name: &str, job: &Job, points: u32) {
    let at_frame = job.at(0).expect("the first frame");
    let objects: Vec<_> = (0..at_frame.scene().objects.len()).map(|index| (index, None)).collect();
    let Some(program) = Program::new(at_frame.scene(), &objects) else { return };
    let cells = Cells::new(program, around(REACH), &ScalarBuilder);
    let mut random = Random(3);
    for index in 0..points {
        let mut p = random.point(REACH);
        let coordinate = [&mut p.x, &mut p.y, &mut p.z].into_iter().nth(index as usize % 3);
        *coordinate.expect("one of three") = if index.is_multiple_of(2) { REACH } else { -REACH };
        assert!(!cells.is_outside(p), "{name}: no cell has {p:?}, which is on the face of what is to be reached");
    }
    let (mut empty, mut near) = (0, 0);
    for index in 0..points {
        let reach = [3.0, 10.0, 39.0, 50.0][index as usize % 4];
        let p = random.point(reach);
        for p in [p, cells.on_face(p, 0), cells.on_face(p, 1), cells.on_face(p, -1)] {
            let cell = cells.locate(p);
            let (whole, listed, bound) = (cells.whole_distance(p), cells.distance(p), cell.bound());
            assert_eq!(whole.to_bits(), listed.to_bits(), "{name} at {p:?}: {whole}, and {listed} by cells");
            assert!(bound <= whole.max(0.0), "{name} at {p:?}: {whole}, bound {bound}");
            check_materials(name, at_frame.scene(), &cells, p);
            if bound > 0.0 { empty += 1 } else { near += 1 }
        }
    }
    println!(
        "{name}: {} leaves, {} families, {} words, {empty} empty, {near} near",
        cells.program().leaf_count(),
        cells.program().family_count(),
        cells.tree().words().used()
    );
}

/// Compares the weights of materials at a point, and the points of their textures, with the whole program's, and
/// with the nearest object's, which are added in another order.
fn check_materials(name: &str, scene: &Scene, cells: &Cells<'_>, p: Vec3<f32>) {
    let listed = cells.material_weights(p);
    if listed.is_empty() {
        return;
    }
    let object = &scene.objects[cells.nearest(p).1 as usize];
    let sample: DistanceWithMaterials<f32> = object.shape.sample(p);
    let painted = if object.shape.has_own_materials() { sample.paint(object.material.slot(), p) } else { sample };
    for (MaterialWeight { slot, weight, point }, (whole, whole_point)) in
        listed.into_iter().zip(cells.whole_material_weights(p))
    {
        assert!(weight == whole, "{name} at {p:?}: material {slot:?} has weight {weight} by cells, and {whole}");
        if let Some(whole_point) = whole_point.filter(|_| weight > 0.0) {
            assert_eq!(point, whole_point, "{name} at {p:?}: the point of material {slot:?}");
        }
        let known = painted.weights().iter().find(|known| known.slot == slot);
        let want = known.map_or(0.0, |known| known.weight);
        assert!((weight - want).abs() < 1e-6, "{name} at {p:?}: material {slot:?} has weight {weight}, and not {want}");
        let is_textured = scene.used_materials()[slot.expect("a slot") as usize].is_textured();
        if let Some(known) = known.filter(|known| is_textured && weight > 0.0 && weight == known.weight) {
            assert_eq!(point, known.point, "{name} at {p:?}: the point of material {slot:?}");
        }
    }
}

#[test]
fn cells_of_every_shipped_scene_give_the_value_of_the_whole() {
    for entry in fs::read_dir("../scenes").expect("the shipped scenes") {
        let path = entry.expect("an entry").path();
        if path.extension().is_some_and(|extension| extension == "json") {
            let job = parse(&fs::read(&path).expect("a file")).expect("a valid job");
            check(&path.display().to_string(), &job, 400);
        }
    }
}

/// A random shape: a primitive, moved or turned, a copied one, or a union of up to `most` shapes.
fn shape(random: &mut Random, depth: u32, most: u32) -> String {
    let place = random.point(2.0);
    let size = random.between(0.05, 0.4);
    let solid = match (random.next() * 6.0) as u32 {
        0 => format!(r#"{{ "box": {{ "size": [{size}, {}, 0.3], "round": 0.01 }} }}"#, 2.0 * size),
        1 => format!(r#"{{ "torus": {{ "radius": {size}, "tube": 0.04 }} }}"#),
        2 => format!(r#"{{ "ellipsoid": {{ "radii": [{size}, 0.2, 0.1] }} }}"#),
        3 => format!(
            r#"{{ "difference": {{ "smooth": 0.02, "of": [ {{ "sphere": {{ "radius": {size} }} }},
               {{ "paint": {{ "material": "tiles", "child": {{ "box": {{ "size": [0.1, 0.1, 2] }} }} }} }} ] }} }}"#
        ),
        4 => format!(
            r#"{{ "twist": {{ "degrees_per_unit": 40, "child": {{ "box": {{ "size": [{size}, 0.5, 0.2] }} }} }} }}"#
        ),
        _ => format!(r#"{{ "sphere": {{ "radius": {size} }} }}"#),
    };
    let rotated =
        format!(r#"{{ "rotate": {{ "degrees": [{}, 20, 0], "child": {solid} }} }}"#, random.between(-90.0, 90.0));
    let inner = if depth == 0 { rotated } else { union(random, depth - 1, most) };
    let inner = match (random.next() * 12.0) as usize {
        paint @ 0..3 => {
            format!(r#"{{ "paint": {{ "material": "{}", "child": {inner} }} }}"#, ["red", "blue", "tiles"][paint])
        }
        _ => inner,
    };
    format!(r#"{{ "translate": {{ "by": [{}, {}, {}], "child": {inner} }} }}"#, place.x, place.y, place.z)
}

fn union(random: &mut Random, depth: u32, most: u32) -> String {
    let count = 1 + (random.next() * most as f32) as u32;
    let shapes: Vec<String> = (0..count)
        .map(|_| {
            let depth = if random.next() < 0.3 { depth } else { 0 };
            shape(random, depth, most / 4 + 1)
        })
        .collect();
    let smooth = [0.0, 0.02, 0.3][(random.next() * 3.0) as usize];
    format!(r#"{{ "union": {{ "smooth": {smooth}, "of": [{}] }} }}"#, shapes.join(","))
}

fn random_job(seed: u32) -> Job {
    let mut random = Random(seed.wrapping_mul(0x9e37_79b9) | 1);
    let most = [4, 20, 50][seed as usize % 3];
    let mut objects: Vec<String> =
        (0..=seed % 3).map(|_| format!(r#"{{ "shape": {} }}"#, union(&mut random, 2, most))).collect();
    if seed.is_multiple_of(2) {
        objects.push(r#"{ "shape": { "plane": { "normal": [0, 1, 0], "offset": -1 } } }"#.to_owned());
        objects.push(r#"{ "shape": { "copies": { "smooth": 0.1, "child": { "torus": { "radius": 0.2, "tube": 0.05 } }, "at": { "grid": [5, 4, 5], "step": [0.5, 0.6, 0.7] } } } }"#.to_owned());
    }
    let text = format!(
        r##"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }}, "materials": {{
             "red": {{ "diffuse": {{ "kd": "#c03020" }} }}, "blue": {{ "diffuse": {{ "kd": "#2040c0" }} }},
             "tiles": {{ "diffuse": {{ "kd": {{ "checker": {{ "cell": 0.1, "colors": ["#b5432f", "#e8dcc0"] }} }} }} }} }},
           "objects": [{}] }}, "image": {{ "width": 8, "height": 8 }} }}"##,
        objects.join(",")
    );
    parse(text.as_bytes()).unwrap_or_else(|error| panic!("{error}: {text}"))
}

#[test]
fn cells_of_random_scenes_give_the_value_of_the_whole() {
    for seed in 0..6 {
        check(&format!("random scene {seed}"), &random_job(seed), 40);
    }
}

#[test]
#[ignore = "long: two hundred random scenes; 2 minutes"]
fn cells_of_hundreds_of_random_scenes_give_the_value_of_the_whole() {
    for seed in 0..200 {
        check(&format!("random scene {seed}"), &random_job(seed), 100);
    }
}
