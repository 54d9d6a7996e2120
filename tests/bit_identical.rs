//! Tests that pictures are bit-identical end to end: PNG and float EXR with all layers, by `render` at all SIMD levels
//! and tile sizes, and by farms of several workers. A few scenes in every test run, all of them in long ones;
//! `worker/tests/worker/bit_identical.rs` tests all scenes in all ways without processes.
//! Pictures are small by default; `SDFARM_FULL_SIZE=1` renders the jobs at their shipped size.

use std::fs;
use std::process::{Child, Stdio};
use std::sync::OnceLock;

use serde_json::{Value, json};

use crate::exr_reader;
use crate::jobs;
use crate::skip::skip;
use crate::support::{Farm, finish, sdfarm, succeed, text};

const WIDTH_PX: u64 = 128;
const SAMPLES: u64 = 2;
/// Jobs that scalar code renders quickly.
const FEW: [&str; 3] = ["csg", "five-spheres", "paper/csg"];
/// Job that is rendered at full size in every test run.
const QUICKEST: &str = "five-spheres";

/// Job to compare, with the picture that scalar code renders in one tile.
struct Specimen {
    name: String,
    extension: &'static str,
    job: Value,
    want: Vec<u8>,
}

/// Renders with `render`; `Err` holds its standard error.
fn render(job: &Value, extension: &str, flags: &[&str]) -> Result<Vec<u8>, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(format!("picture.{extension}"));
    let mut command = sdfarm(&["render", "-", "-o"]);
    command.arg(&path).args(flags);
    let output = finish(command, job.to_string().as_bytes());
    if output.status.success() { Ok(fs::read(path).expect("a picture")) } else { Err(text(&output.stderr)) }
}

fn specimen(name: &str, extension: &'static str, job: Value) -> Specimen {
    let want = render(&job, extension, &["--simd", "scalar", "--tile", "65535"])
        .unwrap_or_else(|printed| panic!("{name}: {printed}"));
    Specimen { name: name.to_owned(), extension, job, want }
}

fn specimens(mut jobs: Vec<(String, Value)>) -> Vec<Specimen> {
    let is_full_size = std::env::var_os("SDFARM_FULL_SIZE").is_some_and(|wanted| wanted == "1");
    let mut specimens = Vec::new();
    for (name, job) in &mut jobs {
        let mut job = if is_full_size { job.clone() } else { jobs::sized(job, WIDTH_PX, SAMPLES) };
        // Frame 0 is compared, so a farm need not render the others.
        if let Some(frames) = job.get_mut("frames") {
            frames["count"] = json!(1);
        }
        specimens.push(specimen(name, "png", jobs::as_png(&job)));
        specimens.push(specimen(name, "exr", jobs::as_exr(&job)));
    }
    specimens
}

/// Specimens of every test run.
fn few() -> &'static [Specimen] {
    static SPECIMENS: OnceLock<Vec<Specimen>> = OnceLock::new();
    SPECIMENS.get_or_init(|| specimens(FEW.map(|name| (name.to_owned(), jobs::named(name))).to_vec()))
}

/// Specimens of all shipped jobs.
fn all() -> &'static [Specimen] {
    static SPECIMENS: OnceLock<Vec<Specimen>> = OnceLock::new();
    SPECIMENS.get_or_init(|| specimens(jobs::shipped()))
}

/// Asserts that a few specimens are bit-identical with these flags of `render`.
fn assert_same(flags: &[&str]) {
    let mut wrong = Vec::new();
    for Specimen { name, extension, job, want } in few() {
        match render(job, extension, flags) {
            Ok(got) if got == *want => {}
            Ok(_) => wrong.push(format!("{name}.{extension} differs")),
            Err(printed) => wrong.push(format!("{name}.{extension}: {printed}")),
        }
    }
    assert!(wrong.is_empty(), "{flags:?}:\n{}", wrong.join("\n"));
}

/// Asserts the same for a SIMD level, which this machine may lack.
fn assert_same_at(level: &str) {
    match render(&jobs::quick(), "png", &["--simd", level]) {
        Ok(_) => assert_same(&["--simd", level]),
        Err(printed) => {
            assert!(printed.contains("cannot render with"), "{printed}");
            skip(level, format_args!("this machine has no {level}"));
        }
    }
}

#[test]
fn sse42_gives_the_bits_of_scalar_code() {
    assert_same_at("sse4.2");
}

#[test]
fn avx2_gives_the_bits_of_scalar_code() {
    assert_same_at("avx2");
}

#[test]
fn avx512_gives_the_bits_of_scalar_code() {
    assert_same_at("avx512");
}

#[test]
fn best_level_gives_scalar_bits_for_all_threads_and_tiles() {
    assert_same(&[]);
    assert_same(&["--threads", "3", "--tile", "32"]);
}

