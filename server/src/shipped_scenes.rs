//! The shipped job files, embedded in the program.

use proto::shipped_scenes::{SceneList, SceneView};
use rust_embed::RustEmbed;

#[derive(RustEmbed)]
#[folder = "../scenes"]
#[include = "*.json"]
#[include = "paper/*.json"]
#[include = "hashes.txt"]
struct Scenes;

/// Names of the shipped scenes, sorted: `csg`, `paper/primitives`.
pub fn names() -> Vec<String> {
    let mut names: Vec<String> =
        Scenes::iter().filter_map(|file| file.strip_suffix(".json").map(str::to_owned)).collect();
    names.sort();
    names
}

/// Job file of a shipped scene.
pub fn job_file(name: &str) -> Option<Vec<u8>> {
    Scenes::get(&format!("{name}.json")).map(|file| file.data.into_owned())
}

/// Hash of a shipped scene's pixels at full size, with every layer.
pub fn hash(name: &str) -> Option<String> {
    let hashes = Scenes::get("hashes.txt")?;
    let hashes = std::str::from_utf8(&hashes.data).ok()?;
    let mut lines = hashes.lines().filter_map(|line| line.split_once(' '));
    lines.find(|(_, scene)| *scene == name).map(|(hash, _)| hash.to_owned())
}

/// The shipped scenes, as clients list them.
pub(crate) fn list() -> SceneList {
    let view = |name: String| SceneView {
        title: title(&name),
        bytes: Scenes::get(&format!("{name}.json")).map_or(0, |file| file.data.len() as u64),
        address: format!("/v1/scenes/{}", name.replace('/', "%2F")),
        name,
    };
    SceneList { scenes: names().into_iter().map(view).collect() }
}

/// A scene's name as people write it: `paper/five-spheres` is "Five spheres (paper)".
fn title(name: &str) -> String {
    let (folder, file) = name.rsplit_once('/').map_or((None, name), |(folder, file)| (Some(folder), file));
    let words = if file == "csg" { "CSG".to_owned() } else { file.replace('-', " ") };
    let first = words.chars().next().map(|first| first.to_ascii_uppercase());
    let title: String = first.into_iter().chain(words.chars().skip(1)).collect();
    folder.map_or(title.clone(), |folder| format!("{title} ({folder})"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scene_is_listed_with_a_title_and_is_a_valid_job() {
        let list = list();
        assert!(list.scenes.len() > 30);
        for scene in &list.scenes {
            let file = job_file(&scene.name).expect("a job file");
            assert_eq!(scene.bytes, file.len() as u64);
            assert!(scene.title.starts_with(char::is_uppercase) && !scene.title.contains(['/', '-']), "{scene:?}");
            assert!(scene::parse(&file).is_ok(), "{}", scene.name);
        }
        let title = |name: &str| &list.scenes.iter().find(|scene| scene.name == name).expect("shipped").title;
        assert_eq!([title("csg"), title("five-spheres"), title("paper/csg")], ["CSG", "Five spheres", "CSG (paper)"]);
        assert_eq!(job_file("no-such-scene"), None);
        assert!(hash("csg").is_some());
    }
}
