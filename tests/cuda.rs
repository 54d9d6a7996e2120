//! Tests the GPU code without a GPU: the real binary with stand-ins for NVIDIA's driver and run-time compiler
//! (`fake_cuda/`), and its messages if they are missing, old, or broken.
//! The stand-ins run the program that a GPU would run, so its pictures must be bit-identical to the CPU's.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use rustix::process::Signal;
use serde_json::{Value, json};

use crate::fake_cuda::{self, COMPILER, DRIVER, SOURCES, stand_ins};
use crate::jobs;
use crate::skip::skip;
use crate::support::{eventually, finish, sdfarm, send_signal, text, wait};

mod farm;

/// Copies a stand-in and erases a function's name, so that it lacks the function like an older release.
fn without(function: &str, library: &str, folder: &Path) {
    let mut bytes = fs::read(stand_ins().join(library).join(library)).expect("it was built");
    let name = format!("\0{function}\0").into_bytes();
    let places: Vec<usize> =
        bytes.windows(name.len()).enumerate().filter(|(_, part)| *part == name).map(|(at, _)| at).collect();
    assert!(!places.is_empty(), "{library} has no {function}");
    for at in places {
        bytes[at + 1] = b'-';
    }
    fs::write(folder.join(library), bytes).expect("written");
}

/// Names of a stand-in's functions.
fn functions(source: &str) -> impl Iterator<Item = &str> {
    source.lines().filter_map(|line| {
        let (kind, rest) = line.split_once(' ')?;
        let (name, _) = rest.trim_start_matches("char* ").split_once('(')?;
        (["Result", "const"].contains(&kind) && (name.starts_with("cu") || name.starts_with("nvrtc"))).then_some(name)
    })
}

/// Command of the program on a machine with these libraries.
fn with(libraries: &[&Path], arguments: &[&str]) -> Command {
    fake_cuda::on_machine_with(libraries, sdfarm(arguments))
}

/// Command of the program on a machine with a working GPU.
fn with_gpu(arguments: &[&str]) -> Command {
    fake_cuda::on_machine_with_gpu(sdfarm(arguments))
}

/// Command of the program on a machine with a GPU that simulates a fault.
fn with_fault(fault: &str, arguments: &[&str]) -> Command {
    let mut command = with_gpu(arguments);
    command.env("FAKE_CUDA", fault);
    command
}

/// Whether the real library is installed, in any version.
fn is_installed(library: &str) -> bool {
    let versions = (1..=20).map(|version| format!(".{version}"));
    std::iter::once(String::new()).chain(versions).any(|version| {
        // The loader prints a message if it cannot find a library.
        let probe = Command::new("true")
            .env("LD_PRELOAD", format!("{library}{version}"))
            .env_remove("LD_LIBRARY_PATH")
            .output();
        probe.expect("coreutils are installed").stderr.is_empty()
    })
}

/// Shipped scene as a job of 64 x 48 pixels.
fn small(name: &str) -> Value {
    let mut job = jobs::sized(&jobs::named(name), 64, 3);
    job["image"]["height"] = json!(48);
    job
}

/// Job with an object of this many spheres, which are children of an operation.
fn of_spheres(operation: &str, spheres: usize) -> Value {
    let mut job = small("csg");
    let sphere = |number: usize| json!({ "translate": { "by": [number % 20, number / 20, 0], "child": { "sphere": { "radius": 0.3 } } } });
    job["scene"]["objects"] =
        json!([{ "shape": { operation: { "of": (0..spheres).map(sphere).collect::<Vec<_>>() } } }]);
    job
}

/// Job with this many nodes, which are not cut into leaves.
fn of_nodes(spheres: usize) -> Value {
    jobs::as_png(&of_spheres("intersection", spheres))
}

/// Job of cells, whose kernel asks for those that it needs.
fn of_cells() -> Value {
    let mut job = of_spheres("union", 300);
    job["scene"]["camera"] = json!({ "position": [9.5, 7, -22], "look_at": [9.5, 7, 0] });
    job
}

/// Renders a job, given as text, to a file of its format; returns the picture, or the message if it fails.
fn render(mut command: Command, job: &Value) -> Result<Vec<u8>, String> {
    let extension = job["image"]["format"].as_str().unwrap_or("png");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(format!("picture.{extension}"));
    command.arg("-o").arg(&path);
    let output = finish(command, job.to_string().as_bytes());
    let printed = printed(&output);
    if output.status.success() {
        return Ok(fs::read(path).expect("a picture"));
    }
    assert_eq!(output.status.code(), Some(1), "{printed}");
    Err(printed)
}

