//! The workers' own protocol, under `/v1/worker/`; not for users.
//!
//! A worker registers, then calls `sync` repeatedly: each call renews all its leases, reports results and
//! requests work. If there is none, the call waits at the server. Bytes (job files, tile blobs, pictures) have
//! routes of their own, keyed by content; pool workers write blobs and pictures directly into the server's
//! folders.

use serde::{Deserialize, Serialize};

use crate::bounded::{self, RaysPerSecond};
use crate::{JobId, LeaseId, Rect, WorkerId};

/// Route of registration: `POST`, [`RegisterRequest`] → [`RegisterResponse`].
pub const REGISTER_PATH: &str = "/v1/worker/register";
/// Route of syncs: `POST`, [`SyncRequest`] → [`SyncResponse`].
pub const SYNC_PATH: &str = "/v1/worker/sync";
/// Environment variable with the token that the pool passes to its workers.
pub const TOKEN_ENV_VAR: &str = "SDFARM_WORKER_TOKEN";
/// Exit code of a worker whose device cannot render: no driver, a defective card, a failed self-test. The pool
/// does not restart such a worker, because the next start would fail too.
pub const EXIT_UNUSABLE_DEVICE: u8 = 3;

/// Route of a job's file: `GET`, the submitted JSON.
pub fn job_path(job: JobId) -> String {
    format!("/v1/worker/jobs/{job}")
}

/// Route of a tile blob, by the BLAKE3 of its bytes in hex: `PUT` and `GET`.
pub fn blob_path(hash: &str) -> String {
    format!("/v1/worker/blobs/{hash}")
}

/// Route of a picture, by the BLAKE3 of its bytes in hex: `PUT`.
pub fn picture_path(hash: &str) -> String {
    format!("/v1/worker/pictures/{hash}")
}

/// Largest scene that a worker on a GPU renders, in nodes.
pub const CUDA_MAX_NODES: u32 = 500;

/// Registration of a worker.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegisterRequest {
    /// Label for display, of at most 200 characters.
    #[serde(deserialize_with = "bounded::label")]
    pub name: String,
    /// Device: `cpu`, or `cuda:0` to `cuda:255`.
    #[serde(deserialize_with = "bounded::device")]
    pub device: String,
    /// Picture version it was built with; the server rejects a different one.
    pub picture_version: u32,
    /// Largest scene that the worker renders, in nodes; `None` for any. The server offers it no larger scene,
    /// but stitches of scenes of any size.
    pub max_nodes: Option<u32>,
    /// Process id, by which the local pool recognizes its workers.
    pub process: u32,
}

/// Response to [`RegisterRequest`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RegisterResponse {
    /// Worker id, valid until the worker exits.
    pub worker: WorkerId,
    /// Length of a lease, in milliseconds. A worker whose syncs fail for two thirds of it stops rendering.
    pub lease_ms: u64,
    /// Folders that a worker on the server's own machine writes to directly; `None` means the routes of
    /// this module.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folders: Option<ContentFolders>,
    /// Maximum number of batches in one response; a worker may request more than one only if this is larger.
    #[serde(default = "one_batch", skip_serializing_if = "is_one_batch")]
    pub max_batches: u32,
    /// Whether the server says that other submitters wait: only then a worker may say that it could work beside.
    #[serde(default, skip_serializing_if = "is_false")]
    pub gives_way: bool,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_false(value: &bool) -> bool {
    !*value
}

/// Maximum number of batches in one response.
pub const MAX_BATCHES: u32 = 8;

fn one_batch() -> u32 {
    1
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_one_batch(batches: &u32) -> bool {
    *batches == 1
}

/// The server's folders, where each file is named by the BLAKE3 of its bytes in hex.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContentFolders {
    /// Folder of tile blobs.
    pub blobs: String,
    /// Folder of pictures: a file in it, and its name, are fsynced before they are reported.
    pub pictures: String,
}

/// Marks the name of a partial file, after its final name.
pub const PARTIAL_MARKER: char = '#';

