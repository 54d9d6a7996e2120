//! The pages of nodes, materials, lights, camera and sky, and shipped scenes with their pictures, made from the code
//! and the scenes. A stale page fails here;
//! `SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs` writes it anew.

mod camera_and_sky;
mod gallery;
mod lights;
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

/// What is compared of a page's pictures.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Compared {
    /// What they say that they were made of.
    Provenance,
    /// Every byte.
    Bytes,
}

/// Writes the page's files where that is asked for; fails on one that is not as it should be.
fn assert_fresh(page: &Page, compared: Compared) {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    if std::env::var_os("SDFARM_WRITE_DOCS").is_some() {
        write(page, &docs);
    }
    let read = |name: &str| std::fs::read(docs.join(name)).unwrap_or_default();
    let mut stale = Vec::new();
    if read(page.name) != page.text.as_bytes() {
        stale.push(page.name);
    }
    for Picture { file, job } in &page.pictures {
        let got = read(file);
        let is_fresh = match compared {
            Compared::Provenance => picture::says_it_shows(&got, job),
            Compared::Bytes => got == picture::render(job),
        };
        if !is_fresh {
            stale.push(file);
        }
    }
    assert!(stale.is_empty(), "{stale:?} are stale: SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs");
}

/// Writes a page and its pictures.
fn write(page: &Page, docs: &Path) {
    let text = std::iter::once((page.name, page.text.clone().into_bytes()));
    let pictures = page.pictures.iter().map(|picture| (picture.file.as_str(), picture::render(&picture.job)));
    for (name, bytes) in text.chain(pictures) {
        let path = docs.join(name);
        std::fs::create_dir_all(path.parent().expect("a file is in a folder")).expect("docs can be written");
        std::fs::write(&path, bytes).expect("docs can be written");
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
    assert_fresh(&nodes::page(), Compared::Provenance);
}

#[test]
fn the_page_of_materials_is_what_materials_and_textures_say() {
    assert_fresh(&materials::page(), Compared::Provenance);
}

#[test]
fn the_page_of_lights_is_what_the_lights_say() {
    assert_fresh(&lights::page(), Compared::Provenance);
}

#[test]
fn the_page_of_camera_and_sky_is_what_projections_backgrounds_and_effects_say() {
    assert_fresh(&camera_and_sky::page(), Compared::Provenance);
}

#[test]
fn the_gallery_is_what_the_shipped_scenes_look_like() {
    assert_fresh(&gallery::page(), Compared::Provenance);
}

#[test]
#[ignore = "long: every picture of the generated pages, rendered again; a minute"]
fn pictures_of_the_pages_have_the_bytes_that_they_render_to() {
    assert_fresh(&nodes::page(), Compared::Bytes);
    assert_fresh(&materials::page(), Compared::Bytes);
    assert_fresh(&lights::page(), Compared::Bytes);
    assert_fresh(&camera_and_sky::page(), Compared::Bytes);
}

#[test]
#[ignore = "long: every picture of the gallery, rendered anew; a minute"]
fn pictures_of_the_gallery_have_the_bytes_that_they_render_to() {
    assert_fresh(&gallery::page(), Compared::Bytes);
}
