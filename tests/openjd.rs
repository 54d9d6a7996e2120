//! Tests `sdfarm export openjd` with the reference programs of the Open Job Description: they check its templates, and run
//! one.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::{Value, json};

use crate::jobs;
use crate::skip::skip;
use crate::support::{PROGRAM, clean, finish, rendered_here, root, run, sdfarm, succeed, text};

/// Runs `openjd`; `None` if it is not installed, which skips the test.
fn openjd(arguments: &[&str]) -> Option<Output> {
    let packages = root().join(".whl/openjd");
    if !packages.join("openjd").is_dir() || Command::new("python3").arg("--version").output().is_err() {
        skip(
            "openjd",
            "python3 or the package openjd-cli is not installed, so no exported template is checked by others",
        );
        return None;
    }
    let mut command = Command::new("python3");
    clean(&mut command).env("PYTHONPATH", packages).args(["-m", "openjd"]).args(arguments);
    Some(finish(command, b""))
}

/// Asserts that `openjd` accepts a template.
fn assert_valid(template: &Path) {
    let path = template.to_str().expect("a plain path");
    if let Some(checked) = openjd(&["check", path]) {
        assert!(checked.status.success(), "{}{}", text(&checked.stdout), text(&checked.stderr));
    }
}

/// A small animation, saved in a folder.
fn animation(folder: &Path) -> (Value, String) {
    let mut job = jobs::quick();
    job["name"] = json!("quick {{take}} 3");
    job["frames"] = json!({ "count": 3 });
    job["scene"]["camera"]["position"] = json!({ "keys": [[0, [0, 0, 5]], [1, [2, 1, 5]]] });
    let path = folder.join("job.json");
    std::fs::write(&path, job.to_string()).expect("written");
    (job, path.to_str().expect("a plain path").to_owned())
}

#[test]
fn exported_frames_have_the_bytes_of_a_render() {
    let folder = tempfile::tempdir().expect("a folder");
    let (job, path) = animation(folder.path());
    let template = folder.path().join("template.json");
    let template = template.to_str().expect("a plain path");
    succeed(&["export", "openjd", &path, "--output", template]);
    let pictures = folder.path().join("pictures");
    let program = format!("Program={PROGRAM}");
    let Some(ran) = openjd(&["run", template, "-p", "Frames=0-2:2", "-p", &program, "-p", "Device=cpu"]) else {
        return;
    };
    assert!(ran.status.success(), "{}{}", text(&ran.stdout), text(&ran.stderr));
    let mut names: Vec<_> = std::fs::read_dir(&pictures)
        .expect("the folder was created")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("plain"))
        .collect();
    names.sort();
    assert_eq!(names.len(), 2, "only the chosen frames: {names:?}");
    for (name, frame) in names.iter().zip([0, 2]) {
        assert!(name.ends_with(&format!(".{frame:04}.png")), "{name}");
        let saved = std::fs::read(pictures.join(name)).expect("saved");
        assert!(saved == rendered_here(&job, frame), "frame {frame} has other bytes");
    }
    assert!(rendered_here(&job, 0) != rendered_here(&job, 2), "the frames differ");
}

#[test]
fn templates_of_all_shipped_jobs_are_valid() {
    let folder = tempfile::tempdir().expect("a folder");
    for (index, (name, _)) in jobs::shipped().iter().enumerate() {
        // Every fourth is checked, because each check starts an interpreter.
        if index % 4 == 0 {
            let template = folder.path().join(format!("{index}.json"));
            let job = root().join(format!("scenes/{name}.json"));
            let device = if index % 8 == 0 { "cuda" } else { "auto" };
            let output = template.to_str().expect("a plain path");
            succeed(&["export", "openjd", job.to_str().expect("plain"), "-o", output, "--device", device]);
            assert_valid(&template);
        }
    }
}

#[test]
fn job_file_is_named_relative_to_the_template() {
    let folder = tempfile::tempdir().expect("a folder");
    let inner = folder.path().join("jobs");
    std::fs::create_dir(&inner).expect("a folder");
    let (_, path) = animation(&inner);
    let default = |template: &str| {
        let template: Value = serde_json::from_str(template).expect("JSON");
        template["parameterDefinitions"][0]["default"].clone()
    };
    let template = folder.path().join("template.json");
    succeed(&["export", "openjd", &path, "-o", template.to_str().expect("plain")]);
    assert_eq!(default(&std::fs::read_to_string(&template).expect("written")), "jobs/job.json");
    // Elsewhere, and from standard input, the file has no path that hosts could know.
    let elsewhere = tempfile::tempdir().expect("a folder");
    let template = elsewhere.path().join("template.json");
    let output = run(&["export", "openjd", &path, "-o", template.to_str().expect("plain")]);
    assert!(output.status.success() && text(&output.stderr).contains("JobFile"), "{}", text(&output.stderr));
    assert_eq!(default(&std::fs::read_to_string(&template).expect("written")), Value::Null);
    assert_valid(&template);
    let printed = finish(sdfarm(&["export", "openjd", "-"]), jobs::quick().to_string().as_bytes());
    assert!(printed.status.success(), "{}", text(&printed.stderr));
    assert_eq!(default(&text(&printed.stdout)), Value::Null);
}

#[test]
fn invalid_exports_are_usage_errors() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_, path) = animation(folder.path());
    for (arguments, word) in [
        (&["nowhere.json"][..], "nowhere.json"),
        (&[&path, "--device", "cuda:1"], "without a number"),
        (&[&path, "--device", "tpu"], "cuda"),
    ] {
        let output = run(&[&["export", "openjd"][..], arguments].concat());
        let printed = text(&output.stderr);
        assert!(output.status.code() == Some(2) && printed.contains(word), "{arguments:?}: {printed}");
    }
    let wrong = finish(sdfarm(&["export", "openjd", "-"]), b"{}");
    assert!(wrong.status.code() == Some(2) && wrong.stdout.is_empty(), "{}", text(&wrong.stderr));
}