/// A worker's call: heartbeat, results, and a request for work.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SyncRequest {
    /// Calling worker.
    pub worker: WorkerId,
    /// Measured camera rays a second; `None` before the first tile.
    pub rays_per_second: Option<RaysPerSecond>,
    /// Leases that the worker still works on; all are renewed.
    pub held_leases: Vec<LeaseId>,
    /// Results of leases that have finished.
    pub reports: Vec<LeaseReport>,
    /// Records of the tiles among those results, if their job asks for them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub records: Vec<TileRecord>,
    /// Whether the worker requests a batch.
    pub wants_work: bool,
    /// Maximum number of batches that it requests; more than [`RegisterResponse::max_batches`] are taken as that.
    #[serde(default = "one_batch", skip_serializing_if = "is_one_batch")]
    pub max_batches: u32,
    /// The worker has rendered one batch for long, and could render another beside it: the server says whether a submitter
    /// waits of whom the worker holds nothing, and grants no other work.
    #[serde(default, skip_serializing_if = "is_false")]
    pub beside: bool,
    /// How long the server may wait before it responds, in milliseconds; longer than 30 s, or than a third of a
    /// lease, is taken as that.
    pub wait_ms: u64,
    /// The worker is shutting down: the leases it holds, and any granted in a lost response, are
    /// released.
    #[serde(default)]
    pub shutting_down: bool,
    /// Measurements since its last call, for the server's metrics; no decision depends on them.
    #[serde(default)]
    pub metrics: WorkerMetrics,
}

/// Maximum number of [`Timing`]s in one call; the excess is dropped.
pub const MAX_TIMINGS: usize = 1000;
/// Maximum number of camera rays of one [`Timing`]: the largest job's.
pub const MAX_TIMING_RAYS: u64 = 1 << 44;
/// Maximum size of a device's memory, in bytes.
pub const MAX_MEMORY_BYTES: u64 = 1 << 50;
/// Maximum size of a blob, in bytes; the pixels of a tile are at most half of it.
pub const MAX_BLOB_BYTES: u64 = 128 << 20;
/// Maximum size of a tile's record, in bytes.
pub const MAX_RECORD_BYTES: u64 = 64 << 20;
/// Maximum size of a picture, in bytes.
pub const MAX_PICTURE_BYTES: u64 = 16 << 30;

/// Measurements of a worker since its last call.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkerMetrics {
    /// Durations of phases.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub timings: Vec<Timing>,
    /// The memory of its device, if that is not the machine's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<DeviceMemory>,
}

/// Duration of one phase.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timing {
    /// Phase.
    pub phase: Phase,
    /// Duration, in milliseconds; negative ones, and ones above 10⁹, are dropped.
    pub took_ms: f64,
    /// Camera rays rendered; 0 for all phases but rendering.
    #[serde(default, deserialize_with = "bounded::at_most::<MAX_TIMING_RAYS, _>")]
    pub rays: u64,
}

/// Phase of a worker's work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Rendering tiles.
    Render,
    /// Encoding a picture.
    Encode,
    /// Sending a blob or a picture to the server.
    Deliver,
}

/// Memory of a device that does not share the host's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceMemory {
    /// Bytes used by all processes.
    #[serde(deserialize_with = "bounded::at_most::<MAX_MEMORY_BYTES, _>")]
    pub used_bytes: u64,
    /// Total bytes.
    #[serde(deserialize_with = "bounded::at_most::<MAX_MEMORY_BYTES, _>")]
    pub total_bytes: u64,
}

/// Report on one lease.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeaseReport {
    /// The lease.
    pub lease: LeaseId,
    /// Outcome.
    pub outcome: LeaseOutcome,
}

/// Record of what the rays of a finished tile asked for, by which a later job finds whether it has the same pixels.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TileRecord {
    /// Lease of the tile.
    pub lease: LeaseId,
    /// BLAKE3 of the record, which is stored like a blob, in hex.
    pub hash: String,
    /// Its size.
    #[serde(deserialize_with = "bounded::at_most::<MAX_RECORD_BYTES, _>")]
    pub size_bytes: u64,
    /// Whether the pixels come from the earlier job, and nothing was rendered.
    #[serde(default)]
    pub kept: bool,
}

