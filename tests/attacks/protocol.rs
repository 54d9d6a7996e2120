//! A worker that lies, delays, or sends hostile values in every field of the workers' protocol. The fields are those
//! of valid messages, made from the protocol's types.

use std::time::Duration;

use proto::bounded::RaysPerSecond;
use proto::worker_protocol::{
    BatchWork, DeviceMemory, LeaseOutcome, LeaseReport, Phase, REGISTER_PATH, RegisterRequest, RegisterResponse,
    SYNC_PATH, SyncRequest, SyncResponse, TileRecord, Timing, WorkerMetrics, blob_path, picture_path,
};
use proto::{LeaseId, WorkerId};
use serde_json::{Value, json};

use super::{Attack, Attacker, ball};
use crate::jobs;

/// Texts for numbers: extreme, out of range, and not finite.
const NUMBERS: [&str; 14] = [
    "0",
    "-0.0",
    "-1",
    "1e-300",
    "5e-324",
    "1e300",
    "1e999",
    "-1e999",
    "9007199254740993",
    "9223372036854775807",
    "9223372036854775808",
    "18446744073709551615",
    "18446744073709551616",
    "0.1",
];
/// Texts for strings.
const STRINGS: [&str; 6] = [
    r#""""#,
    r#""\u001b]0;x\u0007\n""#,
    r#""../../../../etc/passwd""#,
    r#""00000000-0000-0000-0000-000000000000""#,
    r#""'; DROP TABLE job; --""#,
    "null",
];

pub(super) fn attacks() -> Vec<Attack> {
    vec![
        Attack { name: "hostile values in every field of a sync", run: hostile_syncs },
        Attack { name: "hostile values in every field of a registration", run: hostile_registrations },
        Attack { name: "thousands of workers", run: many_workers },
        Attack { name: "a worker that renews and never delivers", run: holder },
        Attack { name: "a worker that fails every tile", run: failing },
        Attack { name: "workers of one key that fail every tile, and register again", run: accomplices },
        Attack { name: "a worker that delivers something else than pictures", run: liar },
        Attack { name: "a worker that speaks for others", run: impostor },
        Attack { name: "thousands of blobs that no tile asked for", run: blobs },
        Attack { name: "syncs of the largest size", run: large_syncs },
    ]
}

/// Registers a worker.
fn register(attacker: &Attacker<'_>, name: &str) -> Option<WorkerId> {
    let hello = serde_json::to_string(&registration(name)).expect("writable");
    let answer = attacker.send_as(&attacker.worker, "POST", REGISTER_PATH, hello)?;
    serde_json::from_slice::<RegisterResponse>(&answer.body).ok().map(|response| response.worker)
}

fn registration(name: &str) -> RegisterRequest {
    RegisterRequest {
        name: name.to_owned(),
        device: "cpu".to_owned(),
        picture_version: scene::PICTURE_VERSION,
        max_nodes: Some(100),
        process: 1,
    }
}

/// A sync in which every member has a value.
fn full_sync(worker: WorkerId) -> SyncRequest {
    let report = |outcome| LeaseReport { lease: LeaseId::new(), outcome };
    let hash = "0".repeat(64);
    SyncRequest {
        worker,
        rays_per_second: RaysPerSecond::new(1e6),
        held_leases: vec![LeaseId::new()],
        reports: vec![
            report(LeaseOutcome::Blob { hash: hash.clone(), size_bytes: 1 }),
            report(LeaseOutcome::Picture { hash, size_bytes: 1 }),
            report(LeaseOutcome::BadBlobs { tiles: vec![0, 1] }),
            report(LeaseOutcome::Failed { message: "no".to_owned() }),
            report(LeaseOutcome::Released),
        ],
        records: vec![TileRecord { lease: LeaseId::new(), hash: "0".repeat(64), size_bytes: 1, kept: true }],
        wants_work: true,
        beside: true,
        max_batches: 1,
        wait_ms: 1,
        shutting_down: false,
        metrics: WorkerMetrics {
            timings: vec![Timing { phase: Phase::Render, took_ms: 1.0, rays: 1 }],
            memory: Some(DeviceMemory { used_bytes: 1, total_bytes: 2 }),
        },
    }
}

