//! Tests every node with its numbers at the ends of their ranges, from the schema. No test names a node.

use std::panic::{AssertUnwindSafe, catch_unwind};

use scene::ParseError;
use scene::nodes::{Example, Node};
use scene::real::{Vec3, vec3};
use serde_json::{Number, Value, json};

/// A number of an example: its pointer, and the ends of its range.
struct ExampleNumber {
    pointer: String,
    ends: Vec<Number>,
}

/// The schema after following references.
fn resolved<'s>(root: &'s Value, schema: &'s Value) -> &'s Value {
    match schema["$ref"].as_str() {
        Some(reference) => resolved(root, root.pointer(reference.trim_start_matches('#')).expect("a definition")),
        None => schema,
    }
}

/// The schemas that may describe a value: all alternatives, and the keywords next to them.
fn alternatives<'s>(root: &'s Value, schema: &'s Value) -> Vec<&'s Value> {
    let schema = resolved(root, schema);
    let choices = ["oneOf", "anyOf", "allOf"].into_iter().filter_map(|key| schema[key].as_array()).flatten();
    std::iter::once(schema).chain(choices.flat_map(|choice| alternatives(root, choice))).collect()
}

/// Pointers and ranges of all numbers in `value`, which the schemas describe.
fn places<'s>(root: &'s Value, schemas: &[&'s Value], value: &Value, pointer: &str, found: &mut Vec<ExampleNumber>) {
    match value {
        Value::Object(map) => {
            // The alternatives of a choice that have all of the value's keys.
            let fits = |schema: &&&Value| map.keys().all(|key| schema["properties"].get(key).is_some());
            for (key, inner) in map {
                let of_key = |schema: &&'s Value| alternatives(root, &schema["properties"][key]);
                let inner_schemas: Vec<&Value> = schemas.iter().filter(fits).flat_map(of_key).collect();
                places(root, &inner_schemas, inner, &format!("{pointer}/{key}"), found);
            }
        }
        Value::Array(list) => {
            for (index, inner) in list.iter().enumerate() {
                let of_item = |schema: &&'s Value| schema["prefixItems"].get(index).or(schema.get("items"));
                let items = schemas.iter().filter_map(of_item);
                let inner_schemas: Vec<&Value> = items.flat_map(|item| alternatives(root, item)).collect();
                places(root, &inner_schemas, inner, &format!("{pointer}/{index}"), found);
            }
        }
        Value::Number(_) => found.push(ExampleNumber { pointer: pointer.to_owned(), ends: ends(schemas) }),
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

/// Minimum and maximum of each range that schemas allow, and 0 if it is in between.
fn ends(schemas: &[&Value]) -> Vec<Number> {
    let is_whole = schemas.iter().any(|schema| schema["type"] == "integer");
    let largest_word = json!(u32::MAX);
    let mut found = Vec::new();
    for schema in schemas {
        let largest = match (&schema["maximum"], schema["format"].as_str()) {
            (Value::Null, Some("uint32")) => &largest_word,
            (given, _) => given,
        };
        if let (Some(low), Some(high)) = (schema["minimum"].as_f64(), largest.as_f64()) {
            let zero = (low <= 0.0 && 0.0 <= high).then_some(0.0);
            found.extend([Some(low), Some(high), zero].into_iter().flatten());
        }
    }
    // JSON does not accept 1.0 as an integer.
    let number = |end: f64| if is_whole { Some(Number::from(end as i64)) } else { Number::from_f64(end) };
    found.into_iter().filter_map(number).collect()
}

/// Points all over space, near the origin and far from it.
fn points() -> impl Iterator<Item = Vec3<f32>> {
    let mut word = 1_u32;
    let mut next = move |reach: f32| {
        word = word.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let mixed = ((word >> ((word >> 28) + 4)) ^ word).wrapping_mul(277_803_737);
        reach * ((((mixed >> 22) ^ mixed) >> 8) as f32 / (1 << 23) as f32 - 1.0)
    };
    let reaches = [0.0, 1e-6, 1e-3, 0.1, 1.0, 3.0, 100.0, 1e3, 1e5, 1e6];
    (0..2_000).map(move |round| {
        let reach = reaches[round % reaches.len()];
        vec3(next(reach), next(reach), next(reach))
    })
}

/// The problem with a node of these numbers, if it is neither rejected with a reason nor finite everywhere.
fn wrong_with(node: &Value) -> Option<String> {
    let job = json!({
        "scene": { "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] }, "objects": [{ "shape": node }] },
        "image": { "width": 1, "height": 1 }
    });
    let shape = match scene::parse(job.to_string().as_bytes()) {
        Ok(job) => job.scene.objects[0].shape.clone(),
        Err(ParseError::NotJson(fault)) => return Some(format!("is not JSON: {fault}")),
        Err(ParseError::Invalid(faults)) => {
            let stray = faults.iter().find(|fault| {
                !fault.pointer.starts_with("/scene/objects/0/shape") || fault.message.split(' ').count() < 3
            });
            return stray.map(|fault| format!("is rejected without a fix: {fault}"));
        }
    };
    if !(shape.lipschitz().is_finite() && shape.lipschitz() > 0.0) {
        return Some(format!("has a Lipschitz factor of {}", shape.lipschitz()));
    }
    let bounds = shape.bounds(0.5);
    let sides: [[f32; 3]; 2] = [bounds.min.into(), bounds.max.into()];
    if sides.as_flattened().iter().any(|side| side.is_nan()) {
        return Some(format!("has the bounds {bounds:?}"));
    }
    points().find_map(|p| {
        let distance = shape.distance(p);
        (!distance.is_finite()).then(|| format!("is {distance} at {p:?}"))
    })
}

/// The problem with an example when some of its numbers are changed.
fn wrong_with_changes(example: &Value, changes: &[(&str, &Number)]) -> Option<String> {
    let mut changed = example.clone();
    for &(pointer, number) in changes {
        *changed.pointer_mut(pointer).expect("a place of the example") = Value::Number(number.clone());
    }
    let reason = catch_unwind(AssertUnwindSafe(|| wrong_with(&changed))).unwrap_or(Some("panics".to_owned()))?;
    let changes: Vec<String> = changes.iter().map(|(pointer, number)| format!("{pointer} = {number}")).collect();
    Some(format!("with {} {reason}", changes.join(" and ")))
}

/// Pointers and ranges of an example's numbers; each must have a range.
fn places_of(example: &Value) -> Vec<ExampleNumber> {
    let schema = scene::schema();
    let mut found = Vec::new();
    places(&schema, &alternatives(&schema, &schema["$defs"]["Node"]), example, "", &mut found);
    for ExampleNumber { pointer, ends } in &found {
        assert!(!ends.is_empty(), "the schema gives {pointer} of {example} no range");
    }
    found
}

fn each_example(mut check: impl FnMut(&Value, &[ExampleNumber]) -> Vec<String>) {
    let mut wrong = Vec::new();
    for Example { kind, index: number, json: node, .. } in Node::examples() {
        let example: Value = serde_json::from_str(&node).expect("an example is JSON");
        let found = check(&example, &places_of(&example));
        wrong.extend(found.into_iter().map(|reason| format!("{kind} {number} {reason}")));
    }
    assert!(wrong.is_empty(), "{} cases fail:\n{}", wrong.len(), wrong.join("\n"));
}

#[test]
fn extreme_numbers_are_rejected_or_give_finite_distances() {
    each_example(|example, places| {
        let changes = places.iter().flat_map(|place| place.ends.iter().map(|end| (place.pointer.as_str(), end)));
        changes.filter_map(|change| wrong_with_changes(example, &[change])).collect()
    });
}

#[test]
fn some_pairs_of_extreme_numbers_are_rejected_or_give_finite_distances() {
    check_pairs(23);
}

#[test]
#[ignore = "long: every pair; 20 s"]
fn pairs_of_extreme_numbers_are_rejected_or_give_finite_distances() {
    check_pairs(1);
}

/// Checks every `step`-th pair of extreme numbers of each example.
fn check_pairs(step: usize) {
    let mut pairs = 0;
    each_example(|example, places| {
        let mut wrong = Vec::new();
        for (index, first) in places.iter().enumerate() {
            for second in &places[index + 1..] {
                for (one, other) in first.ends.iter().flat_map(|one| second.ends.iter().map(move |other| (one, other)))
                {
                    pairs += 1;
                    if pairs % step != 0 {
                        continue;
                    }
                    let changes = [(first.pointer.as_str(), one), (second.pointer.as_str(), other)];
                    wrong.extend(wrong_with_changes(example, &changes));
                }
            }
        }
        wrong
    });
}
