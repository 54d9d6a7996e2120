//! Nodes that make copies, compared with unions of the copies written out, and their errors for unsuitable shapes.

use scene::nodes::{DistanceWithMaterials, Node};
use scene::real::{Real, Vec3, vec3};

fn node(text: &str) -> Node {
    serde_json::from_str(text).expect("a node")
}

fn union(shapes: &[String]) -> Node {
    node(&format!(r#"{{ "union": {{ "of": [{}] }} }}"#, shapes.join(", ")))
}

/// Points of a grid that has no symmetry with the copies.
fn each_point(reach: f32, mut check: impl FnMut(Vec3<f32>)) {
    let at = |index: i32| reach * (index as f32 + 0.137) / 12.0;
    for x in -12..12 {
        for y in -12..12 {
            for z in -12..12 {
                check(vec3(at(x), at(y), at(z)));
            }
        }
    }
}

/// Rounding of coordinates up to 4 and of some rotations, a few units in the last place.
const ROUNDING: f32 = 4e-6;

fn assert_same(one: &Node, other: &Node, reach: f32) {
    each_point(reach, |p| {
        let (a, b) = (one.distance(p), other.distance(p));
        assert!((a - b).abs() <= ROUNDING, "{a} and {b} at {p:?}");
    });
}

/// Shapes that fill their cell, extend into others, or are away from the origin.
const SHAPES: [&str; 4] = [
    r#"{ "box": { "size": [0.5, 0.6, 0.7] } }"#,
    r#"{ "capsule": { "a": [-0.4, -0.5, 0.1], "b": [0.5, 0.6, -0.2], "radius": 0.15 } }"#,
    r#"{ "translate": { "by": [0.4, -0.7, 0.3], "child": { "torus": { "radius": 0.3, "tube": 0.1 } } } }"#,
    r#"{ "rotate": { "degrees": [20, 40, 60], "child": { "box": { "size": [1.6, 0.2, 0.3] } } } }"#,
];

#[test]
fn a_limited_grid_is_the_union_of_its_copies() {
    for shape in SHAPES {
        let repeat =
            node(&format!(r#"{{ "repeat": {{ "cell": [0.5, 0.6, 0.7], "count": [3, 2, 1], "child": {shape} }} }}"#));
        let mut copies = Vec::new();
        for x in [-0.5, 0.0, 0.5] {
            for y in [-0.3, 0.3] {
                copies.push(format!(r#"{{ "translate": {{ "by": [{x}, {y}, 0], "child": {shape} }} }}"#));
            }
        }
        assert_same(&repeat, &union(&copies), 3.0);
    }
}

#[test]
fn an_endless_grid_is_the_union_of_enough_copies() {
    for shape in SHAPES {
        let repeat = node(&format!(r#"{{ "repeat": {{ "cell": [0.5, null, 0.7], "child": {shape} }} }}"#));
        let mut copies = Vec::new();
        for x in -6..=6 {
            for z in -6..=6 {
                let (x, z) = (0.5 * f64::from(x), 0.7 * f64::from(z));
                copies.push(format!(r#"{{ "translate": {{ "by": [{x}, 0, {z}], "child": {shape} }} }}"#));
            }
        }
        assert_same(&repeat, &union(&copies), 1.0);
    }
}

#[test]
fn a_ring_is_the_union_of_its_copies() {
    let shapes = ["0.6, 0, 0", "-0.5, 0.2, 0.7", "0.3, 0, -0.9", "0, 0, 0"];
    for (by, shape) in shapes.iter().flat_map(|by| SHAPES.iter().map(move |shape| (by, shape))) {
        let moved = format!(r#"{{ "translate": {{ "by": [{by}], "child": {shape} }} }}"#);
        for count in [1, 2, 5, 12] {
            let ring = node(&format!(r#"{{ "polar_repeat": {{ "count": {count}, "child": {moved} }} }}"#));
            let rotated = |copy: u32| {
                let angle = 360.0 * f64::from(copy) / f64::from(count);
                format!(r#"{{ "rotate": {{ "degrees": [0, {angle}, 0], "child": {moved} }} }}"#)
            };
            assert_same(&ring, &union(&(0..count).map(rotated).collect::<Vec<_>>()), 2.0);
        }
    }
}

#[test]
fn a_mirrored_shape_is_its_union_with_the_image() {
    for shape in SHAPES {
        let mirrored = node(&format!(r#"{{ "mirror": {{ "normal": [2, 0, 0], "offset": 0.2, "child": {shape} }} }}"#));
        let plain = node(shape);
        each_point(2.0, |p| {
            let (here, image) = (plain.distance(p), plain.distance(vec3(0.4 - p.x, p.y, p.z)));
            assert!((mirrored.distance(p) - here.min(image)).abs() <= ROUNDING, "at {p:?}");
        });
    }
}

#[test]
fn copies_have_the_material_of_their_shape() {
    let child = r#"{ "union": { "of": [
        { "paint": { "material": { "flat": { "color": [1, 0, 0] } }, "child": {
            "translate": { "by": [0, 0.3, 0], "child": { "sphere": { "radius": 0.2 } } } } } },
        { "translate": { "by": [0, -0.3, 0], "child": { "sphere": { "radius": 0.2 } } } }
    ] } }"#;
    let moved = format!(r#"{{ "translate": {{ "by": [1, 0, 0], "child": {child} }} }}"#);
    let around = [
        format!(r#"{{ "repeat": {{ "cell": [0.5, null, 0.5], "child": {child} }} }}"#),
        format!(r#"{{ "polar_repeat": {{ "count": 5, "child": {moved} }} }}"#),
        format!(r#"{{ "mirror": {{ "normal": [1, 0, 1], "child": {child} }} }}"#),
        format!(r#"{{ "twist": {{ "degrees_per_unit": 90, "child": {child} }} }}"#),
        format!(r#"{{ "bend": {{ "degrees_per_unit": 90, "child": {child} }} }}"#),
        format!(r#"{{ "taper": {{ "bottom": -1, "top": 1, "top_factor": 0.5, "child": {child} }} }}"#),
        format!(r#"{{ "onion": {{ "thickness": 0.1, "child": {child} }} }}"#),
    ];
    for text in around {
        let node = node(&text);
        assert!(node.has_own_materials(), "{text}");
        each_point(1.5, |p| {
            let painted: DistanceWithMaterials<f32> = node.sample(p);
            assert_eq!(scene::nodes::SdfValue::distance(&painted), node.distance(p), "{text} at {p:?}");
            let shares: f32 = painted.weights().iter().map(|coat| coat.weight).sum();
            assert!((shares - 1.0).abs() < 1e-6, "{text} at {p:?}");
            let upper =
                painted.weights().iter().filter(|coat| coat.slot.is_some()).map(|coat| coat.weight).sum::<f32>();
            if p.y.abs() > 0.2 && !text.contains("bend") {
                assert_eq!(upper, if p.y > 0.0 { 1.0 } else { 0.0 }, "{text} at {p:?}");
            }
        });
    }
}

/// Pointer and message of the only error of a job with this shape.
fn fault(shape: &str) -> (String, String) {
    let job = format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }},
             "objects": [{{ "shape": {shape} }}] }}, "image": {{ "width": 8, "height": 8 }} }}"#
    );
    match scene::parse(job.as_bytes()) {
        Err(scene::ParseError::Invalid(faults)) => {
            assert_eq!(faults.len(), 1, "{faults:?}");
            (faults[0].pointer.replace("/scene/objects/0/shape/", ""), faults[0].message.clone())
        }
        other => panic!("{shape}: {other:?}"),
    }
}

fn assert_fault(shape: &str, place: &str, words: &str) {
    let (pointer, message) = fault(shape);
    assert_eq!(pointer, place, "{message}");
    assert!(message.contains(words), "{message}");
}

const SPHERE: &str = r#"{ "sphere": { "radius": 1 } }"#;
const PLANE: &str = r#"{ "plane": { "normal": [0, 1, 0], "offset": 0 } }"#;

#[test]
fn impossible_copies_are_reported_with_the_fix() {
    let cases = [
        (r#""repeat": { "cell": [0, null, null]"#, SPHERE, "repeat/cell/0", "null along an axis"),
        (r#""repeat": { "cell": [null, null, null]"#, SPHERE, "repeat/cell", "give x, y or z"),
        (r#""repeat": { "cell": [1, 0.1, 1]"#, SPHERE, "repeat/cell/1", "make it 0.5 or more"),
        (r#""repeat": { "cell": [1, 1, 1]"#, PLANE, "repeat/cell/0", "by an intersection"),
        (r#""repeat": { "cell": [1, null, 1], "count": [2, 2, 2]"#, SPHERE, "repeat/count/1", "give it a cell"),
        (r#""polar_repeat": { "count": 65"#, SPHERE, "polar_repeat/count", "away from the y axis"),
    ];
    for (start, child, place, words) in cases {
        assert_fault(&format!(r#"{{ {start}, "child": {child} }} }}"#), place, words);
    }
}

#[test]
fn an_undeformable_shape_is_reported_with_the_fix() {
    let cases = [
        (r#""twist": { "degrees_per_unit": 9"#, PLANE, "twist/child", "by an intersection"),
        (r#""bend": { "degrees_per_unit": 9"#, PLANE, "bend/child", "by an intersection"),
        (r#""bend": { "degrees_per_unit": 200"#, SPHERE, "bend/degrees_per_unit", "less than 51.5"),
        (r#""taper": { "bottom": 1, "top": 1, "top_factor": 2"#, SPHERE, "taper/top", "make top more than 1"),
    ];
    for (start, child, place, words) in cases {
        assert_fault(&format!(r#"{{ {start}, "child": {child} }} }}"#), place, words);
    }
}

#[test]
fn a_list_of_invalid_length_is_reported_with_its_number() {
    let engraved = format!(r#"{{ "engrave": {{ "depth": 0.1, "of": [{SPHERE}] }} }}"#);
    assert_fault(&engraved, "engrave/of", "has 1 shape: engrave takes exactly 2");
    let morphed = format!(r#"{{ "morph": {{ "amount": 0.5, "of": [{SPHERE}, {SPHERE}, {PLANE}] }} }}"#);
    assert_fault(&morphed, "morph/of", "has 3 shapes: morph takes exactly 2");
    let twisted = r#"{ "twist": { "degrees_per_unit": 9, "child": { "morph": { "amount": 0, "of": [] } } } }"#;
    assert_fault(twisted, "twist/child/morph/of", "is empty");
    let united = format!(r#"{{ "union": {{ "of": [{SPHERE}, {{ "xor": {{ "of": [] }} }}] }} }}"#);
    assert_fault(&united, "union/of/1/xor/of", "is empty");
}

#[test]
fn factors_multiply_through_nested_modifiers() {
    let twisted = format!(r#"{{ "twist": {{ "degrees_per_unit": 60, "child": {SPHERE} }} }}"#);
    let twice = format!(r#"{{ "twist": {{ "degrees_per_unit": 60, "child": {twisted} }} }}"#);
    let around = |name: &str, child: &str| node(&format!(r#"{{ "{name}": {child} }}"#)).lipschitz();
    // A box around the sphere has a radius of √2: k·r = √2·π/3.
    let shear = std::f32::consts::SQRT_2 * std::f32::consts::FRAC_PI_3;
    let factor = 0.5 * (shear + (shear * shear + 4.0).sqrt());
    assert!((node(&twisted).lipschitz() - factor).abs() < 1e-5);
    let wider = 2.0 * std::f32::consts::FRAC_PI_3;
    let wider = 0.5 * (wider + (wider * wider + 4.0).sqrt());
    assert!((node(&twice).lipschitz() - factor * wider).abs() < 1e-4);
    for (name, rest) in [("round", r#""radius": 0.1"#), ("stretch", r#""by": [1, 2, 3]"#), ("scale", r#""by": 2"#)] {
        assert_eq!(around(name, &format!(r#"{{ {rest}, "child": {twice} }}"#)), node(&twice).lipschitz(), "{name}");
    }
    let half = around("chamfer", &format!(r#"{{ "kind": "union", "size": 0.1, "of": [{twisted}, {SPHERE}] }}"#));
    assert!((half - factor.max((factor + 1.0) * std::f32::consts::FRAC_1_SQRT_2)).abs() < 1e-5);
}

#[test]
fn a_bend_preserves_lengths_along_the_axis_and_heights() {
    let bent = node(r#"{ "bend": { "degrees_per_unit": 45, "child": { "box": { "size": [3, 0.4, 1] } } } }"#);
    let (radius, angle) = (4.0 / std::f32::consts::PI, 1.4 * std::f32::consts::FRAC_PI_4);
    for height in [-0.3, -0.2, -0.1, 0.0, 0.15, 0.2, 0.25] {
        let away = radius - height;
        let p = vec3(away * Real::sin(angle), radius - away * Real::cos(angle), 0.0);
        let inside = (height.abs() - 0.2).max(-0.1);
        assert_eq!(bent.distance(p) < -1e-6, inside < -1e-6, "{height}: {}", bent.distance(p));
        assert_eq!(bent.distance(p) > 1e-6, inside > 1e-6, "{height}: {}", bent.distance(p));
    }
}

#[test]
fn minimum_and_maximum_numbers_give_finite_distances() {
    let tiny = r#"{ "sphere": { "radius": 1e-6 } }"#;
    let huge = r#"{ "box": { "size": [1e6, 1e6, 1e6] } }"#;
    let texts = [
        format!(r#""repeat": {{ "cell": [1e-6, 1e-6, 1e-6], "child": {tiny} }}"#),
        format!(r#""repeat": {{ "cell": [1e6, null, 1e6], "count": [1000000, null, 1], "child": {huge} }}"#),
        format!(r#""repeat": {{ "cell": [1e6, 1e6, 1e6], "child": {tiny} }}"#),
        format!(
            r#""polar_repeat": {{ "count": 10000, "child": {{ "translate": {{ "by": [1e6, 0, 0], "child": {tiny} }} }} }}"#
        ),
        format!(r#""polar_repeat": {{ "count": 64, "child": {huge} }}"#),
        format!(r#""mirror": {{ "normal": [1e-6, 1e6, 0], "offset": 1e6, "child": {huge} }}"#),
        format!(r#""twist": {{ "degrees_per_unit": 36000, "child": {huge} }}"#),
        format!(r#""twist": {{ "degrees_per_unit": -1e-30, "child": {tiny} }}"#),
        format!(r#""bend": {{ "degrees_per_unit": 36000, "child": {tiny} }}"#),
        format!(r#""bend": {{ "degrees_per_unit": -1e-5, "child": {huge} }}"#),
        format!(r#""bend": {{ "degrees_per_unit": 1e-30, "child": {tiny} }}"#),
        format!(
            r#""taper": {{ "bottom": 0, "top": 1e-6, "bottom_factor": 1e-6, "top_factor": 1e6, "child": {huge} }}"#
        ),
        format!(
            r#""taper": {{ "bottom": -1e6, "top": 1e6, "bottom_factor": 1e6, "top_factor": 1e-6, "child": {tiny} }}"#
        ),
        format!(r#""stretch": {{ "by": [1e-6, 1, 1e6], "child": {huge} }}"#),
        format!(r#""elongate": {{ "by": [0, 1e-6, 1e6], "child": {huge} }}"#),
        format!(r#""stairs": {{ "kind": "difference", "size": 1e-6, "steps": 64, "of": [{huge}, {tiny}] }}"#),
        format!(r#""columns": {{ "kind": "union", "size": 1e-6, "columns": 64, "of": [{huge}, {tiny}] }}"#),
        format!(r#""chamfer": {{ "kind": "intersection", "size": 1e6, "of": [{huge}, {tiny}] }}"#),
    ];
    for text in texts {
        let node = node(&format!("{{ {text} }}"));
        assert!(node.lipschitz().is_finite(), "{text}");
        for reach in [0.0, 1e-6, 1e-3, 1.0, 1e3, 1e6] {
            each_point(reach, |p| assert!(node.distance(p).is_finite(), "{text} at {p:?}"));
        }
    }
}
