//! Tests the commands that work on job files without rendering them: `new`, `fmt` and `diff`.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Output;

use serde_json::{Value, json};

use crate::jobs;
use crate::support::{finish, root, sdfarm, text};

fn run_in(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = sdfarm(arguments);
    command.current_dir(folder);
    finish(command, b"")
}

/// Runs a command that must succeed; returns its standard output and its standard error.
fn done(folder: &Path, arguments: &[&str]) -> (String, String) {
    let output = run_in(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    (text(&output.stdout), text(&output.stderr))
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder")
}

/// All job files of the repository.
fn files() -> Vec<PathBuf> {
    let mut found = Vec::new();
    for folder in ["scenes", "scenes/paper", "docs/scenes", "docs/scenes/light"] {
        let entries = fs::read_dir(root().join(folder)).expect("readable").flatten();
        let paths = entries.map(|entry| entry.path());
        found.extend(paths.filter(|path| path.extension().is_some_and(|extension| extension == "json")));
    }
    assert!(found.len() > 40, "{found:?}");
    found
}

#[test]
fn new_writes_a_job_that_is_valid_formatted_and_renders() {
    let folder = folder();
    let (said, remarks) = done(folder.path(), &["new"]);
    assert_eq!(said, "wrote scene.json\n");
    assert!(
        remarks.contains("`sdfarm check scene.json`") && remarks.contains("`sdfarm render scene.json -o scene.png`")
    );
    done(folder.path(), &["fmt", "--check", "scene.json"]);
    let (said, remarks) = done(folder.path(), &["check", "scene.json"]);
    assert!(said.contains("scene.json: valid") && !remarks.contains("warning"), "{said}{remarks}");
    done(folder.path(), &["render", "scene.json", "-o", "scene.png", "--scale", "5%", "--set", "numbers.bead=0.17"]);

    fs::write(folder.path().join("scene.json"), "mine").expect("written");
    for (arguments, says) in
        [(&["new"][..], "scene.json exists, and was not replaced"), (&["new", "absent/a.json"], "create its folder")]
    {
        let refused = run_in(folder.path(), arguments);
        assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
        assert!(text(&refused.stderr).contains(says), "{}", text(&refused.stderr));
    }
    assert_eq!(fs::read_to_string(folder.path().join("scene.json")).expect("there"), "mine");
    done(folder.path(), &["new", "other.json"]);
}

#[test]
fn formatting_a_shipped_job_changes_neither_its_values_nor_its_pictures() {
    let folder = folder();
    for file in files() {
        let name = file.to_str().expect("a plain name");
        let before = fs::read_to_string(&file).expect("readable");
        fs::write(folder.path().join("job.json"), &before).expect("written");
        done(folder.path(), &["fmt", "job.json"]);
        let after = fs::read_to_string(folder.path().join("job.json")).expect("readable");
        let value = |text: &str| serde_json::from_str::<Value>(&scene::plain_json(text)).expect(name);
        assert_eq!(value(&before), value(&after), "{name}");
        assert_eq!(before.matches("//").count(), after.matches("//").count(), "{name}");
        let (said, _) = done(folder.path(), &["fmt", "--check", "job.json"]);
        assert_eq!(said, "", "{name}");
    }
    let name = root().join("docs/scenes/robot.json");
    fs::copy(&name, folder.path().join("job.json")).expect("copied");
    done(folder.path(), &["fmt", "job.json"]);
    let (said, _) = done(folder.path(), &["diff", name.to_str().expect("plain"), "job.json"]);
    assert_eq!(said, "the pictures are the same\n");
}

#[test]
fn fmt_keeps_comments_and_permissions_and_names_what_would_change() {
    let folder = folder();
    let path = folder.path().join("a.json");
    let untidy = "{ // first\n\"image\": {\"width\":8,\n\n\"height\":8.0, /* low */},}\n";
    let tidy = "{ // first\n  \"image\": { \"width\": 8, \"height\": 8.0 /* low */ }\n}\n";
    fs::write(&path, untidy).expect("written");
    fs::write(folder.path().join("b.json"), tidy).expect("written");
    fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).expect("set");

    let checked = run_in(folder.path(), &["fmt", "--check", "a.json", "b.json"]);
    assert_eq!((checked.status.code(), text(&checked.stdout).as_str()), (Some(1), "a.json\n"));
    assert!(text(&checked.stderr).contains("1 file would change: `sdfarm fmt a.json`"), "{}", text(&checked.stderr));
    assert_eq!(fs::read_to_string(&path).expect("there"), untidy);

    let (said, remarks) = done(folder.path(), &["fmt", "a.json", "b.json"]);
    assert_eq!((said.as_str(), remarks.as_str()), ("", "formatted a.json\n"));
    assert_eq!(fs::read_to_string(&path).expect("there"), tidy);
    assert_eq!(fs::metadata(&path).expect("there").permissions().mode() & 0o777, 0o640);
    let piped = finish(sdfarm(&["fmt", "-"]), untidy.as_bytes());
    assert!(piped.status.success() && text(&piped.stdout) == tidy, "{}", text(&piped.stderr));
}

