//! The job files that come with sdfarm, within the binary.

use rust_embed::RustEmbed;

use crate::failure::Misuse;

#[derive(RustEmbed)]
#[folder = "../scenes"]
#[include = "*.json"]
#[include = "paper/*.json"]
struct Scenes;

/// Names of the shipped scenes, sorted: `csg`, `paper/primitives`.
pub(crate) fn names() -> Vec<String> {
    let mut names: Vec<String> =
        Scenes::iter().filter_map(|file| file.strip_suffix(".json").map(str::to_owned)).collect();
    names.sort();
    names
}

/// The job file of one.
pub(crate) fn job_file(name: &str) -> anyhow::Result<Vec<u8>> {
    match Scenes::get(&format!("{name}.json")) {
        Some(file) => Ok(file.data.into_owned()),
        None => Err(Misuse(format!("no scene {name:?} is shipped: there are {}", names().join(", "))).into()),
    }
}
