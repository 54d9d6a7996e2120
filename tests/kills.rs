//! `kill -9` of workers and of the server, at random instants: nothing is lost, and every
//! picture has the bytes of an undisturbed render.

use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::Value;

use crate::jobs;
use crate::support::{DEADLINE, Farm, eventually, finish, is_alive, sdfarm, send_signal, text};

const WORKER_KILLS: usize = 20;
const SERVER_KILLS: usize = 5;
/// A kill comes so long, at most, after the one before is healed, in milliseconds.
const LONGEST_PAUSE_MS: u64 = 300;
/// Longer than any test: a lease that had to run out would fail it.
const LEASE_SECONDS: &str = "3600";

/// A small generator of our own: the instants are the same in every run.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        // Marsaglia, "Xorshift RNGs", 2003.
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % limit
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.below(from.len() as u64) as usize]
    }
}

/// A job of some seconds and many tiles.
fn long_job(seed: u64) -> Value {
    jobs::seeded(&jobs::as_png(&jobs::sized(&jobs::named("mandelbulb"), 640, 96)), seed)
}

fn rendered_here(job: &Value) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("picture.png");
    let output = finish(sdfarm(&["render", "-", "-o", path.to_str().expect("plain")]), job.to_string().as_bytes());
    assert!(output.status.success(), "{}", text(&output.stderr));
    std::fs::read(path).expect("a picture")
}

fn state(farm: &Farm, id: &str) -> String {
    farm.get(&format!("/v1/jobs/{id}")).json()["state"].as_str().expect("a state").to_owned()
}

/// Time from a job's acceptance to its end.
fn undisturbed(farm: &Farm, job: &Value) -> Duration {
    let start = Instant::now();
    let id = farm.accept(&job.to_string());
    farm.succeeded(&id);
    start.elapsed()
}

#[test]
fn killed_workers_cost_no_picture_a_bit() {
    let farm = Farm::start(&["--workers", "2", "--tile", "64", "--lease-seconds", LEASE_SECONDS]);
    farm.ready(2);
    let usual = (0..3).map(|seed| undisturbed(&farm, &long_job(1000 + seed))).min().expect("three");
    let mut random = Random(0x5eed_0001);
    let mut kills = 0;
    let mut lost = Duration::ZERO;
    for seed in 0.. {
        if kills == WORKER_KILLS {
            break;
        }
        assert!(seed < 100, "jobs end before they can be disturbed: only {kills} kills");
        let job = long_job(seed);
        let start = Instant::now();
        let id = farm.accept(&job.to_string());
        let before = kills;
        kills += disturb(&farm, &id, &mut random, WORKER_KILLS - kills);
        farm.succeeded(&id);
        if kills > before {
            lost += start.elapsed().saturating_sub(usual);
            assert!(farm.picture(&id) == rendered_here(&job), "job {seed}: other bytes than an undisturbed run's");
        }
    }
    let each = lost.as_secs_f64() * 1e3 / WORKER_KILLS as f64;
    eprintln!("{WORKER_KILLS} workers killed: each cost {each:.0} ms; a job of {usual:?}");
    farm.ready(2);
}

/// Kills workers at random instants while the job runs, each after the pool is whole again.
fn disturb(farm: &Farm, id: &str, random: &mut Random, most: usize) -> usize {
    for kills in 0..most {
        eventually("a tile is leased", || (state(farm, id) != "queued").then_some(()));
        eventually("the pool is whole, or the job ended", || {
            (farm.get("/v1/pool").json()["ready"] == 2 || state(farm, id) != "running").then_some(())
        });
        // Chance, not a wait for anything: the instant is what is tested.
        std::thread::sleep(Duration::from_millis(random.below(LONGEST_PAUSE_MS)));
        let workers = farm.workers();
        if workers.is_empty() || state(farm, id) != "running" {
            return kills;
        }
        let victim = random.pick(&workers);
        send_signal(victim, Signal::KILL);
        eventually("it is reaped", || (!farm.workers().contains(&victim)).then_some(()));
    }
    most
}

#[test]
fn killed_server_forgets_nothing_and_leaves_no_worker() {
    let folder = tempfile::tempdir().expect("a folder");
    let arguments = ["--workers", "2", "--tile", "64", "--lease-seconds", LEASE_SECONDS];
    let mut random = Random(0x5eed_0002);
    let mut accepted: Vec<(String, Value)> = Vec::new();
    for round in 0..SERVER_KILLS as u64 {
        let farm = Farm::start_on(folder.path(), &arguments);
        for (id, _) in &accepted {
            assert_eq!(farm.get(&format!("/v1/jobs/{id}")).status, 200, "job {id} is forgotten");
        }
        for seed in 0..3 {
            let job = long_job(2000 + round * 10 + seed);
            accepted.push((farm.accept(&job.to_string()), job));
        }
        farm.ready(2);
        std::thread::sleep(Duration::from_millis(random.below(4 * LONGEST_PAUSE_MS)));
        let orphans = farm.kill();
        assert_eq!(orphans.len(), 2);
        eventually("no worker outlives its server", || (!orphans.iter().any(|&worker| is_alive(worker))).then_some(()));
    }
    let farm = Farm::start_on(folder.path(), &arguments);
    let start = Instant::now();
    for (id, job) in &accepted {
        farm.succeeded(id);
        assert!(farm.picture(id) == rendered_here(job), "job {id}: other bytes than an undisturbed run's");
    }
    eprintln!("{} jobs kept over {SERVER_KILLS} kills, done in {:?} of {DEADLINE:?}", accepted.len(), start.elapsed());
}

#[test]
fn terminated_worker_hands_back_and_the_job_goes_on() {
    let farm = Farm::start(&["--workers", "2", "--tile", "64", "--lease-seconds", LEASE_SECONDS]);
    farm.ready(2);
    let job = long_job(3000);
    let id = farm.accept(&job.to_string());
    eventually("it runs", || (state(&farm, &id) == "running").then_some(()));
    send_signal(farm.workers()[0], Signal::TERM);
    farm.succeeded(&id);
    assert!(farm.picture(&id) == rendered_here(&job));
}