/// Pointers to all numbers and strings of a message.
fn leaves(value: &Value, pointer: &str, found: &mut Vec<String>) {
    match value {
        Value::Object(members) => {
            members.iter().for_each(|(key, value)| leaves(value, &format!("{pointer}/{key}"), found));
        }
        Value::Array(entries) => {
            entries.iter().enumerate().for_each(|(index, entry)| leaves(entry, &format!("{pointer}/{index}"), found));
        }
        Value::Number(_) | Value::String(_) => found.push(pointer.to_owned()),
        Value::Null | Value::Bool(_) => {}
    }
}

/// The message with another text in place of a leaf. Numbers are written as text, since JSON's have no limits.
fn with(message: &Value, pointer: &str, text: &str) -> String {
    const MARK: &str = "\u{e000}hostile";
    let mut message = message.clone();
    *message.pointer_mut(pointer).expect("it was found there") = json!(MARK);
    message.to_string().replace(&format!("\"{MARK}\""), text)
}

/// All messages in which one leaf is hostile.
fn hostile(message: &Value) -> Vec<String> {
    let mut pointers = Vec::new();
    leaves(message, "", &mut pointers);
    assert!(pointers.len() > 3, "{message}");
    let texts = NUMBERS.iter().chain(&STRINGS);
    texts.flat_map(|text| pointers.iter().map(|pointer| with(message, pointer, text))).collect()
}

fn hostile_syncs(attacker: &Attacker<'_>) {
    let Some(worker) = register(attacker, "hostile") else { return };
    let messages = hostile(&serde_json::to_value(full_sync(worker)).expect("writable"));
    attacker.flood(2, |number| {
        let message = &messages[number as usize % messages.len()];
        attacker.send_as(&attacker.worker, "POST", SYNC_PATH, message.clone());
    });
}

fn hostile_registrations(attacker: &Attacker<'_>) {
    let messages = hostile(&serde_json::to_value(registration("hostile")).expect("writable"));
    attacker.flood(2, |number| {
        let message = &messages[number as usize % messages.len()];
        attacker.send_as(&attacker.worker, "POST", REGISTER_PATH, message.clone());
    });
}

fn many_workers(attacker: &Attacker<'_>) {
    attacker.flood(4, |number| {
        register(attacker, &format!("worker {number}"));
    });
}

/// Sends a sync that asks for work, and returns the response.
fn sync(attacker: &Attacker<'_>, request: &SyncRequest) -> Option<SyncResponse> {
    let text = serde_json::to_string(request).expect("writable");
    let answer = attacker.send_as(&attacker.worker, "POST", SYNC_PATH, text)?;
    serde_json::from_slice(&answer.body).ok()
}

fn asking(worker: WorkerId, held_leases: Vec<LeaseId>, reports: Vec<LeaseReport>) -> SyncRequest {
    SyncRequest {
        held_leases,
        reports,
        records: Vec::new(),
        metrics: WorkerMetrics::default(),
        beside: false,
        ..full_sync(worker)
    }
}

fn leases(response: &SyncResponse) -> Vec<LeaseId> {
    match response.batch.as_ref().map(|batch| &batch.work) {
        Some(BatchWork::Render { tiles, .. }) => tiles.iter().map(|tile| tile.lease).collect(),
        Some(BatchWork::Stitch { lease, .. }) => vec![*lease],
        None => Vec::new(),
    }
}

