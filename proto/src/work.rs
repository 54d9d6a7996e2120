//! The workers' own protocol, under `/v1/worker/`; not for users.
//!
//! A worker registers, then calls `sync` again and again: each call renews all its
//! leases, hands in results and asks for work, and waits at the server while there is none.
//! Bytes (job files, tile blobs, pictures) travel by routes of their own, keyed by content; workers of the server's pool put
//! blobs and pictures into its folders by themselves.

use serde::{Deserialize, Serialize};

use crate::{JobId, LeaseId, Rect, WorkerId};

/// Where a worker registers: `POST`, [`Hello`] → [`Welcome`].
pub const REGISTER: &str = "/v1/worker/register";
/// Where a worker syncs: `POST`, [`SyncRequest`] → [`SyncReply`].
pub const SYNC: &str = "/v1/worker/sync";
/// Environment variable through which the pool hands its children their token.
pub const TOKEN_VARIABLE: &str = "SDFARM_WORKER_TOKEN";
/// Exit code of a worker whose device can't render: no driver, a bad card, a failed self-test. Starting it
/// again would not help, so the pool does not.
pub const UNFIT_DEVICE: u8 = 3;

/// Where a job's file is read: `GET`, the JSON that was posted.
pub fn job_path(job: JobId) -> String {
    format!("/v1/worker/jobs/{job}")
}

/// Where a tile blob is put and got, by the BLAKE3 of its bytes in hex.
pub fn blob_path(hash: &str) -> String {
    format!("/v1/worker/blobs/{hash}")
}

/// Where a picture is put, by the BLAKE3 of its bytes in hex.
pub fn picture_path(hash: &str) -> String {
    format!("/v1/worker/pictures/{hash}")
}

/// What a worker says when it starts.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hello {
    /// A label for people.
    pub name: String,
    /// What it renders on: `cpu` or `cuda:0`.
    pub device: String,
    /// The definition of a picture it was built with; a server refuses another.
    pub picture_version: u32,
    /// Largest scene it renders, in nodes; `None` for any. It is offered no larger one, but stitches of any.
    pub max_nodes: Option<u32>,
    /// Process id, which the local pool knows its children by.
    pub process: u32,
}

/// The answer to [`Hello`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Welcome {
    /// The worker's id until it ends.
    pub worker: WorkerId,
    /// Length of a lease, in milliseconds. A worker that could not sync for two thirds of it stops rendering.
    pub lease_ms: u64,
    /// Where a worker on the server's own machine puts and gets bytes by itself; `None`: by the routes of this module.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folders: Option<Folders>,
}

/// A server's folders, in which each file is named by the BLAKE3 of its bytes in hex.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Folders {
    /// Of tile blobs.
    pub blobs: String,
    /// Of pictures: a file in it, and its name, are flushed to the disk before they are reported.
    pub pictures: String,
}

/// What stands in the name of a file that is not whole yet, after the name it will have.
pub const HALF_DONE: char = '#';

/// One call does it all: heartbeat, results, and the wish for more.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SyncRequest {
    /// Who asks.
    pub worker: WorkerId,
    /// Measured camera rays a second; `None` before the first tile.
    pub rays_per_second: Option<f64>,
    /// Leases it holds and still works on; all are renewed.
    pub holding: Vec<LeaseId>,
    /// Leases it has finished with.
    pub results: Vec<Report>,
    /// Whether it wants a run.
    pub wants_work: bool,
    /// How long the server may wait for something to say, in milliseconds.
    pub wait_ms: u64,
    /// It ends now: whatever it still holds, or was given in an answer it never heard, is handed back.
    #[serde(default)]
    pub leaving: bool,
    /// What it has measured since its last call, for the server's metrics; nothing is decided by it.
    #[serde(default)]
    pub measured: Measured,
}

/// Most [`Timing`]s that one call brings; what is more is forgotten.
pub const MAX_TIMINGS: usize = 1000;

/// What a worker has measured since its last call.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// How long things took.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub timings: Vec<Timing>,
    /// The memory of its device, if that is not the machine's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<DeviceMemory>,
}

/// How long one thing took.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timing {
    /// What was done.
    pub phase: Phase,
    /// How long it took, in milliseconds.
    pub took_ms: f64,
    /// Camera rays that were rendered; 0 of everything else.
    #[serde(default)]
    pub rays: u64,
}

/// A part of a worker's work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Rendering tiles.
    Render,
    /// Making a file of a picture.
    Encode,
    /// Bringing a blob or a picture to the server.
    Deliver,
}

/// Memory of a device that has its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceMemory {
    /// In use, by anyone.
    pub used_bytes: u64,
    /// There is.
    pub total_bytes: u64,
}

/// What became of one lease.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// The lease.
    pub lease: LeaseId,
    /// What became of it.
    pub outcome: Outcome,
}

/// What became of one lease.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Outcome {
    /// The tile's pixels were put as a blob.
    Blob {
        /// BLAKE3 of the blob, in hex.
        hash: String,
        /// Its size.
        size_bytes: u64,
    },
    /// The whole frame's picture was put; said for each of the frame's tiles, or for its stitch.
    Picture {
        /// BLAKE3 of the picture, in hex.
        hash: String,
        /// Its size.
        size_bytes: u64,
    },
    /// Blobs of these tiles, by index in the frame, are missing or damaged: the stitch can't be done.
    BadBlobs {
        /// The tiles' indices.
        tiles: Vec<u32>,
    },
    /// The renderer said no.
    Failed {
        /// Why, in words.
        message: String,
    },
    /// Handed back unrendered: the worker is ending.
    HandedBack,
}

/// The answer to [`SyncRequest`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SyncReply {
    /// Work to do, if any was wanted and there was some.
    pub run: Option<Run>,
    /// Leases of `holding` and `results` that are no longer live: stop, and drop what was made.
    pub lost: Vec<LeaseId>,
    /// Finish what is held, then exit.
    pub drain: bool,
    /// Which trace the run belongs to: a W3C `traceparent`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trace: Option<String>,
}

/// Work of one frame, leased together.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Run {
    /// The job.
    pub job: JobId,
    /// The frame, from 0.
    pub frame: u32,
    /// What to do.
    pub work: Work,
}

/// What a run asks for.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Work {
    /// Render tiles.
    Render {
        /// The tiles.
        tiles: Vec<LeasedTile>,
        /// They are all of the frame, and small enough: deliver the picture instead of blobs.
        whole_frame: bool,
    },
    /// Make the frame's picture from its tiles' blobs.
    Stitch {
        /// The hold on the stitch.
        lease: LeaseId,
        /// The tiles.
        parts: Vec<Part>,
    },
}

/// A tile to render.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct LeasedTile {
    /// The hold on it.
    pub lease: LeaseId,
    /// Its index in the frame.
    pub index: u32,
    /// Its pixels.
    pub rect: Rect,
}

/// A finished tile to stitch.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Part {
    /// Its index in the frame.
    pub index: u32,
    /// Its pixels.
    pub rect: Rect,
    /// BLAKE3 of its blob, in hex.
    pub hash: String,
    /// The blob's size.
    pub size_bytes: u64,
}
