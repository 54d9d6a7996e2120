//! Fuzzes stored pictures: the helper that draws their previews must draw or report an error.

use std::io::{Read, Write};
use std::process::Stdio;

use serde_json::{Value, json};

use super::pictures::{job, samples, tile_of, written};
use super::{Effort, fuzz};
use crate::support::sdfarm;

/// Maximum width of a preview.
const WIDTH_PX: u32 = 7;

/// Valid files of every stored kind.
fn files() -> Vec<Vec<u8>> {
    let images: [Value; 4] = [
        json!({ "format": "png" }),
        json!({ "format": "png", "bits": 16 }),
        json!({ "format": "exr" }),
        json!({ "format": "exr", "precision": "float", "layers": ["depth", "normal"] }),
    ];
    let file = |image: Value| {
        let job = job(image);
        let planes = job.image.film().channels().len();
        written(&job, tile_of(&samples()[0], planes))
    };
    images.map(file).to_vec()
}

/// Runs the helper; returns its output and its exit code. Its standard input stays open until it exits.
fn sketched(line: &str) -> (Vec<u8>, String, Option<i32>) {
    let mut command = sdfarm(&[proto::preview_helper::HELPER_COMMAND]);
    let mut child = command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut input = child.stdin.take().expect("piped");
    writeln!(input, "{line}").expect("the helper reads");
    let (mut answer, mut words) = (Vec::new(), String::new());
    child.stdout.take().expect("piped").read_to_end(&mut answer).expect("readable");
    child.stderr.take().expect("piped").read_to_string(&mut words).expect("text");
    let status = child.wait().expect("it exits");
    (answer, words, status.code())
}

fn try_stored_pictures(effort: Effort) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("picture");
    let line = json!({ "what": "thumbnail", "file": path, "width_px": WIDTH_PX }).to_string();
    let mut drawn = 0;
    fuzz("stored pictures", effort, &files(), |bytes| {
        std::fs::write(&path, bytes).expect("written");
        let (answer, words, code) = sketched(&line);
        match code {
            Some(0) => {
                let reader = png::Decoder::new(std::io::Cursor::new(&answer)).read_info().expect("a PNG");
                assert!(reader.info().width <= WIDTH_PX, "{} is too wide", reader.info().width);
                drawn += 1;
            }
            Some(1) => assert!(words.starts_with("error: "), "{words}"),
            _ => panic!("{code:?}: {words}"),
        }
    });
    assert!(drawn >= files().len(), "valid files are drawn");
}

#[test]
fn fuzzed_stored_pictures_are_drawn_or_rejected() {
    try_stored_pictures(Effort::Runs(20));
}

#[test]
#[ignore = "long: fuzzing for 60 s"]
fn long_fuzzed_stored_pictures_are_drawn_or_rejected() {
    try_stored_pictures(Effort::Long);
}
