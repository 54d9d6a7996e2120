//! Tests the command line as users see it: output, files, and exit codes.

use std::fs;
use std::path::Path;
use std::process::{Output, Stdio};

use rustix::process::Signal;
use serde_json::{Value, json};

use crate::jobs;
use crate::support::{Farm, eventually, finish, run, sdfarm, send_signal, succeed, text, wait};

/// Creates a folder that contains `job.json`.
fn folder_with(job: &Value) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("job.json"), job.to_string()).expect("written");
    folder
}

fn run_in(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = sdfarm(arguments);
    command.current_dir(folder);
    finish(command, b"")
}

fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("readable").flatten();
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn assert_misuse(output: &Output, says: &str) {
    let printed = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{printed}");
    assert!(printed.contains("error: ") && printed.contains(says) && !printed.contains("panicked"), "{printed}");
}

#[test]
fn extension_decides_the_format_of_a_rendered_picture() {
    let folder = folder_with(&jobs::quick());
    for (name, magic) in [("a.png", b"\x89PNG".as_slice()), ("a.exr", &[0x76, 0x2f, 0x31, 0x01])] {
        let output = run_in(folder.path(), &["render", "job.json", "-o", name]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert!(fs::read(folder.path().join(name)).expect("written").starts_with(magic));
        assert!(output.stdout.is_empty() && text(&output.stderr).contains("rendered in"));
    }
    assert_eq!(names_in(folder.path()), ["a.exr", "a.png", "job.json"], "no other file is left");
    assert_misuse(&run_in(folder.path(), &["render", "job.json", "-o", "a.jpg"]), ".png or .exr");
    assert_misuse(&run_in(folder.path(), &["render", "job.json", "-o", "a.png", "--frame", "1"]), "no frame 1");
    assert_misuse(&run_in(folder.path(), &["render", "job.json", "-o", "absent/a.png"]), "create it first");
    assert_misuse(&run_in(folder.path(), &["render", "absent.json", "-o", "a.png"]), "absent.json");
    assert_misuse(&run_in(folder.path(), &["render", "job.json", "-o", "a.png", "--device", "gpu"]), "cuda:N");
}

#[test]
fn values_of_a_job_are_set_for_one_render() {
    let mut job = jobs::quick();
    job["scene"]["numbers"] = serde_json::json!({ "r": 0.5 });
    job["scene"]["objects"][0]["shape"] = serde_json::json!({ "sphere": { "radius": { "expr": "r" } } });
    let folder = folder_with(&job);
    let render = |name: &str, more: &[&str]| {
        let output = run_in(folder.path(), &[&["render", "job.json", "-o", name], more].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        (fs::read(folder.path().join(name)).expect("written"), text(&output.stderr))
    };
    let (plain, _) = render("a.png", &[]);
    let (set, _) = render("b.png", &["--set", "numbers.r=0.9", "--set", "name=another"]);
    assert_ne!(plain, set);
    job["scene"]["numbers"]["r"] = serde_json::json!(0.9);
    fs::write(folder.path().join("job.json"), job.to_string()).expect("written");
    // The provenance in the file is that of the scene with its values.
    assert_eq!(render("c.png", &[]).0, set);
    let (width, height) =
        (job["image"]["width"].as_f64().expect("a width"), job["image"]["height"].as_f64().expect("a height"));
    let (_, printed) = render("d.png", &["--scale", "50%", "--samples", "1"]);
    let size = format!("{}×{}, 1 sample", (width / 2.0).round(), (height / 2.0).round());
    assert!(printed.contains(&size), "{printed}");
    for (arguments, words) in [
        (["--set", "numbers.q=1"], "scene.numbers has no q, only r"),
        (["--set", "numbers.r"], "write PATH=VALUE"),
        (["--scale", "0"], "write a percentage"),
    ] {
        assert_misuse(
            &run_in(folder.path(), &[&["render", "job.json", "-o", "e.png"], arguments.as_slice()].concat()),
            words,
        );
    }
}

#[test]
fn what_a_quick_render_cannot_have_is_left_out_with_a_warning() {
    let mut job = jobs::as_exr(&jobs::quick());
    job["scene"]["integrator"] = json!({ "path": {} });
    for (key, value) in [("denoise", json!(true)), ("reweight_fireflies", json!(true)), ("samples", json!(16))] {
        job["image"][key] = value;
    }
    job["image"]["layers"].as_array_mut().expect("a list").push(json!("noisy"));
    let folder = folder_with(&job);
    let render = |flags: &[&str]| {
        let output = run_in(folder.path(), &[&["render", "job.json"], flags].concat());
        assert!(output.status.success(), "{flags:?}: {}", text(&output.stderr));
        text(&output.stderr)
    };
    let printed = render(&["-o", "a.png", "--samples", "1"]);
    for left_out in ["image.denoise is left out", "image.reweight_fireflies is left out", "the layers are left out"] {
        assert!(printed.contains(left_out), "{printed}");
    }
    let printed = render(&["-o", "b.exr", "--samples", "4"]);
    assert!(
        printed.contains("needs 16 samples") && !printed.contains("denoise is") && !printed.contains("layer"),
        "{printed}"
    );
    let printed = render(&["-o", "c.exr", "--samples", "1"]);
    assert!(printed.contains("the layer noisy is left out"), "{printed}");
}

#[test]
fn dash_is_standard_input_and_standard_output() {
    let job = jobs::quick();
    let folder = folder_with(&job);
    assert!(run_in(folder.path(), &["render", "job.json", "-o", "a.png"]).status.success());
    let piped = finish(sdfarm(&["render", "-", "-o", "-"]), job.to_string().as_bytes());
    assert!(piped.status.success(), "{}", text(&piped.stderr));
    assert!(piped.stdout == fs::read(folder.path().join("a.png")).expect("written"));
}

#[test]
fn render_prints_its_summary_as_json_with_the_flag() {
    let folder = folder_with(&jobs::quick());
    let output = run_in(folder.path(), &["render", "job.json", "-o", "a.png", "--json"]);
    let summary: Value = serde_json::from_slice(&output.stdout).expect("only JSON");
    assert!(output.stderr.is_empty(), "{}", text(&output.stderr));
    assert_eq!((&summary["width"], &summary["output"]), (&Value::from(96), &Value::from("a.png")));
    assert!(summary["render_ms"].as_f64().is_some_and(|ms| ms > 0.0) && summary["encode_ms"].is_f64(), "{summary}");
    let piped = run_in(folder.path(), &["render", "job.json", "-o", "-", "--json"]);
    assert!(serde_json::from_slice::<Value>(&piped.stderr).is_ok_and(|summary| summary["output"] == "-"));
    assert!(piped.stdout == fs::read(folder.path().join("a.png")).expect("written"), "only the picture");
}

#[test]
fn several_frames_are_rendered_to_a_folder_or_by_a_pattern() {
    let mut job = jobs::quick();
    job["name"] = "turn".into();
    job["frames"] = serde_json::json!({ "count": 12 });
    job["scene"]["camera"]["turntable"] = serde_json::json!({});
    let folder = folder_with(&job);
    let render = |arguments: &[&str]| {
        let output = run_in(folder.path(), &[&["render", "job.json", "--scale", "20%"], arguments].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    render(&["--frames", "10-11,0", "-o", "all/"]);
    assert_eq!(names_in(&folder.path().join("all")), ["turn.0000.png", "turn.0010.png", "turn.0011.png"]);
    let said = render(&["--frames", "10", "-o", "shot.##.exr", "--json"]);
    let summary: Value = serde_json::from_str(&said).expect("one line");
    assert_eq!((&summary["frame"], &summary["output"]), (&Value::from(10), &Value::from("shot.10.exr")));
    // The time of a frame is that in the whole animation.
    render(&["--frame", "10", "-o", "one.png"]);
    let read = |name: &str| fs::read(folder.path().join(name)).expect("written");
    assert!(read("one.png") == read("all/turn.0010.png") && read("one.png") != read("all/turn.0011.png"));
    for (arguments, says) in [
        (["--frames", "0-2", "-o", "a.png"], "a pattern such as shot.####.png"),
        (["--frames", "0-12", "-o", "other/"], "no frame 12"),
        (["--frames", "2-0", "-o", "other/"], "0,4,8-11"),
    ] {
        assert_misuse(&run_in(folder.path(), &[&["render", "job.json"], arguments.as_slice()].concat()), says);
    }
    assert!(!folder.path().join("other").exists());
}

#[test]
fn interrupted_render_leaves_no_file_and_keeps_the_old_one() {
    for signal in [Signal::INT, Signal::TERM] {
        let folder = folder_with(&jobs::endless());
        fs::write(folder.path().join("a.png"), "old").expect("written");
        let mut command = sdfarm(&["render", "job.json", "-o", "a.png"]);
        let mut child = command.current_dir(folder.path()).stderr(Stdio::null()).spawn().expect("starts");
        eventually("it has begun to write", || (names_in(folder.path()).len() == 3).then_some(()));
        send_signal(child.id(), signal);
        assert_eq!(wait(&mut child).code(), Some(1));
        assert_eq!(names_in(folder.path()), ["a.png", "job.json"]);
        assert_eq!(fs::read(folder.path().join("a.png")).expect("there"), b"old");
    }
}

#[test]
fn check_accepts_a_valid_job_and_rejects_an_invalid_one() {
    let folder = folder_with(&jobs::quick());
    assert!(succeed(&["check", folder.path().join("job.json").to_str().expect("plain")]).contains(": valid"));
    fs::write(folder.path().join("bad.json"), "{\n  \"scene\": 7 }").expect("written");
    let bad = run_in(folder.path(), &["check", "bad.json"]);
    assert_misuse(&bad, "bad.json:2:");
}

#[test]
fn shipped_jobs_are_valid() {
    for (name, _) in jobs::shipped() {
        let path = crate::support::root().join(format!("scenes/{name}.json"));
        succeed(&["check", path.to_str().expect("plain")]);
    }
}

#[test]
fn client_commands_submit_follow_and_fetch_a_job() {
    let farm = Farm::start(&["--workers", "1"]);
    let job = jobs::quick();
    let folder = folder_with(&job);
    let on_farm = |arguments: &[&str]| {
        let output = run_in(folder.path(), &[arguments, &["--server", &farm.address]].concat());
        assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
        text(&output.stdout).trim().to_owned()
    };
    let id = on_farm(&["submit", "job.json", "--wait", "-o", "waited.png"]);
    assert!(on_farm(&["watch", &id]).contains("succeeded"));
    on_farm(&["fetch", &id, "-o", "fetched.png"]);
    let waited = fs::read(folder.path().join("waited.png")).expect("written");
    assert!(waited == fs::read(folder.path().join("fetched.png")).expect("written") && waited == farm.picture(&id));
    assert!(on_farm(&["jobs"]).contains(&id[28..]));
    assert!(on_farm(&["watch", &id[28..]]).contains("succeeded") && on_farm(&["watch", "latest"]).contains(&id[28..]));
    assert_eq!(
        on_farm(&["file", "latest"]),
        fs::read_to_string(folder.path().join("job.json")).expect("a file").trim()
    );
    assert!(on_farm(&["pool", "0"]).starts_with("0 workers wanted, "));
    let queued = on_farm(&["submit", "job.json", "--no-cache"]);
    assert!(on_farm(&["jobs", "--state", "queued"]).contains(&queued[28..]));
    let again = on_farm(&["resubmit", "latest", "--no-cache", "--patch", r#"{"name": "again"}"#]);
    assert!(on_farm(&["cancel", "again"]).contains(&again[28..]));
    // Ids created within a minute have the same first characters, so the candidates are listed.
    let several = run_in(folder.path(), &["cancel", &queued[..8], "--server", &farm.address]);
    assert_misuse(&several, &queued[28..]);
    let none = run_in(folder.path(), &["cancel", "unknown", "--server", &farm.address]);
    assert_misuse(&none, "sdfarm jobs");
    assert!(on_farm(&["cancel", &queued]).contains("cancelled"));
    let watched = run_in(folder.path(), &["watch", &queued, "--server", &farm.address]);
    assert_eq!(watched.status.code(), Some(1));
    assert!(text(&watched.stderr).contains("was cancelled"));
    assert_misuse(
        &run_in(folder.path(), &["submit", "job.json", "--wait", "-o", "a.exr", "--server", &farm.address]),
        "png",
    );
}

#[test]
fn errors_of_a_submitted_job_name_the_file() {
    let farm = Farm::start(&["--workers", "0"]);
    let mut job = jobs::quick();
    job["image"]["samples"] = Value::from(0);
    let folder = folder_with(&job);
    let output = run_in(folder.path(), &["submit", "job.json", "--server", &farm.address]);
    assert_misuse(&output, "job.json:1:");
    assert!(text(&output.stderr).contains("/image/samples"));
}

#[test]
fn variables_set_flags_and_flags_take_precedence() {
    let farm = Farm::start(&["--workers", "0"]);
    let mut command = sdfarm(&["pool"]);
    command.env("SDFARM_SERVER", &farm.address);
    assert!(finish(command, b"").status.success());
    let mut command = sdfarm(&["pool", "--server", &farm.address]);
    command.env("SDFARM_SERVER", "http://127.0.0.1:1");
    assert!(finish(command, b"").status.success());
    let mut command = sdfarm(&["pool"]);
    command.env("SDFARM_SERVER", "nowhere");
    assert_misuse(&finish(command, b""), "http://HOST:PORT");
}

#[test]
fn open_starts_the_browser_or_prints_the_address() {
    let farm = Farm::start(&["--workers", "0"]);
    let folder = tempfile::tempdir().expect("a folder");
    let page = format!("{}/\n", farm.address);
    let open = |browser: &str| {
        let mut command = sdfarm(&["open", "--server", &farm.address]);
        command.env("BROWSER", browser).env("PATH", folder.path());
        finish(command, b"")
    };
    let browser = folder.path().join("browser");
    fs::write(&browser, "#!/bin/sh\necho \"$1\" >\"$0.saw\"\n").expect("written");
    fs::set_permissions(&browser, std::os::unix::fs::PermissionsExt::from_mode(0o755)).expect("set");
    let output = open(&browser.display().to_string());
    assert_eq!((output.status.code(), text(&output.stdout)), (Some(0), page.clone()));
    assert!(output.stderr.is_empty(), "{}", text(&output.stderr));
    assert_eq!(fs::read_to_string(folder.path().join("browser.saw")).expect("the browser was started"), page);
    let output = open("no-such-browser");
    assert_eq!((output.status.code(), text(&output.stdout)), (Some(0), page));
    assert!(text(&output.stderr).contains("open this address"), "{}", text(&output.stderr));
    let absent = run(&["open", "--server", "http://127.0.0.1:1"]);
    assert_eq!(absent.status.code(), Some(1), "{}", text(&absent.stderr));
}

#[test]
fn usage_errors_exit_with_2_and_help_with_0() {
    for arguments in [&["rendr"][..], &[], &["render"], &["pool", "x"], &["fetch", "x"], &["serve", "--simd", "mmx"]] {
        let output = run(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output.stderr));
    }
    assert!(succeed(&["--help"]).contains("sdfarm demo"));
    for command in [
        "serve", "worker", "render", "submit", "watch", "fetch", "jobs", "cancel", "pool", "check", "new", "fmt",
        "diff", "schema", "bench", "selftest", "demo",
    ] {
        assert!(succeed(&[command, "--help"]).contains("Usage: sdfarm"), "{command}");
    }
}

#[test]
fn demo_leaves_a_picture_and_nothing_else() {
    let folder = tempfile::tempdir().expect("a folder");
    let first = run_in(folder.path(), &["demo", "--scene", "csg"]);
    assert!(first.status.success(), "{}", text(&first.stderr));
    assert_eq!(names_in(folder.path()), ["csg.png"]);
    let picture = fs::read(folder.path().join("csg.png")).expect("there");
    assert!(picture.starts_with(b"\x89PNG"));

    fs::write(folder.path().join("csg.png"), "the user's own").expect("written");
    assert!(run_in(folder.path(), &["demo", "--scene", "csg"]).status.success());
    assert_eq!(names_in(folder.path()), ["csg-2.png", "csg.png"]);
    assert_eq!(fs::read(folder.path().join("csg.png")).expect("there"), b"the user's own");
    assert!(fs::read(folder.path().join("csg-2.png")).expect("there") == picture);
    assert_misuse(&run_in(folder.path(), &["demo", "--scene", "absent"]), "csg");
    assert!(succeed(&["demo", "--list"]).lines().any(|name| name == "csg"));
}

#[test]
fn selftest_finds_every_level_equal() {
    let table = succeed(&["selftest", "--device", "cpu"]);
    assert!(table.contains("equal") && !table.contains("differ"), "{table}");
}

#[test]
fn logs_are_json_with_the_flag() {
    let farm = Farm::start(&["--workers", "0", "--log", "json"]);
    assert_eq!(farm.get("/v1/jobs").status, 200);
    let log = farm.log();
    assert!(!log.is_empty());
    for line in log.lines() {
        assert!(serde_json::from_str::<Value>(line).is_ok(), "{line}");
    }
}

#[test]
fn bench_measures_every_level_of_this_machine() {
    let folder = folder_with(&jobs::quick());
    let output = run_in(folder.path(), &["bench", "job.json", "--simd", "all", "--runs", "1", "--json"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let reports: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    for (kind, figure) in [("points", "points_per_second"), ("renders", "rays_per_second")] {
        let reports = reports[kind].as_array().expect("reports");
        assert_eq!(reports[0]["simd"], "scalar");
        assert!(reports.iter().all(|report| report[figure].as_f64().is_some_and(|figure| figure > 0.0)), "{reports:?}");
    }
    let evaluations: Vec<u64> = reports["renders"]
        .as_array()
        .expect("reports")
        .iter()
        .map(|report| report["evaluations"].as_u64().expect("a count"))
        .collect();
    assert!(evaluations.windows(2).all(|pair| pair[0] == pair[1]), "the same work at each level: {evaluations:?}");
    let rows = |level: &str| {
        let rows = reports["renders"].as_array().expect("reports").iter().filter(|report| report["simd"] == level);
        rows.map(|report| report["threads"].as_u64().expect("a number")).collect::<Vec<u64>>()
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as u64;
    let mut distinct = vec![1, 2.min(cores), cores];
    distinct.dedup();
    assert_eq!((rows("scalar"), rows("portable")), (distinct.clone(), distinct));
    assert_misuse(&run_in(folder.path(), &["bench", "absent"]), "csg");
}

#[test]
fn bench_points_measures_distances_alone() {
    let table = succeed(&["bench", "csg", "--points", "--seconds", "1"]);
    assert!(table.lines().any(|line| line.starts_with("csg")) && !table.contains("frames"), "{table}");
}

#[test]
fn bench_compile_lists_scenes_and_back_ends() {
    let reports = succeed(&["bench", "csg", "paper/csg", "--compile", "--runs", "2", "--json"]);
    let reports: Value = serde_json::from_str(&reports).expect("JSON");
    let scenes = reports["compile_times"].as_array().expect("reports");
    assert_eq!(scenes.iter().map(|scene| &scene["job"]).collect::<Vec<_>>(), ["csg", "paper/csg"]);
    for scene in scenes {
        let back_ends = scene["back_ends"].as_array().expect("back ends");
        let portable = back_ends.last().expect("every CPU has it");
        assert!(portable["simd"] == "portable" && portable["code_bytes"].is_null(), "{scene}");
        for time in back_ends.iter().map(|back_end| &back_end["prepare_ms"]).chain([&scene["record_ms"]]) {
            assert!(time["least"].as_f64() <= time["greatest"].as_f64() && time["median"].is_number(), "{scene}");
        }
    }
    let table = succeed(&["bench", "csg", "--compile", "--runs", "1"]);
    assert!(table.contains("the largest") && table.contains("all together"), "{table}");
}
