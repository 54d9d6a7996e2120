//! Generates the page of nodes.

use scene::bounds::Bounds;
use scene::nodes::{Exactness, Example, Node, snake_case};
use scene::real::vec3;
use serde_json::Value;

use super::picture::on_a_floor;
use super::schema::{description, table};
use super::{Page, Picture, file, shown};

const HEAD: &str = "# Nodes

Everything that has a distance. Each is keyed by its name; each picture shows the JSON below it, in gray
on a floor unless it says a material itself. What goes on all around the camera is shown within a ball.
This page is made from the code:
`SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs`.
";

/// The shape to draw; a shape that surrounds the camera is cut to a ball.
fn in_view(node: &str) -> String {
    let shape: Node = serde_json::from_str(node).expect("an example is a node");
    let mut above = (0..4_096).map(|place| {
        let step = |digit: u32| ((place >> digit) % 16) as f32;
        vec3(step(0) * 0.4 - 3.0, step(4) * 0.4 + 5.0, step(8) * 0.4 - 3.0)
    });
    if shape.bounds(0.0) == Bounds::INFINITE && above.any(|p| shape.distance(p) < 0.0) {
        format!(r#"{{ "intersection": {{ "of": [{{ "sphere": {{ "radius": 1.25 }} }}, {node}] }} }}"#)
    } else {
        node.to_owned()
    }
}

/// Exactness of the node's value, and its Lipschitz factor.
fn worth(example: &Example) -> String {
    let node: Node = serde_json::from_str(&example.json).expect("an example is a node");
    let worth = match node.exactness() {
        Exactness::Exact => "exact",
        Exactness::Bound => "a bound",
        Exactness::Estimate => "an estimate",
    };
    format!("Distance: {worth}; Lipschitz factor of the example: {:.3}.", node.lipschitz())
}

fn section(schema: &Value, example: &Example, file: &str) -> String {
    let name = snake_case(example.kind);
    let shown = shown(&name, file, &example.json);
    if example.index > 0 {
        return shown;
    }
    let (about, worth) = (description(schema, example.kind), worth(example));
    format!("\n## {name}\n\n{about}\n\n{worth}\n\n{}{shown}", table(schema, &schema["$defs"][example.kind]))
}

pub(crate) fn page() -> Page {
    let schema = scene::schema();
    let mut page = Page { name: "nodes.md", text: HEAD.to_owned(), pictures: Vec::new() };
    for example in Node::examples() {
        let file = file("nodes", &snake_case(example.kind), example.index);
        page.text += &section(&schema, &example, &file);
        let objects = format!(
            r#"{{ "shape": {}, "material": {{ "diffuse": {{ "kd": [0.62, 0.64, 0.68], "ks": [0.12, 0.12, 0.12], "shininess": 30 }} }} }}"#,
            in_view(&example.json)
        );
        page.pictures.push(Picture::of_first_frame(file, on_a_floor(&objects)));
    }
    page
}
