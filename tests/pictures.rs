//! Compares pictures with an independent tracer in double precision, written in Python: `tracer.py`.

use std::fs;
use std::process::Command;

use serde_json::Value;

use crate::skip::skip;
use crate::support::{root, succeed, text};

/// Job of a shipped scene as a small EXR with depth and normals, one sample per pixel.
fn small(name: &str) -> Value {
    let path = root().join("scenes").join(format!("{name}.json"));
    let mut job: Value = serde_json::from_slice(&fs::read(path).expect("a scene")).expect("JSON");
    job["image"] = serde_json::json!({ "width": 160, "height": 90, "samples": 1, "format": "exr",
        "precision": "float", "layers": ["depth", "normal"] });
    job
}

/// Runs the tracer on a job's picture; `None` if Python lacks a package.
fn traced(job: &Value) -> Option<Value> {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, picture) = (folder.path().join("job.json"), folder.path().join("picture.exr"));
    fs::write(&file, job.to_string()).expect("written");
    succeed(&["render", &file.to_string_lossy(), "--device", "cpu", "-o", &picture.to_string_lossy()]);
    let mut python = Command::new("python3");
    python.env("PYTHONPATH", root().join(".whl")).arg(root().join("tests/tracer.py")).args([&file, &picture]);
    let output = python.output().ok()?;
    if text(&output.stderr).contains("ModuleNotFoundError") {
        return None;
    }
    assert!(output.status.success(), "the tracer failed: {}", text(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).expect("the tracer's answer"))
}

#[test]
fn depth_and_normals_agree_with_an_independent_tracer() {
    assert_traced(&[("csg", 0.999, Some(0.995)), ("five-spheres", 0.999, Some(0.999))]);
}

#[test]
fn depth_of_a_fractal_agrees_with_an_independent_tracer() {
    // It has no exact normal: its own is the mean over a pixel.
    assert_traced(&[("mandelbulb", 0.99, None)]);
}

/// Traces shipped scenes, and compares the shares of their pixels whose depth and normal are exact with the least ones
/// that are expected.
fn assert_traced(scenes: &[(&str, f64, Option<f64>)]) {
    for &(name, depth, normals) in scenes {
        let Some(answer) = traced(&small(name)) else {
            skip("openexr", format_args!("no Python with numpy and OpenEXR to trace {name}"));
            continue;
        };
        let share = |key: &str| answer[key].as_f64().expect("a share");
        assert!(share("exact_depth") >= depth, "{name}: {answer}");
        assert!(normals.is_none_or(|normals| share("exact_normals") >= normals), "{name}: {answer}");
        assert!(share("hits") > 1000.0, "{name}: {answer}");
    }
}