/// Asserts that a farm renders these specimens bit-identically.
fn assert_farm_same(farm: &Farm, specimens: &[Specimen]) {
    let headers = [("content-type", "application/json"), ("cache-control", "no-cache")];
    let post = |job: &Value| {
        let answer = farm.send("POST", "/v1/jobs", &headers, job.to_string().into_bytes());
        assert_eq!(answer.status, 201, "{}", answer.text());
        answer.json()["id"].as_str().expect("an id").to_owned()
    };
    let ids: Vec<String> = specimens.iter().map(|specimen| post(&specimen.job)).collect();
    let mut wrong = Vec::new();
    for (Specimen { name, extension, want, .. }, id) in specimens.iter().zip(&ids) {
        farm.succeeded(id);
        if farm.picture(id) != *want {
            wrong.push(format!("{name}.{extension} differs"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Asserts it for farms of one, two, and three workers; the second and third also stitch small and large tiles.
fn assert_farms_same(specimens: &[Specimen]) {
    let farm = Farm::start(&["--workers", "1"]);
    for workers in 1..=3 {
        farm.set_pool(workers);
        assert_farm_same(&farm, specimens);
    }
    drop(farm);
    for (workers, tile) in [("2", "32"), ("3", "256")] {
        assert_farm_same(&Farm::start(&["--workers", workers, "--tile", tile]), specimens);
    }
}

#[test]
fn farms_and_render_write_the_same_bytes_for_few_scenes() {
    assert_farms_same(few());
}

#[test]
#[ignore = "long: every shipped scene by five farms; 3 min"]
fn farms_and_render_write_the_same_bytes_for_every_scene() {
    assert_farms_same(all());
}

#[test]
fn workers_of_different_instruction_sets_share_a_frame() {
    let farm = Farm::start(&["--workers", "0", "--tile", "32"]);
    let _workers = ["scalar", "auto"].map(|level| Worker::start(&farm, level));
    farm.joined(2);
    assert_farm_same(&farm, few());
}

/// Worker process that is not a child of the server.
struct Worker(Child);

impl Worker {
    fn start(farm: &Farm, level: &str) -> Self {
        let mut command = sdfarm(&["worker", "--server", &farm.address, "--threads", "1", "--simd", level]);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        Self(command.spawn().expect("the program starts"))
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        // Both fail only if the process has already exited.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn assert_read_alike(specimens: &[Specimen]) {
    let folder = tempfile::tempdir().expect("a folder");
    let mut positions = Vec::new();
    for Specimen { name, job, want, .. } in specimens.iter().filter(|specimen| specimen.extension == "exr") {
        let path = folder.path().join(format!("{}.exr", name.replace('/', "-")));
        fs::write(&path, want).expect("written");
        exr_reader::check(&path, job);
        positions.push(exr_reader::check_header(&path, job));
    }
    match positions.into_iter().collect::<Option<Vec<usize>>>() {
        Some(positions) => {
            assert!(positions.iter().sum::<usize>() > 10_000, "only {positions:?} positions were compared");
        }
        None => skip("openexr", "no Python with OpenEXR to apply the matrices of the headers"),
    }
}

#[test]
fn two_exr_readers_agree_on_a_few_pictures() {
    assert_read_alike(few());
}

#[test]
#[ignore = "long: every shipped scene as an EXR, read by two readers; 60 s"]
fn two_exr_readers_agree_on_every_picture() {
    assert_read_alike(all());
}

fn assert_hash_is_kept(name: &str) {
    let printed = succeed(&["selftest", "--device", "cpu", "--against", "hashes", name]);
    assert_eq!(printed.lines().filter(|line| line.ends_with("equal")).count(), 1, "{printed}");
}

#[test]
fn full_size_scene_has_its_recorded_hash() {
    assert_hash_is_kept(QUICKEST);
}

#[test]
#[ignore = "long: every shipped scene at full size; 3 min"]
fn every_full_size_scene_has_its_recorded_hash() {
    for (name, _) in jobs::shipped() {
        assert_hash_is_kept(&name);
    }
}

fn assert_levels_equal(names: &[&str]) {
    let printed = succeed(&[&["selftest", "--device", "cpu", "--against", "levels"], names].concat());
    assert!(printed.contains("equal") && !printed.contains("differ"), "{printed}");
}

#[test]
fn selftest_passes_at_every_level() {
    assert_levels_equal(&[]);
}

#[test]
#[ignore = "long: every shipped scene at every level by selftest; 2 min"]
fn selftest_passes_for_every_scene_at_every_level() {
    let jobs = jobs::shipped();
    assert_levels_equal(&jobs.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>());
}
