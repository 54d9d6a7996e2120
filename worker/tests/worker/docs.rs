//! docs/nodes.md, docs/materials.md, docs/gallery.md and their pictures, made from the code and the shipped
//! scenes. A stale page fails here;
//! `SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs` writes it anew.

mod gallery;
mod materials;
mod nodes;
mod picture;
mod schema;

use std::path::Path;

use scene::Job;

/// The text of a page and the pictures on it.
struct Page {
    /// The page's place under docs/.
    name: &'static str,
    text: String,
    pictures: Vec<Picture>,
}

/// A picture to render.
struct Picture {
    /// Its place under docs/.
    file: String,
    /// What it is rendered of.
    job: Job,
}

/// Writes the page's files where that is asked for; fails on one that is not as it should be.
fn assert_fresh(page: Page) {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let write = std::env::var_os("SDFARM_WRITE_DOCS").is_some();
    let text = std::iter::once((page.name.to_owned(), page.text.into_bytes()));
    let pictures = page.pictures.into_iter().map(|picture| (picture.file, picture::render(&picture.job)));
    for (name, want) in text.chain(pictures) {
        let path = docs.join(name);
        if write {
            std::fs::create_dir_all(path.parent().expect("a file is in a folder")).expect("docs can be written");
            std::fs::write(&path, &want).expect("docs can be written");
        }
        let got = std::fs::read(&path).unwrap_or_default();
        assert!(
            got == want,
            "{} is stale: SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs",
            path.display()
        );
    }
}

/// Where a picture lies, by the name of what it shows and its place among the examples of it.
fn file(folder: &str, name: &str, number: usize) -> String {
    match number {
        0 => format!("pictures/{folder}/{name}.png"),
        number => format!("pictures/{folder}/{name}-{}.png", number + 1),
    }
}

/// A picture above its JSON.
fn shown(name: &str, file: &str, json: &str) -> String {
    let value: serde_json::Value = serde_json::from_str(json).expect("an example is JSON");
    format!("\n![{name}]({file})\n\n```json\n{value}\n```\n")
}

#[test]
fn the_page_of_nodes_is_what_the_nodes_say() {
    assert_fresh(nodes::page());
}

#[test]
fn the_page_of_materials_is_what_materials_and_textures_say() {
    assert_fresh(materials::page());
}

#[test]
fn the_gallery_is_what_the_shipped_scenes_look_like() {
    assert_fresh(gallery::page());
}