#[test]
fn fmt_leaves_a_file_that_is_not_json_and_formats_the_others() {
    let folder = folder();
    let brackets = "[".repeat(200_000);
    for (name, content) in [("a.json", "{\n\"a\" 1}"), ("b.json", "[1 ]"), ("deep.json", brackets.as_str())] {
        fs::write(folder.path().join(name), content).expect("written");
    }
    let output = run_in(folder.path(), &["fmt", "a.json", "deep.json", "b.json", "absent.json"]);
    let printed = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{printed}");
    for says in ["a.json:2:5: ", "it was not changed", "deep.json:1:258: ", "nests deeper", "absent.json"] {
        assert!(printed.contains(says), "{printed}");
    }
    assert_eq!(fs::read_to_string(folder.path().join("a.json")).expect("there"), "{\n\"a\" 1}");
    assert_eq!(fs::read_to_string(folder.path().join("b.json")).expect("there"), "[\n  1\n]\n");
    let names = fs::read_dir(folder.path()).expect("readable").count();
    assert_eq!(names, 3, "no other file is left");
}

#[test]
fn diff_says_what_differs_and_whether_the_pictures_do() {
    let folder = folder();
    let write = |name: &str, content: &str| fs::write(folder.path().join(name), content).expect("written");
    let mut job = jobs::quick();
    write("a.json", &job.to_string());
    write("same.json", &format!("// The same.\n{job:#}"));
    job["name"] = json!("another");
    write("named.json", &job.to_string());
    job["scene"]["camera"]["position"][1] = json!(1.5);
    job["scene"]["objects"]
        .as_array_mut()
        .expect("objects")
        .insert(0, json!({ "shape": { "box": { "size": [1, 1, 1] } } }));
    write("b.json", &job.to_string());

    let (said, _) = done(folder.path(), &["diff", "a.json", "same.json"]);
    assert_eq!(said, "the picture is the same\n");
    let named = run_in(folder.path(), &["diff", "a.json", "named.json"]);
    let said = text(&named.stdout);
    assert_eq!(named.status.code(), Some(1), "{}", text(&named.stderr));
    assert!(said.starts_with("name: ") && said.ends_with(" became \"another\"\nthe picture is the same\n"), "{said}");
    assert!(named.stderr.is_empty(), "{}", text(&named.stderr));

    let different = run_in(folder.path(), &["diff", "a.json", "b.json"]);
    let said = text(&different.stdout);
    assert_eq!((different.status.code(), said.lines().count()), (Some(1), 4), "{said}");
    assert!(said.contains("scene.camera.position[1]: ") && said.contains(" became 1.5\n"), "{said}");
    assert!(said.contains("scene.objects[0]: added (box)\n") && said.ends_with("the picture differs\n"), "{said}");

    let different = run_in(folder.path(), &["diff", "a.json", "b.json", "--json"]);
    let printed: Value = serde_json::from_slice(&different.stdout).expect("JSON");
    assert_eq!(printed["differences"].as_array().map(Vec::len), Some(3), "{printed}");
    assert_eq!(printed["pictures"]["different"], json!([0]));
    let wrong = run_in(folder.path(), &["diff", "a.json", "absent.json"]);
    assert_eq!(wrong.status.code(), Some(2), "{}", text(&wrong.stderr));
}

#[test]
fn diff_counts_the_frames_that_differ() {
    let folder = folder();
    let mut job = jobs::quick();
    job["frames"] = json!({ "count": 4, "fps": 1 });
    job["scene"]["camera"]["fov"] = json!({ "keys": [[0, 30], [2, 40]] });
    fs::write(folder.path().join("a.json"), job.to_string()).expect("written");
    job["scene"]["camera"]["fov"] = json!({ "keys": [[0, 30], [2, 40], [3, 50]] });
    fs::write(folder.path().join("b.json"), job.to_string()).expect("written");
    let said = text(&run_in(folder.path(), &["diff", "a.json", "b.json"]).stdout);
    assert!(
        said.contains("scene.camera.fov.keys[2]: added") && said.ends_with("1 of 4 pictures differ, frame 3 first\n"),
        "{said}"
    );
}
