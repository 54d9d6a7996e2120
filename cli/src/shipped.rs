//! The shipped job files, embedded in the binary.

use rust_embed::RustEmbed;

use crate::error::UsageError;

#[derive(RustEmbed)]
#[folder = "../scenes"]
#[include = "*.json"]
#[include = "paper/*.json"]
#[include = "hashes.txt"]
struct Scenes;

/// Names of the shipped scenes, sorted: `csg`, `paper/primitives`.
pub(crate) fn names() -> Vec<String> {
    let mut names: Vec<String> =
        Scenes::iter().filter_map(|file| file.strip_suffix(".json").map(str::to_owned)).collect();
    names.sort();
    names
}

/// Hash of a shipped scene's pixels at full size, with every layer.
pub(crate) fn hash(name: &str) -> Option<String> {
    let hashes = Scenes::get("hashes.txt")?;
    let hashes = std::str::from_utf8(&hashes.data).ok()?;
    let mut lines = hashes.lines().filter_map(|line| line.split_once(' '));
    lines.find(|(_, scene)| *scene == name).map(|(hash, _)| hash.to_owned())
}

/// Job file of a shipped scene.
pub(crate) fn job_file(name: &str) -> anyhow::Result<Vec<u8>> {
    match Scenes::get(&format!("{name}.json")) {
        Some(file) => Ok(file.data.into_owned()),
        None => Err(UsageError(format!("no scene {name:?} is shipped: there are {}", names().join(", "))).into()),
    }
}
