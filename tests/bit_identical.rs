//! Same bits everywhere, the whole way: pictures as PNG and as float EXR with all layers, by `render` over SIMD levels
//! and tile sizes, and by farms of several workers. A few scenes in every run of the tests, all of them in the long
//! ones; `worker/tests/worker/bit_identical.rs` goes over all scenes in all ways without processes.
//!
//! Small by default; `SDFARM_FULL_SIZE=1` takes the jobs as they are shipped.

use std::fs;
use std::process::{Child, Stdio};
use std::sync::OnceLock;

use serde_json::Value;

use crate::exr_reader;
use crate::jobs;
use crate::skip::skip;
use crate::support::{Farm, finish, sdfarm, succeed, text};

const WIDTH_PX: u64 = 128;
const SAMPLES: u64 = 2;
/// Jobs that scalar code does not take long for.
const FEW: [&str; 3] = ["csg", "five-spheres", "paper/csg"];
/// The one that is rendered in full in every run of the tests.
const QUICKEST: &str = "five-spheres";

/// A job to compare, with the picture that scalar code makes of it in one piece.
struct Specimen {
    name: String,
    extension: &'static str,
    job: Value,
    want: Vec<u8>,
}

/// Renders with `render`; `Err` holds what it says.
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
        .unwrap_or_else(|told| panic!("{name}: {told}"));
    Specimen { name: name.to_owned(), extension, job, want }
}

fn specimens(mut jobs: Vec<(String, Value)>) -> Vec<Specimen> {
    let is_full_size = std::env::var_os("SDFARM_FULL_SIZE").is_some_and(|wanted| wanted == "1");
    let mut specimens = Vec::new();
    for (name, job) in &mut jobs {
        let job = if is_full_size { job.clone() } else { jobs::sized(job, WIDTH_PX, SAMPLES) };
        specimens.push(specimen(name, "png", jobs::as_png(&job)));
        specimens.push(specimen(name, "exr", jobs::as_exr(&job)));
    }
    specimens
}

/// Those that every run of the tests renders.
fn few() -> &'static [Specimen] {
    static SPECIMENS: OnceLock<Vec<Specimen>> = OnceLock::new();
    SPECIMENS.get_or_init(|| specimens(FEW.map(|name| (name.to_owned(), jobs::named(name))).to_vec()))
}

/// Every shipped job.
fn all() -> &'static [Specimen] {
    static SPECIMENS: OnceLock<Vec<Specimen>> = OnceLock::new();
    SPECIMENS.get_or_init(|| specimens(jobs::shipped()))
}

/// A few specimens come out the same with these flags of `render`.
fn assert_same(flags: &[&str]) {
    let mut wrong = Vec::new();
    for Specimen { name, extension, job, want } in few() {
        match render(job, extension, flags) {
            Ok(got) if got == *want => {}
            Ok(_) => wrong.push(format!("{name}.{extension} differs")),
            Err(told) => wrong.push(format!("{name}.{extension}: {told}")),
        }
    }
    assert!(wrong.is_empty(), "{flags:?}:\n{}", wrong.join("\n"));
}

/// The same, at a SIMD level that this machine may lack.
fn assert_same_at(level: &str) {
    match render(&jobs::quick(), "png", &["--simd", level]) {
        Ok(_) => assert_same(&["--simd", level]),
        Err(told) => {
            assert!(told.contains("cannot render with"), "{told}");
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
fn best_level_gives_the_bits_of_scalar_code_with_any_threads_and_tiles() {
    assert_same(&[]);
    assert_same(&["--threads", "3", "--tile", "32"]);
}

/// These specimens come out the same from a farm as it stands.
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

/// Farms of one, two and three workers; the second and third also stitch, from small and from large tiles.
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
fn farms_make_what_render_makes_of_a_few_scenes() {
    assert_farms_same(few());
}

#[test]
#[ignore = "long: every shipped scene by five farms; three minutes"]
fn farms_make_what_render_makes_of_every_scene() {
    assert_farms_same(all());
}

#[test]
fn workers_of_different_instruction_sets_share_a_frame() {
    let farm = Farm::start(&["--workers", "0", "--tile", "32"]);
    let _workers = ["scalar", "auto"].map(|level| Worker::start(&farm, level));
    farm.joined(2);
    assert_farm_same(&farm, few());
}

/// A worker that is no child of its server's.
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
        // Both fail only where it has ended already.
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
            assert!(positions.iter().sum::<usize>() > 10_000, "only {positions:?} positions were compared")
        }
        None => eprintln!("skipped: no Python with OpenEXR to apply the matrices of the headers"),
    }
}

#[test]
fn two_readers_read_a_few_pictures_alike() {
    assert_read_alike(few());
}

#[test]
#[ignore = "long: every shipped scene as an EXR, read by two readers; a minute"]
fn two_readers_read_every_picture_alike() {
    assert_read_alike(all());
}

fn assert_hash_is_kept(name: &str) {
    let told = succeed(&["selftest", "--device", "cpu", "--against", "hashes", name]);
    assert_eq!(told.lines().filter(|line| line.ends_with("equal")).count(), 1, "{told}");
}

#[test]
fn a_shipped_scene_at_full_size_has_the_hash_that_is_kept() {
    assert_hash_is_kept(QUICKEST);
}

#[test]
#[ignore = "long: every shipped scene at full size; three minutes"]
fn every_shipped_scene_at_full_size_has_the_hash_that_is_kept() {
    for (name, _) in jobs::shipped() {
        assert_hash_is_kept(&name);
    }
}

fn assert_levels_equal(names: &[&str]) {
    let told = succeed(&[&["selftest", "--device", "cpu", "--against", "levels"], names].concat());
    assert!(told.contains("equal") && !told.contains("differ"), "{told}");
}

#[test]
fn selftest_finds_the_scalar_bits_at_every_level() {
    assert_levels_equal(&[]);
}

#[test]
#[ignore = "long: every shipped scene at every level by selftest; two minutes"]
fn selftest_finds_the_scalar_bits_of_every_scene_at_every_level() {
    let jobs = jobs::shipped();
    assert_levels_equal(&jobs.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>());
}
