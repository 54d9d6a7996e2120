//! Work that does not end by itself: a worker is freed from it by a cancel, by a time limit, and with its pool.

use std::time::{Duration, Instant};

use proto::fail_point;
use rustix::process::Signal;
use serde_json::{Value, json};

use crate::jobs;
use crate::support::{Farm, children, eventually, is_alive, sdfarm, send_signal};

/// One tile of 256 pixels, each of 65,536 samples, each a path of up to 32 segments between rough fractals of glass. One
/// pixel alone takes 45 s on two cores.
fn endless(seed: u64) -> Value {
    json!({
        "name": "endless",
        "scene": {
            "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
            "march": { "max_bounces": 32, "max_distance": 100_000, "max_steps": 65_536 },
            "objects": [{
                "material": { "surface": { "transmission": 1, "ior": 1.5, "roughness": 0.3 } },
                "shape": { "repeat": { "cell": [2.4, 2.4, 2.4], "child": { "mandelbulb": { "iterations": 64, "power": 8 } } } }
            }]
        },
        "image": { "width": 16, "height": 16, "samples": 65_536, "seed": seed }
    })
}

/// Tiny job.
fn tiny(seed: u64) -> String {
    jobs::seeded(&jobs::quick(), seed).to_string()
}

/// Submits an endless job, and waits until a worker renders it.
fn start_endless(farm: &Farm, seed: u64) -> String {
    let id = farm.accept(&endless(seed).to_string());
    eventually("it is leased", || (state(farm, &id)["state"] == "running").then_some(()));
    id
}

fn state(farm: &Farm, id: &str) -> Value {
    farm.get(&format!("/v1/jobs/{id}")).json()
}

fn cancel(farm: &Farm, id: &str) {
    let answer = farm.send("POST", &format!("/v1/jobs/{id}/cancel"), &[], Vec::new());
    assert_eq!(answer.status, 200, "{}", answer.text());
}

/// Submits a job with a time limit for its tiles, in seconds.
fn accept_with_limit(farm: &Farm, job: &str, seconds: u32) -> String {
    let path = format!("/v1/jobs?tile_seconds={seconds}");
    let answer = farm.send("POST", &path, &[("content-type", "application/json")], job.as_bytes().to_vec());
    assert_eq!(answer.status, 201, "{}", answer.text());
    answer.json()["id"].as_str().expect("a job has an id").to_owned()
}

/// Starts a farm of one worker whose second render hangs, and ignores that it is cancelled.
fn with_hanging_worker(folder: &std::path::Path) -> Farm {
    let mut command = sdfarm(&[fail_point::FLAG, "serve"]);
    command.env(fail_point::ENV_VAR, "rendering=slow:3600000@2");
    let farm = Farm::start_by(command, folder, &["--workers", "1"]);
    farm.ready(1);
    farm.succeeded(&farm.accept(&tiny(0)));
    farm
}

#[test]
fn a_cancelled_tile_of_endless_work_frees_its_worker() {
    let farm = Farm::start(&["--workers", "1"]);
    farm.ready(1);
    let workers = farm.workers();
    let endless = start_endless(&farm, 0);
    let waiting = farm.accept(&tiny(0));
    cancel(&farm, &endless);
    farm.succeeded(&waiting);
    assert_eq!(farm.workers(), workers, "the worker need not exit for that");
    let endless = start_endless(&farm, 1);
    cancel(&farm, &endless);
    farm.set_pool(0);
    eventually("the pool has no process", || farm.workers().is_empty().then_some(()));
}

#[test]
fn a_killed_server_leaves_no_process_that_renders() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut farm = Farm::start_on(folder.path(), &["--workers", "2"]);
    farm.ready(2);
    let endless = start_endless(&farm, 0);
    let address = farm.address.clone();
    // Its helper process draws until the server is killed, and then there is no response.
    let preview = std::thread::spawn(move || {
        drop(crate::support::try_send(
            &address,
            "GET",
            &format!("/v1/jobs/{endless}/frames/0/preview"),
            &[],
            Vec::new(),
        ));
    });
    eventually("a helper draws", || (children(farm.process()).len() == 3 || preview.is_finished()).then_some(()));
    let processes = children(farm.process());
    send_signal(farm.process(), Signal::KILL);
    eventually("the server is dead", || farm.has_ended().then_some(()));
    eventually("its processes are dead", || processes.iter().all(|&process| !is_alive(process)).then_some(()));
    preview.join().expect("the request ends");
}