fn render_on_cpu(job: &Value) -> Vec<u8> {
    render(sdfarm(&["render", "-", "--device", "cpu"]), job).expect("a CPU renders it")
}

/// Returns the standard error of the program, which must not contain a panic.
fn printed(output: &Output) -> String {
    let printed = text(&output.stderr);
    assert!(!printed.contains("panicked"), "{printed}");
    printed
}

/// Asserts that a render fails with a message that contains these words.
fn assert_fails(command: Command, job: &Value, says: &[&str]) {
    let printed = render(command, job).expect_err("it can't be rendered");
    for words in says {
        assert!(printed.contains(words), "{words:?} is not in: {printed}");
    }
}

/// Number of operations that a stand-in has counted.
fn lines_in(count: &Path) -> usize {
    fs::read_to_string(count).map_or(0, |lines| lines.lines().count())
}

const ON_GPU: [&str; 4] = ["render", "-", "--device", "cuda"];

#[test]
fn missing_driver_is_reported_with_the_fix() {
    if is_installed("libcuda.so") {
        return skip("no-driver", "this machine has a driver");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let data = data.to_str().expect("plain");
    let commands: [(&[&str], i32); 5] = [
        (&["render", "-", "-o", "-"], 1),
        (&["serve", "--listen", "127.0.0.1:0", "--data", data], 1),
        (&["worker", "--server", "http://127.0.0.1:1"], 3),
        (&["bench", "csg"], 1),
        (&["selftest"], 1),
    ];
    for (arguments, code) in commands {
        let output =
            finish(with(&[], &[arguments, &["--device", "cuda"]].concat()), jobs::quick().to_string().as_bytes());
        let printed = printed(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {printed}");
        assert!(printed.contains("no NVIDIA driver") && printed.contains("--device cpu"), "{arguments:?}: {printed}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
    assert!(!Path::new(data).exists(), "a farm that does not start creates no files");
}

#[test]
fn auto_uses_the_cpu_silently_without_a_driver() {
    if is_installed("libcuda.so") {
        return skip("no-driver", "this machine has a driver");
    }
    let job = jobs::quick();
    let output = finish(with(&[], &["render", "-", "-o", "-", "--device", "auto"]), job.to_string().as_bytes());
    assert!(output.status.success() && output.stdout == render_on_cpu(&job), "{}", printed(&output));
    assert!(!printed(&output).contains("CPU"), "{}", printed(&output));
}

#[test]
fn each_cuda_error_has_a_message() {
    let faults: [(&str, &str, &[&str]); 6] = [
        ("no_device", "cuda", &["finds no GPU", "nvidia-smi", "--device cpu"]),
        ("", "cuda:7", &["--device cuda:7", "no GPU 7", "there are 1, counted from 0"]),
        (
            "init_fails",
            "cuda",
            &["start the NVIDIA driver", "CUDA_ERROR_SYSTEM_DRIVER_MISMATCH", "unsupported display driver"],
        ),
        ("newer", "cuda", &["13.0 cannot compile for this GPU (sm_120)", "newer cuda-nvrtc"]),
        (
            "wrong_bits",
            "cuda",
            &["--device cuda:0", "results are wrong: 1 of 98304 values", "do not use it for a farm"],
        ),
        ("memory:1000", "cuda", &["out of memory for 393216 bytes"]),
    ];
    for (fault, device, says) in faults {
        assert_fails(with_fault(fault, &["render", "-", "--device", device]), &jobs::quick(), says);
        let worker = finish(with_fault(fault, &["worker", "--server", "http://127.0.0.1:1", "--device", device]), b"");
        assert_eq!(worker.status.code(), Some(3), "{fault}: {}", printed(&worker));
        assert!(printed(&worker).contains(says[0]), "{fault}: {}", printed(&worker));
    }
}

#[test]
fn library_that_lacks_a_function_is_reported_as_too_old() {
    let folder = tempfile::tempdir().expect("a folder");
    for (library, source) in SOURCES {
        let names: Vec<&str> = functions(source).collect();
        assert!(names.len() > 10, "{names:?}");
        for name in names {
            without(name, library, folder.path());
            let folders = [folder.path(), &stand_ins().join(DRIVER), &stand_ins().join(COMPILER)];
            assert_fails(with(&folders, &ON_GPU), &jobs::quick(), &["is too old", &format!("lacks {name}; install")]);
        }
        fs::remove_file(folder.path().join(library)).expect("written before");
    }
}

#[test]
fn missing_compiler_is_reported() {
    if is_installed("libnvrtc.so") {
        return skip("no-nvrtc", "this machine has CUDA's run-time compiler");
    }
    let says = ["run-time compiler is missing", "cuda-nvrtc", "LD_LIBRARY_PATH"];
    assert_fails(with(&[&stand_ins().join(DRIVER)], &ON_GPU), &jobs::quick(), &says);
}

#[test]
fn auto_uses_the_cpu_and_reports_a_bad_gpu() {
    let job = jobs::quick();
    let output = finish(with_fault("wrong_bits", &["render", "-", "-o", "-"]), job.to_string().as_bytes());
    assert!(output.status.success() && output.stdout == render_on_cpu(&job), "{}", printed(&output));
    assert!(
        printed(&output).contains("rendering on the CPU: ") && printed(&output).contains("results are wrong"),
        "{}",
        printed(&output)
    );
}

#[test]
fn gpu_gives_cpu_bytes_for_some_blocks_and_tiles() {
    check_blocks_and_tiles(3);
}

#[test]
#[ignore = "long: all pictures with all blocks; 15 s"]
fn gpu_gives_cpu_bytes_for_all_blocks_and_tiles() {
    check_blocks_and_tiles(1);
}

/// Renders each picture with every `step`-th of these flags, from another one on for each.
fn check_blocks_and_tiles(step: usize) {
    let pictures = [
        jobs::as_png(&small("csg")),
        jobs::as_exr(&small("csg")),
        jobs::as_exr(&small("five-spheres")),
        jobs::as_png(&small("mandelbulb")),
        jobs::as_exr(&small("paper/smoothing")),
        jobs::as_exr(&small("dice")),
        jobs::as_exr(&of_cells()),
    ];
    let flags: [&[&str]; 4] = [&[], &["--block", "128x1"], &["--block", "16x16", "--tile", "32"], &["--block", "7x3"]];
    for (index, job) in pictures.into_iter().enumerate() {
        let want = render_on_cpu(&job);
        for flags in flags.into_iter().skip(index % step).step_by(step) {
            let got = render(with_gpu(&[&ON_GPU, flags].concat()), &job);
            let is_same = got.as_ref().is_ok_and(|got| *got == want);
            assert!(is_same, "{} differs with {flags:?}: {:?}", job["name"], got.err());
        }
    }
}

#[test]
fn compiled_program_is_cached_and_recompiled_if_damaged() {
    let folder = tempfile::tempdir().expect("a folder");
    let (cache, count) = (folder.path().join("cache"), folder.path().join("count"));
    let (job, moved) = (jobs::as_png(&small("csg")), {
        let mut job = jobs::as_png(&jobs::sized(&small("csg"), 96, 3));
        job["scene"]["camera"]["position"] = json!([0.1, 0.4, 4]);
        job
    });
    let compiled = |job: &Value, what: &str| {
        let _ = fs::remove_file(&count);
        let mut command = with_gpu(&[&ON_GPU[..], &["--cache", cache.to_str().expect("plain")]].concat());
        command.env("FAKE_NVRTC_COUNT", &count);
        assert!(render(command, job).expect("a picture") == render_on_cpu(job), "{what}");
        lines_in(&count)
    };
    let kept = || fs::read_dir(&cache).expect("it was made").map(|entry| entry.expect("readable").path());
    assert_eq!(compiled(&job, "new"), 2, "the self-test's and the scene's");
    assert_eq!(kept().count(), 2);
    assert_eq!(compiled(&job, "kept"), 0);
    assert_eq!(compiled(&moved, "of the same shape"), 0, "other values need no other program");
    for path in kept() {
        let mut bytes = fs::read(&path).expect("readable");
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(&path, bytes).expect("writable");
    }
    assert_eq!(compiled(&job, "damaged"), 2);
    assert_eq!(compiled(&job, "mended"), 0);
}

#[test]
fn rejected_program_is_saved_for_inspection() {
    let folder = tempfile::tempdir().expect("a folder");
    let cache = folder.path().to_str().expect("plain");
    let with_cache = |fault: &str| {
        let mut command = with_gpu(&[&ON_GPU[..], &["--cache", cache]].concat());
        command.env("FAKE_NVRTC", fault);
        command
    };
    let kept = || {
        let files = fs::read_dir(folder.path()).expect("a folder").map(|entry| entry.expect("an entry").path());
        let rejected = files.filter(|path| path.extension().is_some_and(|end| end == "cu"));
        rejected.map(|path| fs::read_to_string(path).expect("the program's text")).collect::<Vec<_>>()
    };
    // First the self-test's program is rejected, then a scene's, with the self-test's cached from a successful run.
    let printed = render(with_cache("refuse"), &jobs::quick()).expect_err("it is refused");
    assert!(
        printed.contains("--device cuda:0: the scene's kernel could not be compiled")
            && printed.contains("as the test asks for"),
        "{printed}"
    );
    assert!(matches!(&kept()[..], [text] if text.contains("void render(")));
    render(with_cache(""), &jobs::as_png(&small("dice"))).expect("the compiler takes it");
    let printed = render(with_cache("refuse"), &jobs::quick()).expect_err("it is refused");
    assert!(printed.contains("cuda:0 could not render: the scene's kernel could not be compiled"), "{printed}");
    let (_, error) = printed.split_once("error: ").expect("an error");
    assert!(!error.contains(cache), "a submitter learns nothing of the machine: {printed}");
    assert_eq!(kept().len(), 2);
    assert!(kept().iter().all(|text| text.ends_with("// scene.cu(1): error: refused, as the test asks for\n")));
}

#[test]
fn scene_too_large_for_a_gpu_is_rejected() {
    assert_fails(with_gpu(&ON_GPU), &of_nodes(251), &["has 503 nodes", "takes at most 500", "--device cpu"]);
}

#[test]
fn picture_that_exceeds_memory_is_rejected() {
    let job = jobs::as_png(&jobs::sized(&jobs::named("csg"), 640, 1));
    assert_fails(with_fault("memory:2000000", &ON_GPU), &job, &["out of memory for 3686400 bytes", "--tile"]);
}

#[test]
fn smaller_tiles_fit_into_less_memory() {
    let job = jobs::as_png(&jobs::sized(&jobs::named("csg"), 640, 1));
    let got = render(with_fault("memory:2000000", &[&ON_GPU[..], &["--tile", "64"]].concat()), &job);
    assert!(got.expect("smaller tiles fit") == render_on_cpu(&job));
}

#[test]
fn cells_that_do_not_fit_are_made_again() {
    let job = jobs::as_exr(&of_cells());
    let want = render_on_cpu(&job);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("picture.exr");
    let mut command = with_gpu(&[&ON_GPU[..], &["--cell-memory", "150KB"]].concat());
    command.arg("-o").arg(&path).env("SDFARM_LOG", "worker=debug");
    let output = finish(command, job.to_string().as_bytes());
    let printed = printed(&output);
    assert!(printed.contains("the cells had no room"), "{printed}");
    assert!(output.status.success(), "{printed}");
    assert!(fs::read(path).expect("a picture") == want, "the pixels differ");
    let little = with_gpu(&[&ON_GPU[..], &["--cell-memory", "10KB"]].concat());
    assert_fails(little, &job, &["do not fit into 0.", "--cell-memory"]);
}

#[test]
fn interrupted_gpu_render_stops_between_two_launches() {
    /// More launches than the self-test and the search for the best blocks need.
    const LAUNCHES: usize = 100;
    let folder = tempfile::tempdir().expect("a folder");
    let count = folder.path().join("count");
    fs::write(folder.path().join("job.json"), jobs::endless().to_string()).expect("written");
    let mut command = with_gpu(&["render", "job.json", "-o", "a.png", "--device", "cuda"]);
    command.current_dir(folder.path()).env("FAKE_CUDA_COUNT", &count).stderr(Stdio::null());
    let mut child = command.spawn().expect("starts");
    eventually("the picture is launched", || (lines_in(&count) > LAUNCHES).then_some(()));
    send_signal(child.id(), Signal::INT);
    assert_eq!(wait(&mut child).code(), Some(1));
    let mut names: Vec<_> =
        fs::read_dir(folder.path()).expect("readable").map(|entry| entry.expect("readable").file_name()).collect();
    names.sort();
    assert_eq!(names, ["count", "job.json"], "no other file is left");
}

#[test]
fn bench_measures_a_gpu() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("job.json");
    fs::write(&path, jobs::as_png(&small("csg")).to_string()).expect("written");
    let arguments = ["bench", path.to_str().expect("plain"), "--device", "cuda", "--runs", "1", "--json"];
    let output = finish(with_gpu(&arguments), b"");
    assert!(output.status.success(), "{}", printed(&output));
    let reports: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let report = &reports["gpu_renders"][0];
    assert_eq!(
        (&report["gpu"], &report["registers"], &report["occupancy"]),
        (&json!("Fake GPU"), &json!(64), &json!(0.5))
    );
    assert!(report["kernel_ms"].as_f64().is_some_and(|ms| ms > 0.0), "{report}");
    assert!(report["evaluations"].as_u64().is_some_and(|evaluations| evaluations > 64 * 48 * 3), "{report}");
}
