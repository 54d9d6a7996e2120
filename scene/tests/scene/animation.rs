//! Properties of every number of every node's example when it is animated. No test names a node.

use scene::nodes::{Example, Node};
use scene::real::vec3;
use serde_json::{Value, json};

/// The JSON pointers of all numbers in a value.
fn numbers(value: &Value, pointer: &str, found: &mut Vec<String>) {
    match value {
        Value::Number(_) => found.push(pointer.to_owned()),
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(index, item)| numbers(item, &format!("{pointer}/{index}"), found));
        }
        Value::Object(entries) => {
            entries.iter().for_each(|(key, entry)| numbers(entry, &format!("{pointer}/{key}"), found));
        }
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

/// Calls `check` with each node, a number of it, and a function that replaces that number by something else.
fn each_number(mut check: impl FnMut(&str, &Node, f64, &dyn Fn(Value) -> Result<Node, serde_json::Error>)) {
    for Example { kind, index: number, json: node, .. } in Node::examples() {
        let value: Value = serde_json::from_str(&node).unwrap();
        let constant: Node = serde_json::from_str(&node).unwrap();
        let mut found = Vec::new();
        numbers(&value, "", &mut found);
        for pointer in found {
            let own = value.pointer(&pointer).and_then(Value::as_f64).unwrap();
            let with = |other: Value| {
                let mut changed = value.clone();
                *changed.pointer_mut(&pointer).unwrap() = other;
                serde_json::from_value(changed)
            };
            check(&format!("{kind} {number} {pointer}"), &constant, own, &with);
        }
    }
}

fn points() -> impl Iterator<Item = scene::real::Vec3<f32>> {
    let place = |index: u32, step: u32| index.wrapping_mul(step) as f32 / u32::MAX as f32 * 5.0 - 2.5;
    (0..4_000).map(move |index| vec3(place(index, 0x9e37_79b9), place(index, 0xc13f_a9a9), place(index, 0x91e1_0da5)))
}

#[test]
fn every_number_can_be_animated_or_says_that_it_is_constant() {
    each_number(|name, _, own, with| match with(json!({ "keys": [[0, own], [1, own]] })) {
        Ok(_) => {}
        Err(error) => assert!(error.to_string().contains("cannot be a track"), "{name}: {error}"),
    });
}

#[test]
fn animated_and_constant_numbers_give_the_same_distance() {
    each_number(|name, constant, own, with| {
        let Ok(moving) = with(json!({ "keys": [[0, own]] })) else { return };
        for p in points() {
            let (got, want) = (moving.distance(p), constant.distance(p));
            let rounding = 2e-5 * want.abs().max(1.0);
            assert!((got - want).abs() <= rounding, "{name}: {got} at {p:?}, which is {want} where nothing moves");
        }
    });
}

#[test]
fn a_number_animated_through_0_gives_finite_distances() {
    each_number(|name, _, _, with| {
        // Some numbers may not be 0, and some may not all be 0.
        let Ok(moving) = with(json!({ "keys": [[0, 0], [1, 1]] })) else { return };
        for p in points() {
            let distance = moving.distance(p);
            assert!(distance.is_finite(), "{name}: {distance} at {p:?}");
        }
        let (bounds, stretch) = (moving.bounds(0.0), moving.lipschitz());
        assert!(
            stretch.is_finite() && !bounds.min.x.is_nan() && !bounds.max.x.is_nan(),
            "{name}: {stretch}, {bounds:?}"
        );
    });
}
