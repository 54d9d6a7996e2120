//! Named shapes: a `use` is the same as its shape written there, and every error points to the place in the document.

use std::fmt::Write as _;

use scene::{Job, ParseError, ValidationError};

/// A job with these shapes and objects.
fn text(shapes: &str, objects: &str) -> String {
    format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }},
            "materials": {{ "clay": {{ "diffuse": {{ "kd": [0.7, 0.4, 0.3] }} }}, "fog": {{ "volume": {{ "density": 1 }} }} }},
            "shapes": {{ {shapes} }}, "objects": [{objects}] }},
            "image": {{ "width": 8, "height": 8 }}, "frames": {{ "count": 3, "fps": 1 }} }}"#
    )
}

fn job(shapes: &str, shape: &str) -> Job {
    let text = text(shapes, &format!(r#"{{ "shape": {shape} }}"#));
    scene::parse(text.as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}\n{text}"))
}

fn faults(text: &str) -> Vec<ValidationError> {
    match scene::parse(text.as_bytes()) {
        Err(ParseError::Invalid(faults)) => faults,
        other => panic!("{other:?}"),
    }
}

/// Asserts that a job has errors at these pointers, in order, whose messages contain these words.
#[track_caller]
fn has_faults(shapes: &str, objects: &str, expected: &[(&str, &str)]) {
    let found = faults(&text(shapes, objects));
    let is_right = found.len() == expected.len()
        && found
            .iter()
            .zip(expected)
            .all(|(fault, (pointer, words))| fault.pointer == *pointer && fault.message.contains(words));
    assert!(is_right, "{expected:?}, but {found:#?}");
}

const BALL: &str = r#"{ "sphere": { "radius": 0.4 } }"#;
const LEG: &str = r#"{ "translate": { "by": [0.3, 0, 0], "child": { "capsule": { "a": [0, 0, 0], "b": [0, 1, 0], "radius": 0.1 } } } }"#;

#[test]
fn a_use_is_the_shape_written_there() {
    let named = format!(
        r#""ball": {BALL}, "leg": {LEG},
        "pair": {{ "union": {{ "smooth": 0.1, "of": [{{ "use": "leg" }}, {{ "use": "ball" }}] }} }}, "other": {{ "use": "pair" }}"#
    );
    let pair = format!(r#"{{ "union": {{ "smooth": 0.1, "of": [{LEG}, {BALL}] }} }}"#);
    let around = |shape: &str| {
        format!(
            r#"{{ "difference": {{ "of": [
                {{ "rotate": {{ "degrees": [0, 90, 0], "child": {shape} }} }},
                {{ "paint": {{ "material": "clay", "child": {{ "scale": {{ "by": 0.5, "child": {shape} }} }} }} }}
            ] }} }}"#
        )
    };
    let written = job("", &around(&pair));
    for name in ["pair", "other"] {
        let used = job(&named, &around(&format!(r#"{{ "use": "{name}" }}"#)));
        assert_eq!(used.scene, written.scene, "{name}");
        assert_eq!(used.cache_key(1), written.cache_key(1), "{name}");
        assert_eq!(used.nodes(), written.nodes());
    }
}

#[test]
fn an_object_may_be_a_use_alone() {
    assert_eq!(job(&format!(r#""ball": {BALL}"#), r#"{ "use": "ball" }"#).scene, job("", BALL).scene);
}

#[test]
fn materials_of_a_shape_are_in_use_once() {
    let ball = format!(
        r#""ball": {{ "union": {{ "of": [{{ "paint": {{ "material": "clay", "child": {BALL} }} }},
            {{ "paint": {{ "material": {{ "flat": {{ "color": [1, 0, 0] }} }}, "child": {LEG} }} }}] }} }}"#
    );
    let uses = vec![r#"{ "use": "ball" }"#; 40].join(", ");
    let job = job(&ball, &format!(r#"{{ "union": {{ "of": [{uses}] }} }}"#));
    assert_eq!(job.scene.used_materials().len(), 3, "gray, clay and red");
}

#[test]
fn numbers_in_a_shape_may_be_animated() {
    let grows = r#"{ "sphere": { "radius": { "keys": [[0, 0.2], [2, 1]] } } }"#;
    let used = job(&format!(r#""ball": {grows}"#), r#"{ "round": { "radius": 0.1, "child": { "use": "ball" } } }"#);
    let written = job("", &format!(r#"{{ "round": {{ "radius": 0.1, "child": {grows} }} }}"#));
    for frame in 0..3 {
        assert_eq!(used.cache_key(frame), written.cache_key(frame));
    }
    assert_ne!(used.cache_key(0), used.cache_key(1));
}

#[test]
fn a_shape_that_no_object_uses_gets_a_warning() {
    let shapes = format!(r#""ball": {BALL}, "leg": {LEG}, "feet": {{ "use": "leg" }}"#);
    let warnings = scene::warnings(&job(&shapes, r#"{ "use": "ball" }"#));
    for name in ["feet", "leg"] {
        assert!(warnings.contains(&format!("shape \"{name}\" is not used")), "{warnings:?}");
    }
    assert!(!warnings.iter().any(|warning| warning.contains("\"ball\"")), "{warnings:?}");
}

#[test]
fn warnings_point_into_the_shape() {
    let rotated = r#""ball": { "union": { "of": [{ "rotate": { "degrees": [0, 1.5708, 0], "child": { "box": { "size": [1, 1, 1] } } } }] } }"#;
    let warnings =
        scene::warnings(&job(rotated, r#"{ "translate": { "by": [1, 0, 0], "child": { "use": "ball" } } }"#));
    let place = "/scene/shapes/ball/union/of/0/rotate/degrees is [0, 1.5708, 0]";
    assert!(warnings.iter().any(|warning| warning.starts_with(place)), "{warnings:?}");
}

#[test]
fn an_error_in_a_shape_is_reported_once_and_there() {
    let torus = r#"{ "translate": { "by": [1, 0, 0], "child": { "torus": { "radius": 1, "tube": 2 } } } }"#;
    let uses = [r#"{ "use": "ring/s" }"#; 5].join(", ");
    has_faults(
        &format!(r#""ring/s": {torus}"#),
        &format!(r#"{{ "shape": {{ "union": {{ "of": [{uses}] }} }} }}"#),
        &[("/scene/shapes/ring~1s/translate/child/torus/tube", "less than 1")],
    );
    // Also in a shape that no object uses, and next to other errors.
    has_faults(
        &format!(r#""a": {{ "union": {{ "of": [] }} }}, "b": {torus}, "c": {{ "use": "b" }}"#),
        r#"{ "shape": { "torus": { "radius": 1, "tube": 3 } } }"#,
        &[
            ("/scene/shapes/a/union/of", "needs a shape or more"),
            ("/scene/shapes/b/translate/child/torus/tube", "less than 1"),
            ("/scene/objects/0/shape/torus/tube", "less than 1"),
        ],
    );
}

#[test]
fn errors_of_form_in_shapes_are_all_reported() {
    has_faults(
        r#""a": { "sphere": { "radius": -1 } }, "b": { "union": { "of": [{ "ball": { "radius": 1 } }, { "use": 5 }] } }"#,
        r#"{ "shape": { "use": "a" } }, { "shape": { "sphere": { "radius": 0 } } }"#,
        &[
            ("/scene/shapes/a/sphere/radius", "from 1e-6"),
            ("/scene/shapes/b/union/of/0/ball", "did you mean `sphere`?"),
            ("/scene/shapes/b/union/of/1/use", "must be the name of a shape"),
            ("/scene/objects/1/shape/sphere/radius", "from 1e-6"),
        ],
    );
}

#[test]
fn an_error_of_a_later_frame_points_into_the_shape() {
    let thin = r#"{ "union": { "of": [{ "torus": { "radius": 1, "tube": { "keys": [[0, 0.1], [2, 1.5]] } } }] } }"#;
    has_faults(
        &format!(r#""ring": {thin}"#),
        r#"{ "shape": { "onion": { "thickness": 0.1, "child": { "use": "ring" } } } }"#,
        &[("/scene/shapes/ring/union/of/0/torus/tube", "in frame 2")],
    );
}

#[test]
fn an_unknown_name_gets_a_suggestion() {
    has_faults(
        &format!(r#""leg": {{ "union": {{ "of": [{BALL}, {{ "use": "ball" }}] }} }}"#),
        r#"{ "shape": { "scale": { "by": 2, "child": { "use": "lge" } } } }"#,
        &[
            ("/scene/shapes/leg/union/of/1/use", "\"ball\" is not in /scene/shapes: choose one of leg"),
            ("/scene/objects/0/shape/scale/child/use", "\"lge\" is not in /scene/shapes: did you mean \"leg\"?"),
        ],
    );
    has_faults("", r#"{ "shape": { "use": "leg" } }"#, &[("/scene/objects/0/shape/use", "define it there")]);
}

#[test]
fn unknown_materials_and_media_in_shapes_are_reported_once() {
    let painted = |material: &str| format!(r#"{{ "paint": {{ "material": "{material}", "child": {BALL} }} }}"#);
    has_faults(
        &format!(r#""a": {}, "b": {}"#, painted("caly"), painted("none")),
        r#"{ "shape": { "union": { "of": [{ "use": "a" }, { "use": "a" }] } } }"#,
        &[
            ("/scene/shapes/a/paint/material", "did you mean \"clay\"?"),
            ("/scene/shapes/b/paint/material", "is not in /scene/materials"),
        ],
    );
    has_faults(
        &format!(r#""a": {}"#, painted("fog")),
        r#"{ "shape": { "union": { "of": [{ "use": "a" }, { "use": "a" }] } } }"#,
        &[("/scene/shapes/a/paint/material", "fills a whole object")],
    );
}

#[test]
fn a_cycle_is_reported_with_its_path() {
    let within = |name: &str| format!(r#"{{ "union": {{ "of": [{BALL}, {{ "use": "{name}" }}] }} }}"#);
    has_faults(
        &format!(r#""foot": {}, "knee": {}, "leg": {}"#, within("leg"), within("foot"), within("knee")),
        r#"{ "shape": { "use": "knee" } }"#,
        &[("/scene/shapes/knee/union/of/1/use", r#"("foot" → "leg" → "knee" → "foot"): remove one"#)],
    );
    has_faults(
        r#""self": { "use": "self" }"#,
        r#"{ "shape": { "use": "self" } }"#,
        &[("/scene/shapes/self/use", r#"makes "self" a part of itself"#)],
    );
    let mut long = String::new();
    for index in 0..20_000 {
        write!(long, r#"{}"s{index}": {{ "use": "s{}" }}"#, if index > 0 { ", " } else { "" }, (index + 1) % 20_000)
            .unwrap();
    }
    let found = faults(&text(&long, r#"{ "shape": { "use": "s0" } }"#));
    assert!(found.len() == 1 && found[0].message.len() < 200, "{found:?}");
}

#[test]
fn a_long_chain_of_names_is_followed() {
    let mut chain = format!(r#""s0": {BALL}"#);
    for index in 1..20_000 {
        write!(chain, r#", "s{index}": {{ "use": "s{}" }}"#, index - 1).unwrap();
    }
    assert_eq!(job(&chain, r#"{ "use": "s19999" }"#).nodes(), 1);
}

/// Shapes that each use the previous one twice.
fn doubling(levels: usize) -> String {
    let mut shapes = format!(r#""s0": {BALL}"#);
    for level in 1..=levels {
        let below = level - 1;
        let of = format!(r#"{{ "use": "s{below}" }}, {{ "use": "s{below}" }}"#);
        write!(shapes, r#", "s{level}": {{ "union": {{ "of": [{of}] }} }}"#).unwrap();
    }
    shapes
}

#[test]
fn doubling_shapes_are_rejected_before_they_are_copied() {
    has_faults(
        &doubling(60),
        r#"{ "shape": { "use": "s60" } }"#,
        &[("/scene/shapes/s19", "has 1048575 nodes, counting those of the shapes in it: use at most 1000000")],
    );
    let two = [r#"{ "shape": { "use": "s18" } }"#; 2].join(", ");
    has_faults(
        &doubling(18),
        &two,
        &[("/scene/objects", "has 1048574 nodes, counting each use of a shape and each copy: use at most 1000000")],
    );
    let mut unused = doubling(18);
    for index in 0..2 {
        write!(unused, r#", "u{index}": {{ "union": {{ "of": [{{ "use": "s18" }}] }} }}"#).unwrap();
    }
    has_faults(
        &unused,
        &format!(r#"{{ "shape": {BALL} }}"#),
        &[("/scene/shapes", "more than 1000000 nodes that no object uses")],
    );
    assert_eq!(job(&doubling(15), r#"{ "use": "s15" }"#).nodes(), 65_535);
}

/// A track of this many keys.
fn track(keys: usize) -> String {
    let keys: Vec<String> = (0..keys).map(|key| format!("[{key}, 1]")).collect();
    format!(r#"{{ "keys": [{}] }}"#, keys.join(", "))
}

#[test]
fn values_of_used_shapes_are_counted_before_they_are_copied() {
    // Each use is one node, so that the limit of nodes alone would allow 360,000,000 keys.
    let uses = |name: &str, count: usize| {
        let of = vec![format!(r#"{{ "use": "{name}" }}"#); count].join(", ");
        format!(r#"{{ "union": {{ "of": [{of}] }} }}"#)
    };
    let shapes =
        |keys| format!(r#""ball": {{ "sphere": {{ "radius": {} }} }}, "row": {}"#, track(keys), uses("ball", 200));
    let object = format!(r#"{{ "shape": {} }}"#, uses("row", 200));
    has_faults(&shapes(9_000), &object, &[("/scene/objects", "values, counting those of a shape for each use of it")]);
    let row = format!(r#"{}, "rows": {}"#, shapes(9_000), uses("row", 200));
    has_faults(&row, r#"{ "shape": { "use": "rows" } }"#, &[("/scene/shapes/rows", "with fewer keys or fewer uses")]);
    assert_eq!(job(&shapes(90), &uses("row", 200)).nodes(), 40_201);
}

#[test]
fn values_of_groups_are_counted_before_their_objects_get_them() {
    let objects = |count: usize| vec![format!(r#"{{ "shape": {BALL} }}"#); count].join(", ");
    let text = |keys: usize, count: usize| {
        format!(
            r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }}, "objects": [{{ "shape": {BALL} }}],
                "groups": [{{ "axis": [0, 1, 0], "degrees": {}, "groups": [{{ "by": [0, 0, 0], "objects": [{}] }}] }}] }},
                "image": {{ "width": 8, "height": 8, "samples": 1 }} }}"#,
            track(keys),
            objects(count)
        )
    };
    assert!(scene::parse(text(9_000, 100).as_bytes()).is_ok());
    let found = faults(&text(9_000, 2_000));
    assert!(found.len() == 1 && found[0].pointer == "/scene/groups", "{found:?}");
    assert!(found[0].message.contains("counting it for each object in them"), "{found:?}");
}

#[test]
fn nesting_is_limited_with_each_use_replaced() {
    let nested = |levels: usize, inner: &str| {
        let open = r#"{ "translate": { "by": [0.1, 0, 0], "child": "#.repeat(levels);
        format!("{open}{inner}{}", "} }".repeat(levels))
    };
    let forty = format!(r#""forty": {}"#, nested(39, BALL));
    assert_eq!(job(&forty, &nested(24, r#"{ "use": "forty" }"#)).nodes(), 64);
    let place = format!("/scene/objects/0/shape{}/use", "/translate/child".repeat(25));
    let object = format!(r#"{{ "shape": {} }}"#, nested(25, r#"{ "use": "forty" }"#));
    has_faults(&forty, &object, &[(&place, "nests 65 nodes deep, with those of the shape: nest at most 64")]);
    let twice = format!(r#"{forty}, "more": {}"#, nested(30, r#"{ "use": "forty" }"#));
    let place = format!("/scene/shapes/more{}/use", "/translate/child".repeat(30));
    has_faults(&twice, r#"{ "shape": { "use": "more" } }"#, &[(&place, "nests 70 nodes deep")]);
    let deep = format!(r#""deep": {}"#, nested(64, BALL));
    let place = format!("/scene/shapes/deep{}", "/translate/child".repeat(64));
    has_faults(
        &deep,
        r#"{ "shape": { "use": "deep" } }"#,
        &[(&place, "nests 65 nodes deep"), ("/scene/objects/0/shape/use", "65")],
    );
}

#[test]
fn many_uses_of_a_long_chain_of_names_are_replaced_at_once() {
    let links = 20_000;
    let mut chain = format!(r#""s0": {BALL}"#);
    for index in 1..links {
        write!(chain, r#", "s{index}": {{ "use": "s{}" }}"#, index - 1).unwrap();
    }
    // Following the chain for each use would take 4·10⁸ steps.
    let uses = vec![format!(r#"{{ "use": "s{}" }}"#, links - 1); links].join(", ");
    assert_eq!(job(&chain, &format!(r#"{{ "union": {{ "of": [{uses}] }} }}"#)).nodes(), links as u32 + 1);
}
