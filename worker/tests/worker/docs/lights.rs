//! Generates the page of lights.

use scene::lights::Light;

use super::picture::stage;
use super::schema::kind_section;
use super::{Page, Picture, file};

const HEAD: &str = "# Lights

Where light comes from. Each is keyed by its name in the list `lights` of a scene; each picture shows a scene with the
light below it and no other. Area lights are sampled: soft shadows need 64 `image.samples` or more to be free of
noise. This page is made from the code:
`SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs`.
";

/// Objects in the light: a ball, a column and a thin pole on a floor in front of a wall.
const OBJECTS: &str = r#"
    { "shape": { "translate": { "by": [-0.55, -0.62, 0.5], "child": { "sphere": { "radius": 0.63 } } } }, "material": "gray" },
    { "shape": { "translate": { "by": [0.75, -0.35, -0.35],
        "child": { "rotate": { "degrees": [0, 28, 0], "child": { "box": { "size": [0.7, 1.8, 0.7], "round": 0.03 } } } } } },
      "material": "gray" },
    { "shape": { "capsule": { "a": [1.45, -1.25, 0.75], "b": [1.45, -0.1, 0.75], "radius": 0.05 } }, "material": "gray" },
    { "shape": { "plane": { "normal": [0, 1, 0], "offset": -1.25 } }, "material": "gray" },
    { "shape": { "plane": { "normal": [0, 0, 1], "offset": -2.2 } }, "material": "gray" }"#;

pub(crate) fn page() -> Page {
    let schema = scene::schema();
    let mut page = Page { name: "lights.md", text: HEAD.to_owned(), pictures: Vec::new() };
    for example in Light::examples() {
        let file = file("lights", &example.name, example.index);
        page.text += &kind_section(&schema, "Light", &example, &file);
        let job = stage(
            &format!(
                r#""camera": {{ "position": [2.2, 1.5, 4.6], "look_at": [0.05, -0.45, 0], "fov": 38 }},
            "background": {{ "day": {{ "sun": [-0.55, 0.5, 0.6] }} }}, "lights": [{}],
            "materials": {{ "gray": {{ "diffuse": {{ "kd": [0.72, 0.72, 0.72], "ambient": [0.012, 0.013, 0.016] }} }} }},
            "objects": [{OBJECTS}]"#,
                example.json
            ),
            [240, 180],
        );
        page.pictures.push(Picture::of_first_frame(file, job));
    }
    page
}
