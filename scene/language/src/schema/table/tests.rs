//! Tests the table against the schema and the parser.

use serde_json::json;

use super::*;
use crate::parse;

fn find<'t>(table: &'t NodeTable, family: Family, name: &str) -> &'t KindView {
    let mut named = table.kinds.iter().filter(|kind| kind.family == family && kind.name == name);
    let found = named.next().unwrap_or_else(|| panic!("there is no {name}"));
    assert_eq!(named.next(), None, "there are two {name}");
    found
}

fn key<'t>(kind: &'t KindView, name: &str) -> &'t KeyView {
    kind.keys.iter().find(|key| key.name == name).unwrap_or_else(|| panic!("{} has no {name}", kind.name))
}

/// Calls a function with each key of each object in a schema, and its own schema.
fn each_key(schema: &Value, visit: &mut impl FnMut(&str, &Value)) {
    if let (Some(properties), true) = (schema["properties"].as_object(), schema["type"] == "object") {
        properties.iter().for_each(|(key, property)| visit(key, property));
    }
    match schema {
        Value::Object(members) => {
            // An example or a default may have a member of that name.
            let schemas = members.iter().filter(|(key, _)| !["examples", "default", "const"].contains(&key.as_str()));
            schemas.for_each(|(_, inside)| each_key(inside, visit));
        }
        Value::Array(members) => members.iter().for_each(|inside| each_key(inside, visit)),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
    }
}

#[test]
fn every_key_of_the_schema_is_in_the_table_with_its_description() {
    let table = node_table();
    let mut written: BTreeSet<(String, String)> = BTreeSet::new();
    for kind in &table.kinds {
        // A kind's name is a key itself.
        written.insert((kind.name.clone(), kind.documentation.clone()));
        written.extend(kind.keys.iter().map(|key| (key.name.clone(), key.documentation.clone())));
    }
    let names: BTreeSet<&str> = written.iter().map(|(name, _)| name.as_str()).collect();
    let mut count = 0;
    each_key(&crate::editor_schema(), &mut |name, schema| {
        assert!(names.contains(name), "{name} is missing");
        if let Some(text) = schema["description"].as_str() {
            assert!(written.contains(&(name.to_owned(), text.to_owned())), "{name}: {text}");
        }
        count += 1;
    });
    assert!(count > 400, "only {count} keys");
}

/// A job with an example.
fn job(family: Family, example: &Value) -> Value {
    let mut job = json!({
        "scene": {
            "camera": { "position": [0, 1, 4], "look_at": [0, 0, 0] },
            "objects": [{ "shape": { "sphere": { "radius": 1 } } }]
        },
        "image": { "width": 320, "height": 180 }
    });
    let scene = &mut job["scene"];
    match family {
        Family::Node => scene["objects"][0]["shape"] = example.clone(),
        Family::Profile => scene["objects"][0]["shape"] = json!({ "extrude": { "profile": example, "height": 1 } }),
        Family::Material => scene["objects"][0]["material"] = example.clone(),
        Family::Texture => scene["objects"][0]["material"] = json!({ "flat": { "color": example } }),
        Family::Light => {
            scene["lights"] = json!([example]);
            scene["background"] = json!({ "day": { "sun": [0, 1, 0] } });
        }
        Family::Background => scene["background"] = example.clone(),
        Family::Projection => scene["camera"]["projection"] = example.clone(),
        Family::Effect => scene.as_object_mut().expect("an object").extend(example.as_object().expect("keys").clone()),
        Family::Document => return example.clone(),
    }
    job
}

#[test]
fn every_example_of_a_family_parses_in_a_job() {
    let mut families = BTreeMap::new();
    for kind in node_table().kinds {
        let is_job = kind.family == Family::Document && kind.name == "job";
        if (kind.family == Family::Document && !is_job) || (kind.family == Family::Node && kind.name == "use") {
            continue;
        }
        assert!(!kind.example.is_null(), "{} has no example", kind.name);
        let parsed = parse(job(kind.family, &kind.example).to_string().as_bytes());
        assert!(parsed.is_ok(), "{}: {}: {:?}", kind.name, kind.example, parsed.err());
        *families.entry(kind.family).or_insert(0) += 1;
    }
    assert_eq!(families.len(), 9, "{families:?}");
    assert!(families[&Family::Node] > 60 && families[&Family::Light] >= 6, "{families:?}");
}

#[test]
fn everything_that_a_value_can_be_is_in_the_table() {
    let table = node_table();
    let families: Vec<&str> = values::tests::KIND_NAMES.to_vec();
    for kind in &table.kinds {
        assert!(!kind.title.is_empty() && !kind.title.contains('\n'), "{}: {:?}", kind.name, kind.title);
        for name in kind.keys.iter().flat_map(|key| &key.shape.of).chain(kind.value.iter().flat_map(|value| &value.of))
        {
            let is_effect = |kind: &KindView| kind.family == Family::Effect && kind.name == *name;
            if !families.contains(&name.as_str()) && !table.kinds.iter().any(is_effect) {
                find(&table, Family::Document, name);
            }
        }
        for key in &kind.keys {
            assert!(!key.documentation.is_empty(), "{} {}", kind.name, key.name);
            let is_empty = key.example == json!({});
            assert!(key.shape.kind != "object" || is_empty || !key.shape.of.is_empty(), "{} {}", kind.name, key.name);
        }
    }
}

#[test]
fn keys_have_the_values_of_the_schema() {
    let table = node_table();
    let sphere = find(&table, Family::Node, "sphere");
    assert_eq!(
        (&*sphere.title, sphere.picture.as_deref()),
        ("A ball around the origin.", Some("/ui/pictures/node-sphere.webp"))
    );
    let radius = key(sphere, "radius");
    assert_eq!((&*radius.shape.kind, radius.required, radius.unit.as_deref()), ("number", true, Some("scene units")));
    assert_eq!((radius.shape.minimum, radius.shape.maximum), (Some(1e-6), Some(1e6)));
    assert_eq!(radius.shape.of, ["track", "formula"]);
    assert_eq!(key(find(&table, Family::Node, "union"), "of").shape.kind, "nodes");
    assert_eq!(key(find(&table, Family::Node, "union"), "smooth").default, json!(0.0));
    assert_eq!(key(find(&table, Family::Node, "translate"), "by").shape.kind, "vec3");
    assert_eq!(key(find(&table, Family::Node, "rotate"), "degrees").unit.as_deref(), Some("degrees"));
    let color = key(find(&table, Family::Material, "flat"), "color");
    assert_eq!((&*color.shape.kind, &*color.shape.of), ("color", &["texture".to_owned()][..]));
    let scene = find(&table, Family::Document, "scene");
    assert_eq!((&*key(scene, "lights").shape.kind, &*key(scene, "materials").shape.kind), ("lights", "map"));
    assert_eq!(key(scene, "materials").shape.of, ["material"]);
    assert_eq!(key(scene, "objects").shape.of, ["object"]);
    assert!(scene.keys[0].required && !scene.keys[scene.keys.len() - 1].required);
    let image = find(&table, Family::Document, "image");
    let words: Vec<&Value> = key(image, "format").shape.words.iter().map(|word| &word.word).collect();
    assert_eq!(words, ["png", "exr"]);
    assert_eq!((&*key(image, "layers").shape.kind, key(image, "layers").shape.words.len()), ("words", 11));
    let solid = find(&table, Family::Background, "color");
    assert_eq!(solid.value.as_ref().map(|value| &*value.kind), Some("color"));
    assert_eq!(find(&table, Family::Background, "transparent").example, json!("transparent"));
    assert!(find(&table, Family::Document, "noise").is_choice);
}
