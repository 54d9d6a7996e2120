//! Fuzzes job files, and the messages between workers and servers.

use proto::Problem;
use proto::worker_protocol::{RegisterRequest, SyncRequest, SyncResponse};
use serde_json::json;

use super::{Effort, fuzz};
use crate::jobs;

fn job_files() -> Vec<Vec<u8>> {
    let shipped = jobs::shipped().into_iter().map(|(_, job)| job.to_string().into_bytes());
    let small = shipped.filter(|text| text.len() < 8 << 10).chain([jobs::quick().to_string().into_bytes()]);
    small.chain(growing_jobs().into_iter().map(String::into_bytes)).collect()
}

/// Job files that a changed digit makes large: counted copies with formulas, uses of uses, a track of many keys.
pub(super) fn growing_jobs() -> [String; 3] {
    let keys: Vec<_> = (0..50).map(|key| json!([key, 1])).collect();
    let mut tracked = jobs::of_doublings(5);
    tracked["scene"]["shapes"]["s0"] = json!({ "sphere": { "radius": { "keys": keys } } });
    [jobs::of_noisy_copies(90), jobs::of_doublings(9), tracked].map(|job| job.to_string())
}

/// An accepted job must pass every operation of a server before rendering.
fn try_job_files(effort: Effort) {
    fuzz("job files", effort, &job_files(), |text| match scene::parse(text) {
        Ok(job) => {
            scene::warnings(&job);
            assert!(job.nodes() > 0 && job.frames.count > 0 && job.image.width > 0);
            let again = scene::parse(text).expect("an accepted job is accepted again");
            assert_eq!(again.name, job.name);
            assert!(job.at(0).is_ok(), "an accepted job has a first frame");
        }
        Err(scene::ParseError::NotJson(fault)) => assert!(!fault.message.is_empty()),
        Err(scene::ParseError::Invalid(faults)) => {
            assert!(!faults.is_empty() && faults.iter().all(|fault| fault.line > 0));
        }
    });
}

#[test]
fn fuzzed_job_files_are_accepted_or_rejected() {
    try_job_files(Effort::Runs(300));
}

#[test]
#[ignore = "long: fuzzing for 60 s"]
fn long_fuzzed_job_files_are_accepted_or_rejected() {
    try_job_files(Effort::Long);
}

fn requests() -> Vec<Vec<u8>> {
    let id = "01900000-0000-7000-8000-000000000000";
    let hash = "0".repeat(64);
    [
        json!({ "name": "n", "device": "cpu", "picture_version": 1, "max_nodes": null, "process": 1 }),
        json!({ "worker": id, "rays_per_second": 1e6, "held_leases": [id], "wants_work": true, "wait_ms": 10_000,
                "reports": [{ "lease": id, "outcome": { "blob": { "hash": hash, "size_bytes": 4096 } } }] }),
        json!({ "worker": id, "rays_per_second": null, "held_leases": [], "wants_work": false, "wait_ms": 0, "shutting_down": true,
                "reports": [{ "lease": id, "outcome": { "bad_blobs": { "tiles": [0, 7] } } },
                            { "lease": id, "outcome": "released" },
                            { "lease": id, "outcome": { "failed": { "message": "no" } } }] }),
        json!({ "batch": { "job": id, "frame": 3, "work": { "render": { "whole_frame": true, "tiles": [
                    { "lease": id, "index": 0, "rect": { "x": 0, "y": 0, "width": 64, "height": 64 } }] } } },
                "revoked_leases": [id], "drain": false }),
        json!({ "batch": { "job": id, "frame": 0, "work": { "stitch": { "lease": id, "inputs": [
                    { "index": 0, "rect": { "x": 0, "y": 0, "width": 64, "height": 64 }, "hash": hash, "size_bytes": 1 }] } } },
                "revoked_leases": [], "drain": true }),
        json!({ "type": "/docs#x", "title": "t", "status": 422, "code": "x", "detail": "d", "errors": [] }),
    ]
    .iter()
    .map(|message| message.to_string().into_bytes())
    .collect()
}

/// A parsed message must serialize, and parse again to the same value.
fn try_messages(effort: Effort) {
    fuzz("messages of workers", effort, &requests(), |text| {
        if let Ok(request) = serde_json::from_slice::<SyncRequest>(text) {
            let said = serde_json::to_vec(&request).expect("writable");
            serde_json::from_slice::<SyncRequest>(&said).expect("a parsed message serializes");
        }
        if let Ok(reply) = serde_json::from_slice::<SyncResponse>(text) {
            let said = serde_json::to_vec(&reply).expect("writable");
            serde_json::from_slice::<SyncResponse>(&said).expect("a parsed message serializes");
        }
        drop(serde_json::from_slice::<RegisterRequest>(text));
        drop(serde_json::from_slice::<Problem>(text));
    });
}

#[test]
fn fuzzed_worker_messages_are_parsed_or_rejected() {
    try_messages(Effort::Runs(2000));
}

#[test]
#[ignore = "long: fuzzing for 60 s"]
fn long_fuzzed_worker_messages_are_parsed_or_rejected() {
    try_messages(Effort::Long);
}
