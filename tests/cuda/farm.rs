//! Tests farms with a GPU: its pictures, a frame shared with a CPU, and the work of a GPU that fails.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use rustix::process::Signal;
use serde_json::{Value, json};

use super::{ON_GPU, of_nodes, render, render_on_cpu, small, with_fault, with_gpu};
use crate::jobs;
use crate::support::{Farm, eventually, finish, sdfarm, send_signal, wait};

const FARM: [&str; 6] = ["--workers", "0", "--device", "cpu", "--tile", "32"];

/// Worker process that only the test reaps.
struct Worker(Child);

impl Worker {
    fn start(mut command: Command, farm: &Farm, log: &Path) -> Self {
        let log = fs::File::create(log).expect("a log");
        command.args(["--server", &farm.address]).stdin(Stdio::null()).stderr(log);
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

/// More rays than one batch of a worker whose speed is unknown.
fn long_job(seed: u64) -> Value {
    jobs::seeded(&jobs::as_exr(&jobs::sized(&jobs::named("csg"), 640, 20)), seed)
}

fn view(farm: &Farm, id: &str) -> Value {
    farm.get(&format!("/v1/jobs/{id}")).json()
}

fn workers(farm: &Farm) -> Vec<Value> {
    farm.get("/v1/workers").json()["workers"].as_array().expect("workers").clone()
}

#[test]
fn gpu_pool_gives_cpu_bytes_and_reports_unsupported_scenes() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm = Farm::start_by(with_gpu(&["serve"]), folder.path(), &["--workers", "1", "--device", "cuda"]);
    farm.ready(1);
    assert_eq!(workers(&farm)[0]["device"], "cuda:0");
    for job in [jobs::as_png(&small("csg")), jobs::as_exr(&small("csg")), jobs::as_exr(&small("dice"))] {
        let id = farm.accept(&job.to_string());
        farm.succeeded(&id);
        assert!(farm.picture(&id) == render_on_cpu(&job), "{}: other bytes than a CPU's", job["name"]);
    }
    let job = of_nodes(251);
    let id = farm.accept(&job.to_string());
    assert!(view(&farm, &id)["warnings"].to_string().contains("CPU"), "{}", view(&farm, &id));
    let _cpu = Worker::start(sdfarm(&["worker", "--device", "cpu"]), &farm, &folder.path().join("cpu"));
    farm.succeeded(&id);
    assert!(farm.picture(&id) == render_on_cpu(&job));
}

#[test]
fn gpu_and_cpu_share_a_frame_without_seams() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm = Farm::start_on(folder.path(), &FARM);
    let job = long_job(1);
    // The program is compiled before, so that both workers start at the same time.
    render(with_gpu(&ON_GPU), &jobs::sized(&job, 64, 1)).expect("a GPU renders it");
    let _gpu = Worker::start(with_gpu(&["worker", "--device", "cuda"]), &farm, &folder.path().join("gpu"));
    let _cpu = Worker::start(sdfarm(&["worker", "--device", "cpu"]), &farm, &folder.path().join("cpu"));
    farm.joined(2);
    let id = farm.accept(&job.to_string());
    farm.succeeded(&id);
    assert!(farm.picture(&id) == render_on_cpu(&job), "other bytes than a CPU's");
    for worker in workers(&farm) {
        assert!(worker["rays_per_second"].is_number(), "it rendered a part: {worker}");
    }
}

#[test]
fn lost_gpu_retires_its_worker_and_costs_no_tile() {
    let folder = tempfile::tempdir().expect("a folder");
    // No lease expires: the worker releases its leases, also those granted while it retires.
    let farm = Farm::start_on(folder.path(), &[&FARM[..], &["--lease-seconds", "3600"]].concat());
    let (sign, log) = (folder.path().join("sign"), folder.path().join("gpu"));
    let gpu = with_fault(&format!("lost_when:{}", sign.display()), &["worker", "--device", "cuda"]);
    let mut gpu = Worker::start(gpu, &farm, &log);
    farm.joined(1);
    let job = long_job(2);
    let id = farm.accept(&job.to_string());
    let done = || view(&farm, &id)["tiles"]["done"].as_u64().expect("a count");
    eventually("the GPU has rendered some tiles", || (done() > 0).then_some(()));
    fs::write(&sign, "").expect("written");
    assert_eq!(wait(&mut gpu.0).code(), Some(3), "{}", fs::read_to_string(&log).expect("a log"));
    let logged = fs::read_to_string(&log).expect("a log");
    assert!(logged.contains("CUDA_ERROR_LAUNCH_FAILED") && !logged.contains("panicked"), "{logged}");
    assert!(workers(&farm).is_empty(), "it has deregistered");
    let left = view(&farm, &id);
    assert!(left["state"] == "running" && left["tiles"]["done"].as_u64() < left["tiles"]["total"].as_u64(), "{left}");
    farm.set_pool(1);
    farm.succeeded(&id);
    assert!(farm.picture(&id) == render_on_cpu(&job), "other bytes than a CPU's");
}

#[test]
fn pool_excludes_a_bad_gpu_and_keeps_serving() {
    let folder = tempfile::tempdir().expect("a folder");
    let serve = with_fault("wrong_bits", &["serve"]);
    let farm = Farm::start_by(serve, folder.path(), &["--workers", "1", "--device", "cuda"]);
    eventually("the pool heard of it", || farm.log().contains("a worker's device cannot render").then_some(()));
    assert!(farm.log().contains("results are wrong") && !farm.log().contains("panicked"), "{}", farm.log());
    let job = jobs::quick();
    let id = farm.accept(&job.to_string());
    let _cpu = Worker::start(sdfarm(&["worker", "--device", "cpu"]), &farm, &folder.path().join("cpu"));
    farm.succeeded(&id);
    assert!(farm.picture(&id) == render_on_cpu(&job));
}

