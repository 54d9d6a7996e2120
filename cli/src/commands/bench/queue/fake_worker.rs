//! Worker that follows the worker protocol but renders nothing.

use std::time::Duration;

use anyhow::Context;
use proto::worker_protocol::{self, Batch, BatchWork, LeaseOutcome, LeaseReport, RegisterRequest};
use proto::{LeaseId, WorkerId};
use serde_json::json;

/// Registered worker that renders nothing.
pub(super) struct FakeWorker {
    http: reqwest::Client,
    server: String,
    id: WorkerId,
    rays_per_second: Option<f64>,
}

impl FakeWorker {
    /// Registers a worker.
    pub(super) async fn register(server: &str, rays_per_second: Option<f64>) -> anyhow::Result<Self> {
        let http = reqwest::Client::builder().build().context("could not create a client")?;
        let hello = RegisterRequest {
            name: "bench".to_owned(),
            device: "none".to_owned(),
            picture_version: scene::PICTURE_VERSION,
            max_nodes: None,
            process: std::process::id(),
        };
        let answer = http.post(format!("{server}{}", worker_protocol::REGISTER_PATH)).json(&hello).send().await?;
        let welcome: worker_protocol::RegisterResponse = answer.error_for_status()?.json().await?;
        Ok(Self { http, server: server.to_owned(), id: welcome.worker, rays_per_second })
    }

    /// Syncs once: sends results, and receives work.
    pub(super) async fn sync(
        &self,
        results: Vec<LeaseReport>,
        wants_work: bool,
        wait: Duration,
    ) -> anyhow::Result<Option<Batch>> {
        let request = json!({
            "worker": self.id,
            "rays_per_second": self.rays_per_second,
            "held_leases": [],
            "reports": results,
            "wants_work": wants_work,
            "wait_ms": wait.as_millis() as u64,
        });
        let answer =
            self.http.post(format!("{}{}", self.server, worker_protocol::SYNC_PATH)).json(&request).send().await?;
        let reply: worker_protocol::SyncResponse = answer.error_for_status()?.json().await?;
        Ok(reply.batch)
    }

    /// Reports of a batch in the order of a real worker: its bytes are stored before they are reported.
    /// All tiles of a batch have the same bytes, different from every other batch; all pictures are the
    /// same.
    pub(super) async fn results(&self, run: &Batch) -> anyhow::Result<Vec<LeaseReport>> {
        let (leases, picture): (Vec<LeaseId>, bool) = match &run.work {
            BatchWork::Render { tiles, whole_frame } => (tiles.iter().map(|tile| tile.lease).collect(), *whole_frame),
            BatchWork::Stitch { lease, .. } => (vec![*lease], true),
        };
        let bytes = if picture { "no picture".to_owned() } else { format!("no pixels for {leases:?}") };
        let (hash, size_bytes) = (blake3::hash(bytes.as_bytes()).to_hex().to_string(), bytes.len() as u64);
        let path = if picture { worker_protocol::picture_path(&hash) } else { worker_protocol::blob_path(&hash) };
        self.http.put(format!("{}{path}", self.server)).body(bytes).send().await?.error_for_status()?;
        let outcome =
            if picture { LeaseOutcome::Picture { hash, size_bytes } } else { LeaseOutcome::Blob { hash, size_bytes } };
        Ok(leases.into_iter().map(|lease| LeaseReport { lease, outcome: outcome.clone() }).collect())
    }
}
