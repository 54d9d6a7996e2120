//! Contract tests that every light, background, projection and effect must pass, run on each one's own examples. No
//! test names a kind.

use std::collections::BTreeSet;

use crate::subject as scene;
use scene::backgrounds::Background;
use scene::camera::Projection;
use scene::kinds::Example;
use scene::lights::Light;
use scene::{Integrator, Job, effects};
use serde_json::{Value, json};

/// A family of kinds: its examples, its position in the schema, and a scene with one of its values.
struct Family {
    name: &'static str,
    examples: Vec<Example>,
    /// The definition that lists the kinds, or that of the scene, if each kind is a key of it.
    definition: &'static str,
    scene: fn(&Value) -> Value,
}

fn families() -> [Family; 4] {
    [
        Family {
            name: "light",
            examples: Light::examples(),
            definition: "Light",
            scene: |light| json!({ "lights": [light], "background": { "day": { "sun": [0.6, 0.5, 0.4] } } }),
        },
        Family {
            name: "background",
            examples: Background::examples(),
            definition: "Background",
            scene: |background| json!({ "background": background }),
        },
        Family {
            name: "projection",
            examples: Projection::examples(),
            definition: "Projection",
            scene: |projection| json!({ "camera": { "position": [1.5, 1.4, 3.2], "look_at": [0, 0, 0], "projection": projection } }),
        },
        Family { name: "effect", examples: effects::examples(), definition: "Scene", scene: Value::clone },
    ]
}

/// Text of a job with these keys in its scene: a ball on a floor, matte and without emission.
fn text(keys: &Value) -> String {
    let material = json!({ "diffuse": { "ambient": [0.02, 0.02, 0.02], "ks": [0.2, 0.2, 0.2] } });
    let mut scene = json!({ "camera": { "position": [1.5, 1.4, 3.2], "look_at": [0, 0.6, 0], "fov": 60 }, "objects": [
        { "shape": { "sphere": { "radius": 1 } }, "material": material },
        { "shape": { "plane": { "normal": [0, 1, 0], "offset": -1 } }, "material": material } ] });
    for (key, value) in keys.as_object().expect("an object") {
        scene[key] = value.clone();
    }
    json!({ "scene": scene, "image": { "width": 24, "height": 12, "samples": 3 } }).to_string()
}

fn job(keys: &Value) -> Job {
    let text = text(keys);
    scene::parse(text.as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}\n{text}"))
}

/// Calls `check` with the name of each example, its family, and its value.
fn each(mut check: impl FnMut(&str, &Family, &Example, &Value)) {
    for family in families() {
        for example in &family.examples {
            let value = serde_json::from_str(&example.json).expect("an example is JSON");
            check(&format!("{} {} {}", family.name, example.name, example.index), &family, example, &value);
        }
    }
}

/// Every channel of the job's picture, computed in `f32`.
fn pixels(job: &Job) -> Vec<f32> {
    let at_frame = job.at(0).expect("the job is valid");
    let program = Integrator::new(&at_frame);
    let mut channels = Vec::new();
    for (x, y) in (0..job.image.height).flat_map(|y| (0..job.image.width).map(move |x| (x, y))) {
        let seen = program.pixel(x as f32, y as f32);
        channels.extend([seen.color.x, seen.color.y, seen.color.z, seen.alpha]);
    }
    channels
}

#[test]
fn every_kind_survives_a_json_round_trip() {
    each(|name, family, _, value| {
        let mut keys = (family.scene)(value);
        let read = job(&keys);
        let written = serde_json::to_value(&read.scene).expect("a scene can be written");
        for (key, value) in keys.as_object_mut().expect("keys of a scene") {
            *value = written[key].clone();
        }
        assert_eq!(job(&keys).scene, read.scene, "{name}: {keys}");
    });
}

#[test]
fn the_schema_describes_every_kind_and_each_of_its_keys() {
    let schema = scene::schema();
    each(|name, family, example, value| {
        let definition = &schema["$defs"][family.definition];
        let Some((key, value)) = value.as_object().and_then(|object| object.iter().next()) else {
            let words = &schema["$defs"][format!("{}Word", family.definition)];
            assert!(words["enum"].as_array().expect("the schema has a list of words").contains(value), "{name}");
            let described = format!("- `{value}`: ");
            return assert!(words["description"].as_str().is_some_and(|text| text.contains(&described)), "{name}");
        };
        let own = &schema["$defs"][example.kind];
        assert!(own["description"].is_string(), "{name} has no description");
        let choices = definition["oneOf"].as_array().into_iter().flatten();
        let choices = choices.filter_map(|choice| choice["$ref"].as_str()?.strip_prefix("#/$defs/"));
        let mut keyed = choices.map(|choice| &schema["$defs"][choice]).chain([definition]);
        let keyed = keyed.find(|keyed| keyed["properties"][key].is_object());
        let keyed = keyed.unwrap_or_else(|| panic!("{name}: {} does not list it", family.definition));
        assert_eq!(keyed["properties"][key]["$ref"], format!("#/$defs/{}", example.kind), "{name}");
        for key in value.as_object().into_iter().flat_map(serde_json::Map::keys) {
            assert!(own["properties"][key].is_object(), "{name} has no {key} in the schema");
        }
        if own["type"] == "object" {
            assert_eq!(own["additionalProperties"], false, "{name} takes unknown keys");
        }
        for (key, property) in own["properties"].as_object().into_iter().flatten() {
            assert!(property["description"].is_string(), "{name}: {key} has no description");
        }
        assert_eq!(key, &example.name, "{name}");
    });
}

