//! Checks that the generated pages and pictures (nodes, materials, lights, camera and sky, and the gallery)
//! match the code and the scenes. If a page is stale, `SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker
//! docs` rewrites it.
//!
//! A line of hashes is the exact picture; its file is small, and is replaced only if it looks different.

mod camera_and_sky;
mod flip;
mod gallery;
mod hashes;
mod hover;
mod light;
mod lights;
mod materials;
mod nodes;
mod picture;
mod schema;
mod small;

use std::collections::BTreeSet;
use std::path::Path;

use hashes::Exact;
use scene::Job;

/// Text of a page, with its pictures.
struct Page {
    /// Path of the page in docs/.
    name: &'static str,
    text: String,
    pictures: Vec<Picture>,
}

/// Picture to render.
struct Picture {
    /// Path of the picture in docs/.
    file: String,
    /// Job that it shows.
    job: Job,
    /// Frame of the job.
    frame: u32,
}

impl Picture {
    fn of_first_frame(file: String, job: Job) -> Self {
        Self { file, job, frame: 0 }
    }
}

/// How a page's pictures are compared.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Compared {
    /// By what they show.
    Provenance,
    /// By every pixel.
    Pixels,
}

/// Writes the page's files if requested; otherwise fails if one is stale.
fn assert_fresh(page: &Page, compared: Compared) {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    if std::env::var_os("SDFARM_WRITE_DOCS").is_some() {
        write(page, &docs);
    }
    let read = |name: &str| std::fs::read(docs.join(name)).unwrap_or_default();
    let hashes = hashes::read();
    let mut stale = Vec::new();
    if read(page.name) != page.text.as_bytes() {
        stale.push(page.name);
    }
    for Picture { file, job, frame } in &page.pictures {
        let bytes = read(file);
        let is_fresh = hashes.get(file).is_some_and(|exact| {
            exact.shown == picture::shown_hash(job, *frame)
                && exact.file == picture::hash(&bytes)
                && (compared == Compared::Provenance
                    || exact.pixels == picture::pixels_hash(&picture::pixels(job, *frame)))
        });
        if !is_fresh
            || bytes.len() > small::MAX_BYTES
            || small::size(&bytes) != Some([job.image.width, job.image.height])
        {
            stale.push(file);
        }
    }
    assert!(stale.is_empty(), "{stale:?} are stale: SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs");
}

/// Writes a page, the hashes of its pictures, and its pictures that look different.
fn write(page: &Page, docs: &Path) {
    let write = |name: &str, bytes: &[u8]| {
        let path = docs.join(name);
        std::fs::create_dir_all(path.parent().expect("a file is in a folder")).expect("docs can be written");
        std::fs::write(&path, bytes).expect("docs can be written");
    };
    write(page.name, page.text.as_bytes());
    for Picture { file, job, frame } in &page.pictures {
        let pixels = picture::pixels(job, *frame);
        let mut bytes = std::fs::read(docs.join(file)).unwrap_or_default();
        if small::looks_different(&bytes, &pixels) {
            bytes = small::encode(&pixels);
            write(file, &bytes);
        }
        let shown = picture::shown_hash(job, *frame);
        let exact = Exact { pixels: picture::pixels_hash(&pixels), shown, file: picture::hash(&bytes) };
        hashes::change(|hashes| drop(hashes.insert(file.clone(), exact)));
    }
}

/// All generated pages.
fn all_pages() -> [Page; 7] {
    [
        nodes::page(),
        materials::page(),
        lights::page(),
        light::page(),
        camera_and_sky::page(),
        gallery::page(),
        hover::page(),
    ]
}

/// Path of a picture, by the name of its subject and its index among the examples.
fn file(folder: &str, name: &str, number: usize) -> String {
    match number {
        0 => format!("pictures/{folder}/{name}.webp"),
        number => format!("pictures/{folder}/{name}-{}.webp", number + 1),
    }
}

/// Markdown of a picture, with its JSON below.
fn shown(name: &str, file: &str, json: &str) -> String {
    let value: serde_json::Value = serde_json::from_str(json).expect("an example is JSON");
    format!("\n![{name}]({file})\n\n```json\n{value}\n```\n")
}

#[test]
fn the_page_of_nodes_is_current() {
    assert_fresh(&nodes::page(), Compared::Provenance);
}

#[test]
fn the_page_of_materials_is_current() {
    assert_fresh(&materials::page(), Compared::Provenance);
}

#[test]
fn the_page_of_lights_is_current() {
    assert_fresh(&lights::page(), Compared::Provenance);
}

#[test]
fn the_page_of_light_is_current() {
    assert_fresh(&light::page(), Compared::Provenance);
}

#[test]
fn the_page_of_camera_and_sky_is_current() {
    assert_fresh(&camera_and_sky::page(), Compared::Provenance);
}

#[test]
fn the_gallery_is_current() {
    assert_fresh(&gallery::page(), Compared::Provenance);
}

#[test]
fn every_line_of_hashes_is_of_a_documented_picture() {
    let pictured: Vec<String> =
        all_pages().into_iter().flat_map(|page| page.pictures).map(|shown| shown.file).collect();
    let files: BTreeSet<&String> = pictured.iter().collect();
    assert_eq!(files.len(), pictured.len(), "two pictures have one file");
    let hashes = hashes::read();
    if std::env::var_os("SDFARM_WRITE_DOCS").is_some() {
        hashes::change(|hashes| hashes.retain(|file, _| files.contains(file)));
    } else {
        assert!(hashes.keys().eq(files), "docs/pictures/hashes.txt has lines of no picture");
    }
}

#[test]
fn the_small_pictures_are_current_and_small() {
    /// Maximum size of one, and of all together.
    const MAX_BYTES: [u64; 2] = [20 << 10, 3 << 20];
    let page = hover::page();
    assert_fresh(&page, Compared::Provenance);
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let bytes = |file: &str| std::fs::metadata(docs.join(file)).expect("it is there").len();
    let sizes: Vec<u64> = page.pictures.iter().map(|picture| bytes(&picture.file)).collect();
    let sum: u64 = sizes.iter().sum();
    assert!(sizes.iter().all(|&size| size <= MAX_BYTES[0]) && sum <= MAX_BYTES[1], "{sum} bytes: {sizes:?}");
    let folder = std::fs::read_dir(docs.join("../web/pictures")).expect("the folder is there");
    assert_eq!(folder.count(), page.pictures.len() + 1, "a picture is of no kind");
}

#[test]
#[ignore = "long: renders every picture of the generated pages; 5 minutes"]
fn page_pictures_match_a_new_render() {
    assert_fresh(&nodes::page(), Compared::Pixels);
    assert_fresh(&materials::page(), Compared::Pixels);
    assert_fresh(&lights::page(), Compared::Pixels);
    assert_fresh(&camera_and_sky::page(), Compared::Pixels);
    assert_fresh(&hover::page(), Compared::Pixels);
}

#[test]
#[ignore = "long: renders every picture of the gallery; 8 minutes"]
fn gallery_pictures_match_a_new_render() {
    assert_fresh(&gallery::page(), Compared::Pixels);
}