/// Outcome of one lease.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum LeaseOutcome {
    /// The tile's pixels were stored as a blob.
    Blob {
        /// BLAKE3 of the blob, in hex.
        hash: String,
        /// Its size.
        #[serde(deserialize_with = "bounded::at_most::<MAX_BLOB_BYTES, _>")]
        size_bytes: u64,
    },
    /// The whole frame's picture was stored; reported for each of the frame's tiles, or for its stitch.
    Picture {
        /// BLAKE3 of the picture, in hex.
        hash: String,
        /// Its size.
        #[serde(deserialize_with = "bounded::at_most::<MAX_PICTURE_BYTES, _>")]
        size_bytes: u64,
    },
    /// Blobs of these tiles, by index in the frame, are missing or damaged, so the frame cannot be stitched.
    BadBlobs {
        /// The tiles' indices.
        tiles: Vec<u32>,
    },
    /// The renderer failed.
    Failed {
        /// Error message.
        message: String,
    },
    /// Released without a result: the worker is shutting down.
    Released,
}

/// Response to [`SyncRequest`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SyncResponse {
    /// Work, if it was requested and there was some.
    pub batch: Option<Batch>,
    /// Leases of `held_leases` and `reports` that have ended: the worker stops their work and drops their
    /// results.
    pub revoked_leases: Vec<LeaseId>,
    /// The worker should finish its leases, then exit.
    pub drain: bool,
    /// Trace of the batch: a W3C `traceparent`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trace: Option<String>,
    /// Further batches, if more than one was requested.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub more: Vec<TracedBatch>,
    /// A submitter waits of whom the worker holds nothing, and no other worker is free; said to a worker that could work
    /// beside.
    #[serde(default, skip_serializing_if = "is_false")]
    pub others_wait: bool,
}

/// Batch with its trace.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TracedBatch {
    /// Batch.
    pub batch: Batch,
    /// Its trace: a W3C `traceparent`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trace: Option<String>,
}

/// Work of one frame, leased together.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Batch {
    /// The job.
    pub job: JobId,
    /// The frame, from 0.
    pub frame: u32,
    /// Time limit for rendering a tile, in seconds: above it, the worker stops and reports the tile as failed.
    /// `None` means no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tile_seconds: Option<u32>,
    /// Work of the batch.
    pub work: BatchWork,
    /// Earlier tiles, and that these are recorded, if that is wanted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<Recording>,
}

impl Batch {
    /// Its leases, each with the index of its tile in the frame; `None` for a stitch.
    pub fn leases(&self) -> impl Iterator<Item = (LeaseId, Option<u32>)> {
        let leases: Vec<_> = match &self.work {
            BatchWork::Render { tiles, .. } => tiles.iter().map(|tile| (tile.lease, Some(tile.index))).collect(),
            BatchWork::Stitch { lease, .. } => vec![(*lease, None)],
        };
        leases.into_iter()
    }
}

/// Work that a batch asks for.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BatchWork {
    /// Render tiles.
    Render {
        /// The tiles.
        tiles: Vec<LeasedTile>,
        /// True if these are all tiles of a small frame: the worker delivers the picture instead of blobs.
        whole_frame: bool,
    },
    /// Stitch the frame's picture from its tiles' blobs.
    Stitch {
        /// Lease of the stitch.
        lease: LeaseId,
        /// The tiles.
        inputs: Vec<StitchInput>,
    },
}

/// How the tiles of a batch are recorded.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Recording {
    /// The same frame of an earlier job: tiles that the differences of the two jobs can't reach keep its pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub earlier: Option<EarlierFrame>,
}

/// A recorded frame of an earlier job.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct EarlierFrame {
    /// The job.
    pub job: JobId,
    /// Its tiles that are in the batch, too.
    pub tiles: Vec<EarlierTile>,
}

/// A recorded tile of an earlier job.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct EarlierTile {
    /// Its pixels.
    pub pixels: StitchInput,
    /// BLAKE3 of its record, in hex.
    pub record: String,
    /// The record's size.
    pub record_bytes: u64,
}

/// A tile to render.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct LeasedTile {
    /// Lease of the tile.
    pub lease: LeaseId,
    /// Its index in the frame.
    pub index: u32,
    /// Its pixels.
    pub rect: Rect,
}

/// A finished tile to stitch.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StitchInput {
    /// Its index in the frame.
    pub index: u32,
    /// Its pixels.
    pub rect: Rect,
    /// BLAKE3 of its blob, in hex.
    pub hash: String,
    /// The blob's size.
    pub size_bytes: u64,
}