#[test]
fn effects_list_every_optional_effect_of_a_scene() {
    let schema = scene::schema();
    let required = schema["$defs"]["Scene"]["required"].as_array().expect("a scene needs some keys");
    let properties = schema["$defs"]["Scene"]["properties"].as_object().expect("a scene has keys").iter();
    let optional =
        properties.filter(|(key, property)| property.get("default").is_none() && !required.contains(&json!(key)));
    let keys: BTreeSet<String> = optional.map(|(key, _)| key.clone()).collect();
    let mut listed: BTreeSet<String> = effects::examples().into_iter().map(|example| example.name).collect();
    // Not an effect, but a second background.
    listed.insert("environment".to_owned());
    assert_eq!(keys, listed);
}

#[test]
fn light_is_finite_and_never_negative_with_every_kind() {
    each(|name, family, _, value| {
        let pixels = pixels(&job(&(family.scene)(value)));
        assert!(pixels.iter().all(|channel| channel.is_finite() && *channel >= 0.0), "{name}: {pixels:?}");
        assert!(pixels.iter().any(|channel| *channel != pixels[0]), "{name} shows nothing");
    });
}

#[test]
fn every_example_has_its_own_picture_and_cache_key() {
    for family in families() {
        let jobs: Vec<(String, Job)> = family
            .examples
            .iter()
            .map(|example| {
                let value = serde_json::from_str(&example.json).expect("an example is JSON");
                (format!("{} {}", example.name, example.index), job(&(family.scene)(&value)))
            })
            .collect();
        let seen: Vec<(Vec<f32>, _)> = jobs.iter().map(|(_, job)| (pixels(job), job.cache_key(0))).collect();
        for (one, other) in (0..jobs.len()).flat_map(|one| (0..one).map(move |other| (one, other))) {
            let names = format!("{} {} and {}", family.name, jobs[one].0, jobs[other].0);
            assert!(seen[one].0 != seen[other].0, "{names} look the same");
            assert_ne!(seen[one].1, seen[other].1, "{names} have one key");
        }
    }
}

#[test]
fn examples_have_no_warnings() {
    each(|name, family, _, value| {
        let warnings = scene::warnings(&job(&(family.scene)(value)));
        assert!(warnings.is_empty(), "{name}: {warnings:?}");
    });
}

#[test]
fn a_black_light_gets_a_warning_and_has_no_effect() {
    let dark = pixels(&job(&json!({ "lights": [], "background": { "day": { "sun": [0.6, 0.5, 0.4] } } })));
    let lights = families().into_iter().find(|family| family.name == "light").expect("lights are a family");
    let schema = scene::schema();
    for example in &lights.examples {
        let mut light: Value = serde_json::from_str(&example.json).expect("an example is JSON");
        let keys = schema["$defs"][example.kind]["properties"].as_object().expect("a light has keys");
        let own = &mut light[&example.name];
        let was = own.clone();
        if keys.contains_key("color") {
            own["color"] = json!([0, 0, 0]);
        } else {
            own["strength"] = json!(0);
        }
        let job = job(&(lights.scene)(&light));
        let warnings = scene::warnings(&job);
        assert!(warnings.iter().any(|warning| warning.contains("all lights are black")), "{was}: {warnings:?}");
        assert_eq!(pixels(&job), dark, "{light} lights something");
    }
}

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

#[test]
fn animated_and_constant_numbers_give_the_same_picture() {
    each(|name, family, _, value| {
        let mut found = Vec::new();
        numbers(value, "", &mut found);
        let want = pixels(&job(&(family.scene)(value)));
        for pointer in found {
            let mut changed = value.clone();
            let number = changed.pointer_mut(&pointer).expect("it was found there");
            *number = json!({ "keys": [[0, number.clone()]] });
            let got = pixels(&job(&(family.scene)(&changed)));
            let off = got.iter().zip(&want).map(|(got, want)| (got - want).abs() / want.max(1.0)).fold(0.0, f32::max);
            // A light whose angle may be 0 in another frame is sampled in all of them.
            assert!(off <= 0.05, "{name} {pointer} is off by {off}");
        }
    });
}