#[test]
fn auto_pool_uses_the_cpu_if_the_gpu_is_bad() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm = Farm::start_by(with_fault("wrong_bits", &["serve"]), folder.path(), &[]);
    farm.ready(1);
    assert_eq!(workers(&farm)[0]["device"], "cpu");
    eventually("it says why", || farm.log().contains("results are wrong").then_some(()));
    let job = jobs::quick();
    let id = farm.accept(&job.to_string());
    farm.succeeded(&id);
    assert!(farm.picture(&id) == render_on_cpu(&job));
}

/// A scene with a moving camera as a short animation of small pictures.
fn animation(frames: usize, seed: u64) -> Value {
    let mut job = jobs::seeded(&jobs::as_png(&jobs::sized(&jobs::named("csg"), 192, 1)), seed);
    job["frames"] = json!({ "count": frames, "fps": 24 });
    job["scene"]["camera"]["position"] = json!({ "keys": [[0, [0.1, 0.4, 4]], [9, [1.5, 0.9, 3.5]]] });
    job
}

/// Compares all frames of an animation with those that a CPU renders.
fn check_frames(farm: &Farm, id: &str, job: &Value, folder: &Path) {
    let frames = job["frames"]["count"].as_u64().expect("a count");
    let path = folder.join("want");
    let mut command = sdfarm(&["render", "-", "--device", "cpu", "--frames", &format!("0-{}", frames - 1), "-o"]);
    command.arg(path.join("frame.####.png"));
    fs::create_dir_all(&path).expect("a folder");
    let output = finish(command, job.to_string().as_bytes());
    assert!(output.status.success(), "{output:?}");
    for frame in 0..frames {
        let got = farm.get(&format!("/v1/jobs/{id}/frames/{frame}/image")).body;
        let want = fs::read(path.join(format!("frame.{frame:04}.png"))).expect("rendered");
        assert!(got == want, "frame {frame}: other bytes than a CPU's");
    }
}

#[test]
fn frames_in_flight_give_cpu_bytes() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm =
        Farm::start_by(with_gpu(&["serve"]), folder.path(), &["--workers", "1", "--device", "cuda", "--tile", "64"]);
    farm.ready(1);
    let job = animation(40, 1);
    let id = farm.accept(&job.to_string());
    farm.succeeded(&id);
    check_frames(&farm, &id, &job, folder.path());
}

#[test]
fn little_pinned_memory_delays_frames_and_loses_none() {
    let folder = tempfile::tempdir().expect("a folder");
    // A frame takes 442 KB, and the self-test's less.
    let serve = with_fault("pinned:700000", &["serve"]);
    let farm = Farm::start_by(serve, folder.path(), &["--workers", "1", "--device", "cuda", "--tile", "64"]);
    farm.ready(1);
    let job = animation(20, 2);
    let id = farm.accept(&job.to_string());
    farm.succeeded(&id);
    check_frames(&farm, &id, &job, folder.path());
}

/// Frames that have been stored.
fn stored(farm: &Farm, id: &str) -> u64 {
    view(farm, id)["frames"]["done"].as_u64().expect("a count")
}

#[test]
fn killed_gpu_worker_with_frames_in_flight_loses_none() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm =
        Farm::start_by(with_gpu(&["serve"]), folder.path(), &["--workers", "1", "--device", "cuda", "--tile", "64"]);
    farm.ready(1);
    let job = animation(60, 3);
    let id = farm.accept(&job.to_string());
    for part in 1..=3 {
        eventually("some more frames are stored", || (stored(&farm, &id) >= part * 10).then_some(()));
        farm.workers().into_iter().for_each(|worker| send_signal(worker, Signal::KILL));
    }
    farm.succeeded(&id);
    check_frames(&farm, &id, &job, folder.path());
}

#[test]
fn gpu_lost_while_frames_are_copied_costs_no_frame() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm = Farm::start_on(
        folder.path(),
        &["--workers", "0", "--device", "cpu", "--tile", "64", "--lease-seconds", "3600"],
    );
    let (sign, log) = (folder.path().join("sign"), folder.path().join("gpu"));
    let gpu = with_fault(&format!("copies_fail_when:{}", sign.display()), &["worker", "--device", "cuda"]);
    let mut gpu = Worker::start(gpu, &farm, &log);
    farm.joined(1);
    let job = animation(200, 4);
    let id = farm.accept(&job.to_string());
    eventually("some frames are stored", || (stored(&farm, &id) > 0).then_some(()));
    fs::write(&sign, "").expect("written");
    assert_eq!(wait(&mut gpu.0).code(), Some(3), "{}", fs::read_to_string(&log).expect("a log"));
    let logged = fs::read_to_string(&log).expect("a log");
    assert!(logged.contains("CUDA_ERROR_LAUNCH_FAILED") && !logged.contains("panicked"), "{logged}");
    assert!(stored(&farm, &id) < 200, "it failed in the midst");
    farm.set_pool(1);
    farm.succeeded(&id);
    check_frames(&farm, &id, &job, folder.path());
}
