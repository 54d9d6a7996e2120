//! Tests of a system that refuses executable memory: the interpreter takes over, with the same bytes, and a request for
//! machine code is refused clearly. The kernel refuses it for real, by `PR_SET_MDWE` (Linux 6.3).

use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::jobs;
use crate::skip::skip;
use crate::support::{PROGRAM, clean, finish, text};

/// Gives up the right to make written memory executable, and becomes the program of the arguments.
const CONFINED: &str = "
import ctypes, os, sys
PR_SET_MDWE, PR_MDWE_REFUSE_EXEC_GAIN = 65, 1
if ctypes.CDLL(None).prctl(PR_SET_MDWE, PR_MDWE_REFUSE_EXEC_GAIN, 0, 0, 0) != 0:
    sys.exit(77)
os.execv(sys.argv[1], sys.argv[1:])
";

/// Renders a job in a process that gets no executable memory: its picture, and its standard error. `None` if this
/// system can't refuse it.
fn render_confined(job: &Value, level: &str, picture: &Path) -> Option<(bool, String)> {
    let mut command = Command::new("python3");
    clean(&mut command).args(["-c", CONFINED, PROGRAM, "render", "-", "--simd", level, "-o"]).arg(picture);
    let output = finish(command, job.to_string().as_bytes());
    if output.status.code() == Some(77) {
        return None;
    }
    Some((output.status.success(), text(&output.stderr)))
}

fn render(job: &Value, level: &str, picture: &Path) {
    let mut command = Command::new(PROGRAM);
    clean(&mut command).args(["render", "-", "--simd", level, "-o"]).arg(picture);
    let output = finish(command, job.to_string().as_bytes());
    assert!(output.status.success(), "{}", text(&output.stderr));
}

/// Names of the levels of machine code that this machine has.
fn levels(folder: &Path) -> Vec<&'static str> {
    let is_available = |level: &&str| {
        let mut command = Command::new(PROGRAM);
        clean(&mut command).args(["render", "-", "--simd", level, "-o"]).arg(folder.join("level.png"));
        finish(command, jobs::quick().to_string().as_bytes()).status.success()
    };
    ["avx512", "avx2"].into_iter().filter(is_available).collect()
}

#[test]
fn without_executable_memory_the_interpreter_renders_the_same_bytes() {
    let folder = tempfile::tempdir().expect("a folder");
    if levels(folder.path()).is_empty() {
        return skip("avx2", "there is no machine code for this machine");
    }
    for (job, extension) in [(jobs::quick(), "png"), (jobs::as_exr(&jobs::quick()), "exr")] {
        let path = |name: &str| folder.path().join(name).with_extension(extension);
        let Some((is_done, printed)) = render_confined(&job, "auto", &path("confined")) else {
            return skip("mdwe", "this kernel can't refuse executable memory");
        };
        assert!(is_done, "{printed}");
        render(&job, "auto", &path("free"));
        let read = |name: &str| std::fs::read(path(name)).expect("a picture");
        assert!(read("confined") == read("free"), "the {extension} differs");
        // The picture and the sRGB curve are compiled one after the other.
        assert_eq!(printed.matches("executable memory").count(), 1, "one warning: {printed}");
        assert!(
            printed.contains("WARN") && printed.contains("interpreter") && printed.contains("--simd portable"),
            "{printed}"
        );
    }
}

#[test]
fn without_executable_memory_a_request_for_machine_code_fails_clearly() {
    let folder = tempfile::tempdir().expect("a folder");
    for level in levels(folder.path()) {
        let picture = folder.path().join(level).with_extension(OsStr::new("png"));
        let Some((is_done, printed)) = render_confined(&jobs::quick(), level, &picture) else {
            return skip("mdwe", "this kernel can't refuse executable memory");
        };
        assert!(!is_done && !picture.exists(), "{level} needs executable memory: {printed}");
        for part in [&format!("--simd {level}"), "executable memory", "Permission denied", "--simd portable"] {
            assert!(printed.contains(part), "{part} is not in: {printed}");
        }
    }
}

#[test]
fn the_interpreter_needs_no_executable_memory_and_warns_of_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let job = jobs::as_exr(&jobs::quick());
    for level in ["portable", "scalar"] {
        match render_confined(&job, level, &folder.path().join("picture.exr")) {
            Some((is_done, printed)) => assert!(is_done && !printed.contains("WARN"), "{level}: {printed}"),
            None => return skip("mdwe", "this kernel can't refuse executable memory"),
        }
    }
}
