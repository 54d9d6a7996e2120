//! A worker that speaks the workers' protocol and renders nothing.

use std::time::Duration;

use anyhow::Context;
use proto::work::{self, Hello, Outcome, Report, Run, Work};
use proto::{LeaseId, WorkerId};
use serde_json::json;

/// What every tile of it looks like.
const PIXELS: &[u8] = b"the pixels of a tile that was never rendered";

/// The worker.
pub(super) struct Pretender {
    http: reqwest::Client,
    server: String,
    id: WorkerId,
    hash: String,
    rays_per_second: Option<f64>,
}

impl Pretender {
    /// Registers, and brings the one blob that all its tiles are.
    pub(super) async fn register(server: &str, rays_per_second: Option<f64>) -> anyhow::Result<Self> {
        let http = reqwest::Client::builder().build().context("could not make a client")?;
        let hello = Hello {
            name: "bench".to_owned(),
            device: "none".to_owned(),
            picture_version: scene::PICTURE_VERSION,
            max_nodes: None,
            process: std::process::id(),
        };
        let answer = http.post(format!("{server}{}", work::REGISTER)).json(&hello).send().await?;
        let welcome: work::Welcome = answer.error_for_status()?.json().await?;
        let hash = blake3::hash(PIXELS).to_hex().to_string();
        for path in [work::blob_path(&hash), work::picture_path(&hash)] {
            http.put(format!("{server}{path}")).body(PIXELS).send().await?.error_for_status()?;
        }
        Ok(Self { http, server: server.to_owned(), id: welcome.worker, hash, rays_per_second })
    }

    /// One call: results in, work out.
    pub(super) async fn sync(
        &self,
        results: Vec<Report>,
        wants_work: bool,
        wait: Duration,
    ) -> anyhow::Result<Option<Run>> {
        let request = json!({
            "worker": self.id,
            "rays_per_second": self.rays_per_second,
            "holding": [],
            "results": results,
            "wants_work": wants_work,
            "wait_ms": wait.as_millis() as u64,
        });
        let answer = self.http.post(format!("{}{}", self.server, work::SYNC)).json(&request).send().await?;
        let reply: work::SyncReply = answer.error_for_status()?.json().await?;
        Ok(reply.run)
    }

    /// The results of a run, as a good worker brings them.
    pub(super) fn results(&self, run: &Run) -> Vec<Report> {
        let (hash, size_bytes) = (self.hash.clone(), PIXELS.len() as u64);
        let (leases, picture): (Vec<LeaseId>, bool) = match &run.work {
            Work::Render { tiles, whole_frame } => (tiles.iter().map(|tile| tile.lease).collect(), *whole_frame),
            Work::Stitch { lease, .. } => (vec![*lease], true),
        };
        let outcome = if picture { Outcome::Picture { hash, size_bytes } } else { Outcome::Blob { hash, size_bytes } };
        leases.into_iter().map(|lease| Report { lease, outcome: outcome.clone() }).collect()
    }
}