#[test]
#[ignore = "long: a tile hangs until its limit of five seconds; 10 s"]
fn a_tile_that_hangs_over_its_limit_is_rendered_by_another_worker() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm = with_hanging_worker(folder.path());
    let hanging = farm.workers();
    let limited = accept_with_limit(&farm, &tiny(1), 5);
    farm.succeeded(&limited);
    assert!(hanging.iter().all(|&worker| !is_alive(worker)), "the worker that hung has exited");
    assert!(farm.log().contains("did not stop"), "{}", farm.log());
}

#[test]
fn a_cancelled_worker_that_hangs_is_replaced() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm = with_hanging_worker(folder.path());
    let hanging = farm.workers();
    let id = farm.accept(&tiny(1));
    eventually("it is leased", || (state(&farm, &id)["state"] == "running").then_some(()));
    cancel(&farm, &id);
    farm.succeeded(&farm.accept(&tiny(2)));
    assert!(hanging.iter().all(|&worker| !is_alive(worker)), "the worker that hung has exited");
}

#[test]
#[ignore = "long: a tile fails three times at its limit of a second; 5 s"]
fn a_tile_over_its_limit_fails_its_job_with_the_cure() {
    let farm = Farm::start(&["--workers", "1", "--max-tile-seconds", "60"]);
    let id = accept_with_limit(&farm, &endless(0).to_string(), 1);
    let job = eventually("it fails", || Some(state(&farm, &id)).filter(|job| job["state"] == "failed"));
    let error = job["errors"][0].to_string();
    for word in ["its limit of 1 s", "fewer samples", "smaller tiles", "--tile-seconds", "--max-tile-seconds"] {
        assert!(error.contains(word), "{error}");
    }
    farm.succeeded(&farm.accept(&tiny(0)));
    let path = "/v1/jobs?tile_seconds=61";
    let refused = farm.send("POST", path, &[("content-type", "application/json")], tiny(1).into_bytes());
    assert_eq!(refused.status, 422, "{}", refused.text());
    assert!(refused.text().contains("--max-tile-seconds"), "{}", refused.text());
}

#[test]
#[ignore = "long: a surplus worker has ten seconds to finish its tile; 15 s"]
fn a_surplus_worker_does_not_render_for_ever() {
    let farm = Farm::start(&["--workers", "1"]);
    farm.ready(1);
    let endless = start_endless(&farm, 0);
    farm.set_pool(0);
    eventually("the pool has no process", || farm.workers().is_empty().then_some(()));
    assert_eq!(state(&farm, &endless)["state"], "running", "its tile waits for another worker");
}

#[test]
#[ignore = "long: twenty cancels; 30 s"]
fn twenty_cancels_free_the_worker_at_once() {
    const WORST: Duration = Duration::from_secs(2);
    let farm = Farm::start(&["--workers", "1"]);
    farm.ready(1);
    farm.succeeded(&farm.accept(&tiny(100)));
    let workers = farm.workers();
    let mut times: Vec<Duration> = (0..20)
        .map(|seed| {
            let endless = start_endless(&farm, seed);
            std::thread::sleep(Duration::from_millis(200));
            let waiting = farm.accept(&tiny(seed));
            let start = Instant::now();
            cancel(&farm, &endless);
            farm.succeeded(&waiting);
            start.elapsed()
        })
        .collect();
    times.sort();
    eprintln!("from a cancel to the next job's picture: median {:?}, maximum {:?}", times[10], times[19]);
    // A busy machine misses the target of 250 ms; a worker that takes longer than this would have been replaced.
    assert!(times[19] <= WORST, "{times:?}");
    assert_eq!(farm.workers(), workers);
}

#[test]
fn a_cancelled_compilation_ends_no_worker() {
    let farm = Farm::start(&["--workers", "1"]);
    farm.ready(1);
    let workers = farm.workers();
    for seed in 0..2 {
        // Its program takes seconds to record and compile.
        let id = farm.accept(&jobs::seeded(&jobs::of_nested_textures(4_000), seed).to_string());
        eventually("it is leased", || (state(&farm, &id)["state"] == "running").then_some(()));
        std::thread::sleep(Duration::from_millis(300));
        cancel(&farm, &id);
        farm.succeeded(&farm.accept(&tiny(seed)));
    }
    assert_eq!(farm.workers(), workers, "a worker has ended");
}
