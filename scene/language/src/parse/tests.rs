//! Tests of error collection: every error is reported at its position, in bounded time, without false errors.

use super::*;
use crate::error::ValidationError;
use crate::limits::MAX_NODES;
use crate::materials::Material;
use crate::nodes::Node;

const SEVERAL: &str = include_str!("../../../../tests/bad_input/several.txt");

/// A valid job around some objects.
fn around(objects: &str) -> String {
    format!(
        "{{ \"scene\": {{ \"camera\": {{ \"position\": [0, 0, 5], \"look_at\": [0, 0, 0] }}, \"objects\": [\n{objects}\n] }},\n\
         \"image\": {{ \"width\": 32, \"height\": 32 }} }}"
    )
}

fn faults(text: &str) -> Vec<ValidationError> {
    match parse(text.as_bytes()) {
        Ok(_) => Vec::new(),
        Err(ParseError::Invalid(faults)) => faults,
        Err(ParseError::NotJson(fault)) => panic!("{fault}: {text}"),
    }
}

/// The text without its marks, and the lines and columns of the marks.
fn unmarked(text: &str) -> (String, Vec<(u32, u32)>) {
    let mut parts = text.split('¤');
    let mut plain = parts.next().unwrap_or_default().to_owned();
    let mut places = Vec::new();
    for part in parts {
        let line = plain.matches('\n').count() + 1;
        let column = plain.len() - plain.rfind('\n').map_or(0, |newline| newline + 1) + 1;
        places.push((line as u32, column as u32));
        plain.push_str(part);
    }
    (plain, places)
}

#[test]
fn each_of_several_errors_is_reported_exactly_once() {
    let mut wrong = Vec::new();
    for case in SEVERAL.split("\n## ").skip(1) {
        let (name, rest) = case.split_once('\n').expect("a name");
        let (job, reported) = rest.split_once("\n-- ").expect("expected errors");
        let job = job.strip_prefix("OBJECTS\n").map_or_else(|| job.to_owned(), around);
        let (text, places) = unmarked(&job);
        let reported: Vec<(&str, &str)> = reported
            .trim_end()
            .split("\n-- ")
            .map(|line| line.split_once(" | ").expect("a pointer and words"))
            .collect();
        assert_eq!(places.len(), reported.len(), "{name}: marks and messages");
        let found = faults(&text);
        let is_right = found.len() == reported.len()
            && found.iter().zip(&reported).zip(&places).all(|((fault, (pointer, words)), place)| {
                fault.pointer == *pointer && fault.message.contains(words) && (fault.line, fault.column) == *place
            });
        if !is_right {
            let found: Vec<String> = found.iter().map(ValidationError::to_string).collect();
            wrong.push(format!("{name}: at {places:?} should have\n{reported:#?}\nbut has\n{}", found.join("\n")));
        }
    }
    assert!(wrong.is_empty(), "{} cases:\n{}", wrong.len(), wrong.join("\n\n"));
    assert!(SEVERAL.matches("\n## ").count() >= 20);
}

/// Each position of a value of an example, with the value made invalid, and an unrelated error next to it.
fn syntax_error(value: &serde_json::Value, visit: &mut impl FnMut(&str, &serde_json::Value)) {
    fn places(value: &serde_json::Value, pointer: String, all: &mut Vec<String>) {
        match value {
            serde_json::Value::Object(members) => {
                members.iter().for_each(|(key, value)| places(value, format!("{pointer}/{key}"), all));
            }
            serde_json::Value::Array(entries) => {
                entries.iter().enumerate().for_each(|(index, entry)| places(entry, format!("{pointer}/{index}"), all));
            }
            _ => {}
        }
        all.push(pointer);
    }
    let mut all = Vec::new();
    places(value, String::new(), &mut all);
    for pointer in all {
        let mut broken = value.clone();
        *broken.pointer_mut(&pointer).expect("it is there") = serde_json::json!({ "¤": 1, "¤¤": 2 });
        visit(&pointer, &broken);
    }
}