/// Takes all work that it is offered; `answer` says what it reports about each lease.
fn work(attacker: &Attacker<'_>, name: &str, answer: impl Fn(LeaseId) -> Option<LeaseReport>) {
    let Some(worker) = register(attacker, name) else { return };
    let (mut held, mut reports) = (Vec::new(), Vec::new());
    while attacker.goes_on() {
        let Some(response) = sync(attacker, &asking(worker, held.clone(), std::mem::take(&mut reports))) else {
            // Revoked or quarantined: it has nothing more to say.
            std::thread::sleep(Duration::from_millis(50));
            continue;
        };
        for lease in leases(&response) {
            match answer(lease) {
                Some(report) => reports.push(report),
                None => held.push(lease),
            }
        }
        held.retain(|lease| !response.revoked_leases.contains(lease));
    }
}

fn holder(attacker: &Attacker<'_>) {
    work(attacker, "holder", |_| None);
}

fn failing(attacker: &Attacker<'_>) {
    work(attacker, "failing", |lease| {
        Some(LeaseReport { lease, outcome: LeaseOutcome::Failed { message: "\u{1b}[31mno".to_owned() } })
    });
}

fn accomplices(attacker: &Attacker<'_>) {
    attacker.flood(4, |number| {
        let Some(worker) = register(attacker, &format!("accomplice-{number}")) else { return };
        let mut reports = Vec::new();
        for _ in 0..10 {
            let Some(response) = sync(attacker, &asking(worker, Vec::new(), std::mem::take(&mut reports))) else {
                return;
            };
            let failed = |lease| LeaseReport { lease, outcome: LeaseOutcome::Failed { message: "no".to_owned() } };
            reports.extend(leases(&response).into_iter().map(failed));
        }
    });
}

fn liar(attacker: &Attacker<'_>) {
    let page = b"<html><script>alert(1)</script></html>".to_vec();
    let hash = blake3::hash(&page).to_hex().to_string();
    attacker.send_as(&attacker.worker, "PUT", &picture_path(&hash), page.clone());
    attacker.send_as(&attacker.worker, "PUT", &blob_path(&hash), page.clone());
    let sizes = [page.len() as u64, 0, (1 << 53) + 1, u64::MAX];
    let count = std::sync::atomic::AtomicUsize::new(0);
    work(attacker, "liar", |lease| {
        let number = count.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let (hash, size_bytes) = (hash.clone(), sizes[number % sizes.len()]);
        let outcome = if number.is_multiple_of(2) {
            LeaseOutcome::Picture { hash, size_bytes }
        } else {
            LeaseOutcome::Blob { hash, size_bytes }
        };
        Some(LeaseReport { lease, outcome })
    });
}

fn impostor(attacker: &Attacker<'_>) {
    let list = attacker.send("GET", "/v1/workers", "").map(|answer| answer.body).unwrap_or_default();
    let list: Value = serde_json::from_slice(&list).unwrap_or_default();
    let others: Vec<WorkerId> = list["workers"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|worker| worker["id"].as_str()?.parse().ok())
        .collect();
    attacker.flood(4, |number| {
        let Some(&other) = others.get(number as usize % others.len().max(1)) else { return };
        sync(attacker, &SyncRequest { shutting_down: true, ..asking(other, Vec::new(), Vec::new()) });
    });
    attacker.send("GET", "/livez", "");
}

fn blobs(attacker: &Attacker<'_>) {
    attacker.flood(4, |number| {
        let bytes = number.to_le_bytes().repeat(8 << 10);
        let hash = blake3::hash(&bytes).to_hex().to_string();
        attacker.send_as(&attacker.worker, "PUT", &blob_path(&hash), bytes);
    });
}

fn large_syncs(attacker: &Attacker<'_>) {
    let Some(worker) = register(attacker, "large") else { return };
    attacker.submit(&jobs::seeded(&ball(), 1));
    let held: Vec<LeaseId> = (0..9_500).map(|_| LeaseId::new()).collect();
    attacker.flood(4, |_| drop(sync(attacker, &asking(worker, held.clone(), Vec::new()))));
}
