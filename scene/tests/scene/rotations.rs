//! Rotations about an axis, about a point, and toward a point.

use scene::real::{Vec3, vec3};
use scene::{Job, ParseError, parse};

fn text(node: &str) -> String {
    format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 9], "look_at": [0, 0, 0] }}, "objects": [{{ "shape": {node} }}] }},
            "image": {{ "width": 8, "height": 8 }}, "frames": {{ "count": 3, "fps": 1 }} }}"#
    )
}

fn job(node: &str) -> Job {
    parse(text(node).as_bytes()).unwrap_or_else(|error| panic!("{node}\n{error}"))
}

fn distance(job: &Job, frame: u32, p: [f32; 3]) -> f32 {
    let at = job.at(frame).expect("a valid frame");
    let [x, y, z] = p;
    at.scene().objects[0].shape.distance(vec3(x, y, z))
}

const POINTS: [[f32; 3]; 5] = [[1.0, 0.0, 0.0], [0.3, -1.2, 0.8], [0.0, 2.0, 0.1], [-1.5, 0.4, -0.7], [0.2, 0.2, 3.0]];
const CHILD: &str = r#"{ "box": { "size": [1.2, 0.6, 2] } }"#;

fn same(a: &Job, b: &Job, frame: u32) {
    for p in POINTS {
        let (a, b) = (distance(a, frame, p), distance(b, frame, p));
        assert!((a - b).abs() < 1e-5, "{p:?}: {a} and {b}");
    }
}

#[test]
fn one_angle_about_an_axis_is_the_rotation_about_it() {
    for (axis, angles) in [("[1, 0, 0]", "[35, 0, 0]"), ("[0, 2, 0]", "[0, 35, 0]"), ("[0, 0, 0.1]", "[0, 0, 35]")] {
        let one = job(&format!(r#"{{ "rotate": {{ "degrees": 35, "axis": {axis}, "child": {CHILD} }} }}"#));
        let three = job(&format!(r#"{{ "rotate": {{ "degrees": {angles}, "child": {CHILD} }} }}"#));
        same(&one, &three, 0);
    }
    // A third of a turn about the diagonal moves each axis to the next.
    let rotated = job(&format!(r#"{{ "rotate": {{ "degrees": 120, "axis": [1, 1, 1], "child": {CHILD} }} }}"#));
    let plain = job(CHILD);
    for [x, y, z] in POINTS {
        let (a, b) = (distance(&rotated, 0, [z, x, y]), distance(&plain, 0, [x, y, z]));
        assert!((a - b).abs() < 1e-5, "{a} and {b}");
    }
}

#[test]
fn a_rotation_about_a_point_keeps_it_in_place() {
    let about =
        job(&format!(r#"{{ "rotate": {{ "degrees": [10, 20, 30], "about": [1, -2, 0.5], "child": {CHILD} }} }}"#));
    let moved = job(&format!(
        r#"{{ "translate": {{ "by": [1, -2, 0.5], "child": {{ "rotate": {{ "degrees": [10, 20, 30],
            "child": {{ "translate": {{ "by": [-1, 2, -0.5], "child": {CHILD} }} }} }} }} }} }}"#
    ));
    same(&about, &moved, 0);
}

#[test]
fn one_angle_and_three_have_tracks() {
    let one = job(&format!(
        r#"{{ "rotate": {{ "degrees": {{ "keys": [[0, 0], [2, 90]] }}, "axis": [0, 1, 0], "child": {CHILD} }} }}"#
    ));
    let three = job(&format!(
        r#"{{ "rotate": {{ "degrees": {{ "keys": [[0, [0, 0, 0]], [2, [0, 90, 0]]] }}, "child": {CHILD} }} }}"#
    ));
    let formula = job(&format!(
        r#"{{ "rotate": {{ "degrees": {{ "expr": "45 * t" }}, "axis": [0, 1, 0], "child": {CHILD} }} }}"#
    ));
    for frame in 0..3 {
        same(&one, &three, frame);
        same(&one, &formula, frame);
    }
}

#[test]
fn a_shape_that_aims_has_its_z_axis_toward_the_point() {
    let pin = r#"{ "translate": { "by": [0, 0, 2], "child": { "sphere": { "radius": 0.1 } } } }"#;
    let fin = r#"{ "translate": { "by": [0, 1, 0], "child": { "sphere": { "radius": 0.1 } } } }"#;
    let at = vec3(1.0_f32, 2.0, -2.0);
    let aim = |child: &str| job(&format!(r#"{{ "aim": {{ "at": [1, 2, -2], "child": {child} }} }}"#));
    let near = |shape: &Job, p: Vec3<f32>| (distance(shape, 0, p.into()) + 0.1).abs() < 1e-5;
    assert!(near(&aim(pin), at * (2.0 / 3.0)), "the z axis");
    // The y axis is across, and as high as it can be.
    let up = vec3(0.0, 1.0, 0.0) - at * (at.y / 9.0);
    assert!(near(&aim(fin), up.normalize()), "the y axis");
}

#[test]
fn rotations_that_make_no_sense_are_errors() {
    for (node, pointer, words) in [
        (r#"{ "rotate": { "degrees": 30, "child": C } }"#, "/rotate/degrees", "give it an axis"),
        (r#"{ "rotate": { "degrees": [1, 2, 3], "axis": [0, 1, 0], "child": C } }"#, "/rotate/axis", "leave axis out"),
        (
            r#"{ "rotate": { "degrees": "30", "axis": [0, 1, 0], "child": C } }"#,
            "/rotate/degrees",
            "a list of 3 numbers",
        ),
        (
            r#"{ "rotate": { "degrees": { "keys": [[0, 1], [1, [1, 2, 3]]] }, "child": C } }"#,
            "/rotate/degrees",
            "the same in all",
        ),
        (r#"{ "aim": { "at": [0, 0, 0], "child": C } }"#, "/aim/at", "other than the origin"),
        (r#"{ "aim": { "at": [0, -3, 0], "child": C } }"#, "/aim", "parallel"),
        (r#"{ "aim": { "at": { "keys": [[0, [1, 0, 0]], [2, [-1, 0, 0]]] }, "child": C } }"#, "/aim/at", "frame 1"),
    ] {
        let text = text(&node.replace('C', CHILD));
        let Err(ParseError::Invalid(errors)) = parse(text.as_bytes()) else { panic!("{node} is valid") };
        assert_eq!(errors[0].pointer, format!("/scene/objects/0/shape{pointer}"), "{node}: {errors:?}");
        assert!(errors[0].message.contains(words), "{node}: {errors:?}");
    }
}