#[test]
fn an_invalid_value_does_not_hide_other_errors() {
    let shapes = Node::examples().into_iter().map(|example| (example.json, true));
    let materials = Material::examples().into_iter().map(|example| (example.json, false));
    let mut wrong = Vec::new();
    for (json, is_shape) in shapes.chain(materials) {
        let example: serde_json::Value = serde_json::from_str(&json).expect("an example");
        syntax_error(&example, &mut |pointer, broken| {
            let object = if is_shape {
                format!(r#"{{ "shape": {broken} }}"#)
            } else {
                format!(r#"{{ "material": {broken}, "shape": {{ "sphere": {{ "radius": 1 }} }} }}"#)
            };
            let other = r#"{ "shape": { "sphere": { "radius": -1 } } }"#;
            let found = faults(&around(&format!("{object}, {other}")));
            let place = if is_shape { "/scene/objects/0/shape" } else { "/scene/objects/0/material" };
            let place = format!("{place}{pointer}");
            let is_right = found.last().is_some_and(|fault| fault.pointer == "/scene/objects/1/shape/sphere/radius")
                && found.len() >= 2
                && found[..found.len() - 1].iter().all(|fault| fault.pointer.starts_with(&place));
            if !is_right {
                let found: Vec<String> = found.iter().map(ValidationError::to_string).collect();
                wrong.push(format!("{pointer} of {json}: {}", found.join("\n    ")));
            }
        });
    }
    assert!(wrong.is_empty(), "{} cases:\n{}", wrong.len(), wrong.join("\n"));
}

#[test]
fn the_first_hundred_errors_are_reported() {
    let objects = vec![r#"{ "shape": { "sphere": { "radius": -1 } } }"#; 5000].join(",\n");
    let found = faults(&around(&objects));
    assert_eq!(found.len(), MAX_ERRORS);
    assert_eq!(found[99].pointer, "/scene/objects/99/shape/sphere/radius");
}

#[test]
fn examples_of_every_node_have_no_errors() {
    for example in Node::examples() {
        assert_eq!(faults(&around(&format!(r#"{{ "shape": {} }}"#, example.json))), [], "{}", example.json);
    }
}

#[test]
fn work_for_a_large_text_is_bounded_by_its_bytes() {
    // If all the text were parsed again for each error, this would be 100 × 4 MB, and more for each stand-in tried.
    let keys: String =
        (0..200_000).flat_map(|key| ["\"unknown ".to_owned(), key.to_string(), "\": 1, ".to_owned()]).collect();
    let text = around(&format!(r#"{{ {keys} "shape": {{ "sphere": {{ "radius": 1 }} }} }}"#));
    let tree = Tree::read(&text).unwrap_or_else(|error| panic!("{error:?}"));
    let (all, bytes) = collect::counted(&tree);
    assert!(!all.is_empty() && all.len() <= MAX_ERRORS, "{}", all.len());
    assert!(bytes <= (32 << 20) + 3 * text.len(), "{bytes} of {}", text.len());
}

#[test]
fn errors_below_a_misspelled_node_are_reported_too() {
    let text =
        around(r#"{ "shape": { "unoin": { "of": [{ "sphere": { "radius": 1 } }, { "spheer": { "radius": 1 } }] } } }"#);
    let found: Vec<String> = faults(&text).iter().map(ValidationError::to_string).collect();
    assert_eq!(found.len(), 2, "{found:#?}");
    assert!(found[0].contains("did you mean `union`") && found[1].contains("did you mean `sphere`"), "{found:#?}");
}

#[test]
fn as_many_nodes_as_allowed_are_accepted() {
    let copies = |grid: [usize; 3]| {
        let copies = format!(
            r#"{{ "child": {{ "sphere": {{ "radius": 1 }} }}, "at": {{ "grid": {grid:?}, "step": [3, 3, 3] }} }}"#
        );
        faults(&around(&format!(r#"{{ "shape": {{ "copies": {copies} }} }}"#)))
    };
    assert_eq!(999 * 1001 + 1, MAX_NODES, "copies, and the node that makes them");
    assert_eq!(copies([999, 1001, 1]), []);
    let faults = copies([1000, 1000, 1]);
    assert!(faults.len() == 1 && faults[0].message.contains("makes 1000001 nodes"), "{faults:#?}");
}

#[test]
fn a_text_of_too_many_values_has_its_first_error_only() {
    let wrong = |count: usize| {
        let numbers = "0,".repeat(count);
        faults(&format!(r#"{{ "numbers": [{numbers}0], "scene": 1, "image": {{}} }}"#)).len()
    };
    assert!(wrong(1000) > 1);
    assert_eq!(wrong(1_500_000), 1);
}

#[test]
fn lists_in_place_of_objects_are_errors_wherever_they_are() {
    for (text, pointer) in [
        ("[]".to_owned(), ""),
        (around(r#"[{ "diffuse": {} }, { "sphere": { "radius": 1 } }]"#), "/scene/objects/0"),
        (around(r#"{ "shape": { "sphere": [1] } }"#), "/scene/objects/0/shape/sphere"),
        (
            around(r#"{ "shape": { "union": { "of": [{ "sphere": [1] }] } } }"#),
            "/scene/objects/0/shape/union/of/0/sphere",
        ),
        (
            around(r#"{ "shape": { "sphere": { "radius": [[[0, 1]], "smooth"] } } }"#),
            "/scene/objects/0/shape/sphere/radius",
        ),
    ] {
        let found = faults(&text);
        assert!(found.first().is_some_and(|fault| fault.pointer == pointer), "{text}: {found:#?}");
    }
}
