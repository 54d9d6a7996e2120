//! Seams of joined shapes, at points where they are known: two planes at right angles, whose distances are a point's x
//! and y.

use std::f32::consts::{FRAC_1_SQRT_2, SQRT_2};

use scene::nodes::{DistanceWithMaterials, Node};
use scene::real::vec3;

const X: &str = r#"{ "plane": { "normal": [1, 0, 0], "offset": 0 } }"#;
const Y: &str = r#"{ "plane": { "normal": [0, 1, 0], "offset": 0 } }"#;

fn node(text: &str) -> Node {
    serde_json::from_str(text).expect("a node")
}

/// Two joined planes, and the signs of x and y that turn the other kinds into a union, and back.
fn each_kind(name: &str, rest: &str, mut check: impl FnMut(&str, &dyn Fn(f32, f32) -> f32)) {
    for (kind, x, y) in [("union", 1.0, 1.0), ("intersection", -1.0, -1.0), ("difference", -1.0, 1.0)] {
        let joined = node(&format!(r#"{{ "{name}": {{ "kind": "{kind}", "size": 1, {rest} "of": [{X}, {Y}] }} }}"#));
        check(kind, &|a, b| x * joined.distance(vec3(x * a, y * b, 0.3)));
    }
}

fn near(got: f32, want: f32) -> bool {
    (got - want).abs() <= 1e-6
}

#[test]
fn a_bevel_cuts_the_corner_at_its_size() {
    each_kind("chamfer", "", |kind, at| {
        for (a, b, want) in
            [(1.0, 0.0, 0.0), (0.5, 0.5, 0.0), (1.0, 1.0, FRAC_1_SQRT_2), (0.25, 3.0, 0.25), (-0.5, 2.0, -0.5)]
        {
            assert!(near(at(a, b), want), "{kind}: {} at {a}, {b}, not {want}", at(a, b));
        }
    });
}

#[test]
fn a_flight_has_one_edge_per_step() {
    for steps in [1, 2, 5] {
        each_kind("stairs", &format!(r#""steps": {steps},"#), |kind, at| {
            let step = 1.0 / (steps + 1) as f32;
            for number in 1..=steps {
                let (a, b) = (number as f32 * step, (steps + 1 - number) as f32 * step);
                assert!(near(at(a, b), 0.0), "{kind}: edge {number} of {steps}");
                assert!(
                    at(a + 0.01, b + 0.01) > 0.0 && at(a - 0.01, b - 0.01) < 0.0,
                    "{kind}: edge {number} of {steps}"
                );
                assert!(at(a + 0.5 * step, b - 0.5 * step) > 0.0, "{kind}: after edge {number} of {steps}");
            }
        });
    }
}

#[test]
fn a_row_has_the_given_number_of_columns() {
    for columns in [1, 2, 3, 6] {
        each_kind("columns", &format!(r#""columns": {columns},"#), |kind, at| {
            let count = columns as f32;
            let is_union = kind == "union";
            let rooms = if is_union { count } else { count - 1.0 };
            let radius = SQRT_2 / (2.0 * rooms + SQRT_2);
            let depth = if is_union { FRAC_1_SQRT_2 - radius * SQRT_2 } else { (1.0 + radius) * FRAC_1_SQRT_2 };
            // Columns protrude from the bevel of a union, and remain where others are cut.
            let sign = if is_union { 1.0 } else { -1.0 };
            for number in 0..columns {
                let along = (number as f32 - 0.5 * (count - 1.0)) * 2.0 * radius;
                let on_row = |across: f32, along: f32| {
                    at((depth + across - along) * FRAC_1_SQRT_2, (depth + across + along) * FRAC_1_SQRT_2)
                };
                let rim = sign * radius;
                assert!((on_row(rim, along)).abs() < 1e-5, "{kind}: column {number} of {columns}");
                assert!(sign * on_row(0.9 * rim, along) < 0.0, "{kind}: column {number} of {columns}");
                if number > 0 {
                    let between = on_row(0.2 * rim, along - radius);
                    assert!(sign * between > 0.0, "{kind}: before column {number} of {columns}");
                }
            }
        });
    }
}

#[test]
fn a_seam_blends_from_one_material_to_the_other() {
    for (name, rest) in [("chamfer", ""), ("stairs", r#""steps": 2,"#), ("columns", r#""columns": 2,"#)] {
        for (kind, x, y) in [("union", 1.0, 1.0), ("intersection", -1.0, -1.0), ("difference", -1.0, 1.0)] {
            let painted =
                format!(r#"{{ "paint": {{ "material": {{ "flat": {{ "color": [1, 0, 0] }} }}, "child": {Y} }} }}"#);
            let joined =
                node(&format!(r#"{{ "{name}": {{ "kind": "{kind}", "size": 1, {rest} "of": [{X}, {painted}] }} }}"#));
            for (a, b, want) in
                [(0.0, 1.5, 0.0), (0.25, 0.75, 0.25), (0.5, 0.5, 0.5), (0.75, 0.25, 0.75), (1.5, 0.0, 1.0)]
            {
                let seen: DistanceWithMaterials<f32> = joined.sample(vec3(x * a, y * b, 0.0));
                let share: f32 = seen.weights().iter().filter(|coat| coat.slot.is_some()).map(|coat| coat.weight).sum();
                assert!(near(share, want), "{name} {kind}: {share} at {a}, {b}, not {want}");
            }
        }
    }
}

#[test]
fn an_engraving_has_its_depth_and_twice_its_width() {
    let engraved = node(&format!(r#"{{ "engrave": {{ "depth": 0.2, "of": [{X}, {Y}] }} }}"#));
    let grooved = node(&format!(r#"{{ "groove": {{ "depth": 0.3, "width": 0.2, "of": [{X}, {Y}] }} }}"#));
    let ridged = node(&format!(r#"{{ "tongue": {{ "height": 0.3, "width": 0.2, "of": [{X}, {Y}] }} }}"#));
    for (shape, on_surface) in [
        (&engraved, [(-0.2, 0.0), (-0.1, 0.1), (0.0, -0.2), (0.0, 0.5)]),
        (&grooved, [(-0.3, 0.0), (-0.15, 0.1), (0.0, -0.1), (0.0, 0.5)]),
        (&ridged, [(0.3, 0.0), (0.15, 0.1), (0.3, -0.1), (0.0, 0.5)]),
    ] {
        for (x, y) in on_surface {
            let distance = shape.distance(vec3(x, y, 0.0));
            assert!(near(distance, 0.0), "{shape:?}: {distance} at {x}, {y}");
        }
    }
    assert!(engraved.distance(vec3(-0.05, 0.0, 0.0)) > 0.0 && grooved.distance(vec3(-0.05, 0.0, 0.0)) > 0.0);
    assert!(ridged.distance(vec3(0.25, 0.05, 0.0)) < 0.0);
}

#[test]
fn morphs_end_at_their_shapes_and_xor_is_parity() {
    let shapes = [
        r#"{ "sphere": { "radius": 0.8 } }"#,
        r#"{ "box": { "size": [1, 2, 0.5] } }"#,
        r#"{ "translate": { "by": [0.3, 0, 0.2], "child": { "torus": { "radius": 0.6, "tube": 0.3 } } } }"#,
    ];
    let odd = node(&format!(r#"{{ "xor": {{ "of": [{}] }} }}"#, shapes.join(", ")));
    let at = |amount: f32| {
        node(&format!(r#"{{ "morph": {{ "amount": {amount}, "of": [{}, {}] }} }}"#, shapes[0], shapes[1]))
    };
    let (start, quarter, end) = (at(0.0), at(0.25), at(1.0));
    let shapes = shapes.map(node);
    for index in 0..5_000_u32 {
        let coordinate = |step: u32| (index * step % 1_009) as f32 / 504.5 - 1.0;
        let p = vec3(coordinate(7), coordinate(211), coordinate(523));
        let [sphere, block, ring] = [0, 1, 2].map(|index: usize| shapes[index].distance(p));
        assert_eq!((start.distance(p), end.distance(p)), (sphere, block), "{p:?}");
        assert!(near(quarter.distance(p), 0.75 * sphere + 0.25 * block), "{p:?}");
        let inside = [sphere, block, ring].into_iter().filter(|&distance| distance < 0.0).count();
        assert_eq!(odd.distance(p) < 0.0, inside % 2 == 1, "{p:?}");
        let nearest = [sphere, block, ring].into_iter().map(f32::abs).fold(f32::MAX, f32::min);
        assert_eq!(odd.distance(p).abs(), nearest, "{p:?}");
    }
}
