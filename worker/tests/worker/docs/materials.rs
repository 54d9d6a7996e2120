//! Generates the page of materials and textures.

use scene::materials::{Example, Material, Texture};
use serde_json::Value;

use super::picture::on_a_floor;
use super::schema::{kind_section, part};
use super::{Page, Picture, file};

const HEAD: &str = "# Materials

How surfaces answer light. Each is keyed by its name; each picture shows the JSON below it on a ball and a box.
A color is `[red, green, blue]` in linear light, `\"#rrggbb\"` in sRGB, or a [texture](#textures). A number of a
material may be varied by one: `{\"low\": 0.1, \"high\": 0.6, \"by\": TEXTURE}`. This page is made from the code:
`SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs`.
";

const TEXTURES: &str = "
# Textures

What gives a color at every place, in the space of the `paint` that says the material, else in the scene's. The
colors in a texture may be textures again, four deep.
";

const PARTS: &str = "
# What they are made of
";

/// A ball and a box of a material, side by side.
fn ball_and_box(material: &str) -> String {
    format!(
        r#"{{ "material": {material}, "shape": {{ "union": {{ "of": [
             {{ "translate": {{ "by": [-0.85, -0.45, 0.05], "child": {{ "sphere": {{ "radius": 0.78 }} }} }} }},
             {{ "translate": {{ "by": [0.75, -0.63, -0.42],
                "child": {{ "box": {{ "size": [1.2, 1.2, 1.2], "round": 0.06 }} }} }} }} ] }} }} }}"#
    )
}

/// Adds sections with pictures of some examples, each converted to a material by `material`.
fn add(page: &mut Page, schema: &Value, folder: &str, examples: &[Example], material: impl Fn(&str) -> String) {
    for example in examples {
        let file = file(folder, &example.name, example.index);
        page.text += &kind_section(schema, "", example, &file);
        page.pictures.push(Picture::of_first_frame(file, on_a_floor(&ball_and_box(&material(&example.json)))));
    }
}

pub(crate) fn page() -> Page {
    let schema = scene::schema();
    let mut page = Page { name: "materials.md", text: HEAD.to_owned(), pictures: Vec::new() };
    add(&mut page, &schema, "materials", &Material::examples(), str::to_owned);
    page.text += TEXTURES;
    add(&mut page, &schema, "textures", &Texture::examples(), |texture| {
        format!(r#"{{ "diffuse": {{ "kd": {texture}, "ambient": [0.16, 0.17, 0.2] }} }}"#)
    });
    page.text += PARTS;
    for name in ["Ramp", "GradientBy", "Axes", "Noise"] {
        page.text += &part(&schema, name);
    }
    page
}
