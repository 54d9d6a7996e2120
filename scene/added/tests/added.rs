//! Tests of an added kind: each family gets one more kind, which takes a file of its own and a line in the
//! family's list, and passes the family's contract tests.

use std::fs;
use std::path::{Path, PathBuf};

#[path = "../../tests/scene/contract.rs"]
mod contract;
#[path = "../../tests/scene/kinds.rs"]
mod kinds;
#[path = "../../tests/scene/materials.rs"]
mod materials;

// Some tests of the public interface also run here, and refer to the crate by this name.
use added as subject;

/// Each added kind, its file, and the file of its family's list.
const ADDED: [(&str, &str, &str); 7] = [
    ("AddedNode", "nodes/added.rs", "nodes.rs"),
    ("AddedProfile", "profiles/added.rs", "profiles.rs"),
    ("AddedMaterial", "materials/added.rs", "materials.rs"),
    ("AddedTexture", "materials/texture/added.rs", "materials/texture.rs"),
    ("AddedLight", "lights/added.rs", "lights.rs"),
    ("AddedBackground", "backgrounds/added.rs", "backgrounds.rs"),
    ("AddedProjection", "camera/projections/added.rs", "camera/projections.rs"),
];

/// The families, and the file of each one's list.
const FAMILIES: [(&str, &str); 7] = [
    ("Node", "nodes.rs"),
    ("Profile", "profiles.rs"),
    ("Material", "materials.rs"),
    ("Texture", "materials/texture.rs"),
    ("Light", "lights.rs"),
    ("Background", "backgrounds.rs"),
    ("Projection", "camera/projections.rs"),
];

/// Whether the contract tests check a node of this kind here; the others are checked in `scene/tests`.
pub(crate) fn is_tested(kind: &str) -> bool {
    kind.starts_with("Added")
}

/// All sources of another crate, or of this one, with their text.
fn sources(crate_name: &str) -> Vec<(PathBuf, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(crate_name).join("src");
    let (mut found, mut folders) = (Vec::new(), vec![folder.clone()]);
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).expect("sources can be listed") {
            let path = entry.expect("sources can be listed").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).expect("a source is text");
                found.push((path.strip_prefix(&folder).expect("it is in the folder").to_owned(), text));
            }
        }
    }
    found
}

#[test]
fn an_added_kind_touches_its_own_file_and_the_list() {
    let sources = sources("scene/picture");
    for (kind, own, list) in ADDED {
        let named = sources.iter().filter(|(_, text)| text.contains(kind));
        let mut files: Vec<String> = named.map(|(path, _)| path.to_string_lossy().replace('\\', "/")).collect();
        files.sort();
        let mut expected = [own, list];
        expected.sort_unstable();
        assert_eq!(files, expected, "{kind}");
    }
}

/// Whether the text names a variant of the enum: the name, two colons, and a word that begins with a capital letter.
fn names_a_variant(text: &str, family: &str) -> bool {
    let path = format!("{family}::");
    text.match_indices(&path).any(|(index, _)| {
        let is_whole = !text[..index].ends_with(|letter: char| letter.is_alphanumeric() || letter == '_');
        let mut behind = text[index + path.len()..].chars();
        let is_word = behind.next().is_some_and(char::is_uppercase) && behind.next().is_some_and(char::is_lowercase);
        is_whole && is_word
    })
}

#[test]
fn only_the_file_of_the_list_branches_on_kinds() {
    for crate_name in [
        "scene",
        "scene/language",
        "scene/math",
        "scene/picture",
        "scene/trace",
        "proto",
        "server",
        "worker",
        "worker/helper",
        "cli",
        "tests/lab",
    ] {
        for (path, text) in sources(crate_name) {
            for (family, list) in FAMILIES {
                let is_list = crate_name == "scene/picture" && path == Path::new(list);
                assert!(is_list || !names_a_variant(&text, family), "{}: names a {family}", path.display());
            }
        }
    }
}

#[test]
fn an_alias_of_an_added_kind_suggests_it() {
    let text = r#"{ "scene": { "objects": [{ "shape": { "extra_node": { "depth": 1 } } }] } }"#;
    let error = added::parse(text.as_bytes()).expect_err("no kind has this name").to_string();
    assert!(error.contains("there is no `extra_node`: did you mean `added_node`?"), "{error}");
}

#[test]
fn a_job_may_have_one_of_each_added_kind() {
    let text = r#"{ "scene": {
        "camera": { "position": [0, 0, 4], "look_at": [0, 0, 0], "projection": { "added": { "shift": 0.1 } } },
        "background": { "added": { "color": [1, 0, 0] } },
        "lights": [{ "added": { "direction": [0, 0, 1], "color": [1, 1, 1] } }],
        "objects": [
            { "shape": { "intersection": { "of": [{ "added_node": { "depth": 1 } }, { "sphere": { "radius": 1 } }] } },
              "material": { "added_material": { "color": [0, 1, 0] } } },
            { "shape": { "extrude": { "profile": { "added_profile": { "height": 0.2 } }, "height": 0.2 } },
              "material": { "flat": { "color": { "added": { "period": 1, "color": [1, 1, 1] } } } } }
        ] }, "image": { "width": 16, "height": 16 } }"#;
    let job = added::parse(text.as_bytes()).expect("every kind parses");
    assert_eq!(added::warnings(&job), [""; 0]);
    let at_frame = job.at(0).expect("the job is valid");
    let seen = added::Integrator::new(&at_frame).pixel(8.0_f32, 8.0);
    assert!(seen.color.y > 0.1 && seen.color.x == 0.0, "{seen:?}");
}
