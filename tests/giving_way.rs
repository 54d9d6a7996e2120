//! A batch that takes long gives way: another submitter's job is rendered beside it, and it loses nothing.

use std::process::Command;
use std::time::{Duration, Instant};

use crate::fake_cuda;
use crate::jobs;
use crate::support::{Farm, eventually, finish, new_key, sdfarm};

/// A picture of one tile that takes long, and one that takes no time.
fn long(samples: u64) -> String {
    jobs::as_png(&jobs::of_long_tiles(32, samples)).to_string()
}

fn tiny(seed: u64) -> String {
    jobs::seeded(&jobs::sized(&jobs::named("csg"), 8, 1), seed).to_string()
}

#[test]
fn a_tile_that_takes_minutes_delays_no_other_submitter_and_goes_on() {
    check(sdfarm(&["serve"]), "cpu", &long(65_536), &long(2_048));
}

#[test]
fn a_gpu_gives_way_as_well() {
    // The stand-in is one thread of a CPU.
    let of = |samples| jobs::as_png(&jobs::sized(&jobs::named("csg"), 32, samples)).to_string();
    check(fake_cuda::on_machine_with_gpu(sdfarm(&["serve"])), "cuda", &of(65_536), &of(4_096));
}

/// Another submitter's jobs end beside a tile that takes minutes, and beside one that takes some seconds longer than a batch
/// that gives way.
fn check(serve: Command, device: &str, endless: &str, shared_job: &str) {
    let folder = tempfile::tempdir().expect("a folder");
    let key = |name, scope| new_key(folder.path(), name, scope);
    let admin = key("admin", "admin");
    let [anna, bert] = ["anna", "bert"].map(|name| key(name, "submit,read"));
    let farm = Farm::start_by(serve, folder.path(), &["--workers", "1", "--device", device]);
    let submit = |key: &str, job: String| {
        let answer = farm.send("POST", "/v1/jobs", &[("authorization", key)], job.into_bytes());
        assert_eq!(answer.status, 201, "{}", answer.text());
        answer.json()["id"].as_str().expect("an id").to_owned()
    };
    let state = |id: &str| {
        let answer = farm.send("GET", &format!("/v1/jobs/{id}"), &[("authorization", &admin)], Vec::new());
        answer.json()["state"].as_str().expect("a state").to_owned()
    };
    // After short batches the next is requested ahead, so that it waits behind the long one.
    let short = [0, 1].map(|seed| submit(&bert, tiny(seed)));
    eventually("short jobs end", || short.iter().all(|id| state(id) == "succeeded").then_some(()));
    let endless = submit(&anna, endless.to_owned());
    let mut took = Vec::new();
    for seed in 2..6 {
        let (start, small) = (Instant::now(), submit(&bert, tiny(seed)));
        eventually("another submitter's job ends", || (state(&small) == "succeeded").then_some(()));
        took.push(start.elapsed());
        assert_eq!(state(&endless), "running");
    }
    // They begin two seconds after the last batch began, and not at the next heartbeat, five seconds later.
    took.sort_unstable();
    assert!(took[1] < Duration::from_secs(5) && took[3] < Duration::from_secs(20), "it took {took:?}");
    let cancelled = farm.send("POST", &format!("/v1/jobs/{endless}/cancel"), &[("authorization", &admin)], Vec::new());
    assert_eq!(cancelled.status, 200, "{}", cancelled.text());

    // A picture beside which others were rendered has the bytes that it has alone.
    let (begun, shared) = (Instant::now(), submit(&anna, shared_job.to_owned()));
    let mut beside = 0;
    while state(&shared) != "succeeded" {
        assert!(begun.elapsed() < Duration::from_mins(5), "it does not end");
        let small = submit(&bert, tiny(10 + beside));
        eventually("another submitter's job ends", || (state(&small) == "succeeded").then_some(()));
        beside += 1;
    }
    let image = farm.send("GET", &format!("/v1/jobs/{shared}/image"), &[("authorization", &admin)], Vec::new());
    let alone = folder.path().join("alone.png");
    let mut render = sdfarm(&["render", "-", "--device", "cpu", "-o"]);
    render.arg(&alone);
    let output = finish(render, shared_job.as_bytes());
    assert!(output.status.success());
    assert!(std::fs::read(alone).expect("a picture") == image.body, "beside {beside} others it has other bytes");
}
