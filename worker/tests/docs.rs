//! docs/nodes.md and its pictures, made from the nodes themselves. A stale page fails here;
//! `SDFARM_WRITE_DOCS=1 cargo test -p worker --test docs` writes it anew.

use std::fmt::Write as _;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use scene::bounds::Bounds;
use scene::nodes::{Exactness, Example, Node, snake_case};
use scene::real::vec3;
use serde_json::Value;
use worker::{Cancel, CpuRenderer, Simd};

const HEAD: &str = "# Nodes

Everything that has a distance. Each is keyed by its name; each picture shows the JSON below it, in grey
on a floor unless it says a material itself. What goes on all around the camera is shown within a ball.
This page is made from the code:
`SDFARM_WRITE_DOCS=1 cargo test -p worker --test docs`.
";

fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs")
}

/// The shape to draw: of one that goes on all around the camera, what is in a ball.
fn in_view(node: &str) -> String {
    let shape: Node = serde_json::from_str(node).expect("an example is a node");
    let mut above = (0..4_096).map(|place| {
        let step = |digit: u32| ((place >> digit) % 16) as f32;
        vec3(step(0) * 0.4 - 3.0, step(4) * 0.4 + 5.0, step(8) * 0.4 - 3.0)
    });
    if shape.bounds(0.0) == Bounds::EVERYWHERE && above.any(|p| shape.distance(p) < 0.0) {
        format!(r#"{{ "intersection": {{ "of": [{{ "sphere": {{ "radius": 1.25 }} }}, {node}] }} }}"#)
    } else {
        node.to_owned()
    }
}

fn picture(node: &str) -> Vec<u8> {
    let node = in_view(node);
    let text = format!(
        r#"{{ "scene": {{ "camera": {{ "position": [2.6, 2.1, 3.9], "look_at": [0, -0.1, 0], "fov": 36 }},
            "lights": [{{ "directional": {{ "direction": [-0.4, 0.9, 0.6], "color": [0.9, 0.88, 0.85] }} }},
                       {{ "directional": {{ "direction": [0.9, 0.3, 0.4], "color": [0.16, 0.18, 0.22], "shadow": false }} }}],
            "objects": [{{ "shape": {node}, "material": {{ "diffuse": {{ "kd": [0.62, 0.64, 0.68], "ks": [0.12, 0.12, 0.12], "shininess": 30 }} }} }},
                        {{ "shape": {{ "plane": {{ "normal": [0, 1, 0], "offset": -1.25 }} }},
                           "material": {{ "diffuse": {{ "kd": [0.42, 0.45, 0.5] }} }} }}] }},
          "image": {{ "width": 240, "height": 180, "samples": 16 }} }}"#
    );
    let job = scene::parse(text.as_bytes()).expect("an example makes a job");
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("this CPU renders");
    let mut file = Cursor::new(Vec::new());
    let scratch = std::env::temp_dir();
    worker::frame::render_frame(&renderer, &job, 0, None, &scratch, &mut file, &Cancel::new(), &|_| ())
        .expect("a small picture renders");
    file.into_inner()
}

/// The type's name in the schema as a reader would say it, with its range.
fn kind(schema: &Value, property: &Value) -> String {
    let resolved = property["$ref"]
        .as_str()
        .and_then(|reference| reference.rsplit('/').next())
        .map_or(property, |name| &schema["$defs"][name]);
    let range = match (&resolved["minimum"], &resolved["maximum"]) {
        (Value::Null, _) | (_, Value::Null) => String::new(),
        (low, high) => format!(", {low} to {high}"),
    };
    let name = property["$ref"].as_str().and_then(|reference| reference.rsplit('/').next());
    let name = name.or_else(|| resolved["type"].as_str()).unwrap_or("value");
    format!("{name}{range}")
}

fn file(example: &Example) -> String {
    match example.number {
        0 => format!("pictures/nodes/{}.png", snake_case(example.kind)),
        number => format!("pictures/nodes/{}-{}.png", snake_case(example.kind), number + 1),
    }
}

fn shown(example: &Example) -> String {
    let value: Value = serde_json::from_str(&example.node).expect("an example is JSON");
    let json = serde_json::to_string(&value).expect("JSON");
    format!("\n![{}]({})\n\n```json\n{json}\n```\n", snake_case(example.kind), file(example))
}

/// What the node's value is worth, and its Lipschitz factor.
fn worth(example: &Example) -> String {
    let node: Node = serde_json::from_str(&example.node).expect("an example is a node");
    let worth = match node.exactness() {
        Exactness::Exact => "exact",
        Exactness::Bound => "a bound",
        Exactness::Estimate => "an estimate",
    };
    format!("Distance: {worth}; Lipschitz factor of the example: {:.3}.", node.stretch())
}

fn section(schema: &Value, example: &Example) -> String {
    if example.number > 0 {
        return shown(example);
    }
    let name = snake_case(example.kind);
    let definition = &schema["$defs"][example.kind];
    let description = definition["description"].as_str().expect("every node is described");
    let mut text = format!("\n## {name}\n\n{description}\n\n{}\n\n", worth(example));
    let required: Vec<&str> =
        definition["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    text.push_str("| key | type | default | meaning |\n|---|---|---|---|\n");
    for (key, property) in definition["properties"].as_object().into_iter().flatten() {
        let default =
            if required.contains(&key.as_str()) { "required".to_owned() } else { property["default"].to_string() };
        let meaning = property["description"].as_str().unwrap_or_default();
        writeln!(text, "| `{key}` | {} | {default} | {meaning} |", kind(schema, property)).expect("a String takes all");
    }
    text + &shown(example)
}

#[test]
fn the_page_of_nodes_is_what_the_nodes_say() {
    let schema = scene::schema();
    let page = Node::examples().iter().fold(HEAD.to_owned(), |page, example| page + &section(&schema, example));
    let mut files = vec![(docs().join("nodes.md"), page.into_bytes())];
    for example in Node::examples() {
        files.push((docs().join(file(&example)), picture(&example.node)));
    }
    let write = std::env::var_os("SDFARM_WRITE_DOCS").is_some();
    for (path, want) in files {
        if write {
            std::fs::create_dir_all(path.parent().expect("a file is in a folder")).expect("docs can be written");
            std::fs::write(&path, &want).expect("docs can be written");
        }
        let got = std::fs::read(&path).unwrap_or_default();
        assert!(got == want, "{} is stale: SDFARM_WRITE_DOCS=1 cargo test -p worker --test docs", path.display());
    }
}
