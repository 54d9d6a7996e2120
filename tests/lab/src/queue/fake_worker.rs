//! Worker that follows the worker protocol but renders nothing: its tiles and pictures are black.

use std::io::Cursor;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use anyhow::Context;
use proto::worker_protocol::{self, Batch, BatchWork, LeaseOutcome, LeaseReport, RegisterRequest};
use proto::{JobId, LeaseId, Rect, WorkerId};
use scene::Job;
use serde_json::json;
use worker::image::PictureSpec;
use worker::stitch::TileRows;
use worker::{CancelFlag, TilePixels, blob};

/// Registered worker that renders nothing.
pub(super) struct FakeWorker {
    http: reqwest::Client,
    server: String,
    id: WorkerId,
    rays_per_second: Option<f64>,
    /// The job of the last batch.
    job: Mutex<Option<(JobId, Arc<Job>)>>,
}

impl FakeWorker {
    /// Registers a worker.
    pub(super) async fn register(server: &str, rays_per_second: Option<f64>) -> anyhow::Result<Self> {
        let http = reqwest::Client::builder().build().context("could not create a client")?;
        let hello = RegisterRequest {
            name: "bench".to_owned(),
            device: "cpu".to_owned(),
            picture_version: scene::PICTURE_VERSION,
            max_nodes: None,
            process: std::process::id(),
        };
        let answer = http.post(format!("{server}{}", worker_protocol::REGISTER_PATH)).json(&hello).send().await?;
        let welcome: worker_protocol::RegisterResponse = answer.error_for_status()?.json().await?;
        Ok(Self { http, server: server.to_owned(), id: welcome.worker, rays_per_second, job: Mutex::default() })
    }

    /// Syncs once: sends results, and receives work.
    pub(super) async fn sync(
        &self,
        results: Vec<LeaseReport>,
        wants_work: bool,
        wait: Duration,
    ) -> anyhow::Result<Option<Batch>> {
        self.send(Vec::new(), results, wants_work, wait).await
    }

    /// Renews the leases of a batch.
    pub(super) async fn renew(&self, batch: Option<&Batch>) -> anyhow::Result<()> {
        let held = batch.into_iter().flat_map(Batch::leases).map(|(lease, _)| lease).collect();
        self.send(held, Vec::new(), false, Duration::ZERO).await.map(drop)
    }

    async fn send(
        &self,
        held: Vec<LeaseId>,
        results: Vec<LeaseReport>,
        wants_work: bool,
        wait: Duration,
    ) -> anyhow::Result<Option<Batch>> {
        let request = json!({
            "worker": self.id,
            "rays_per_second": self.rays_per_second,
            "held_leases": held,
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
    pub(super) async fn results(&self, run: &Batch) -> anyhow::Result<Vec<LeaseReport>> {
        let job = self.job(run.job).await?;
        match &run.work {
            BatchWork::Render { tiles, whole_frame: false } => {
                let mut reports = Vec::with_capacity(tiles.len());
                for tile in tiles {
                    let bytes = blob::encode(&black(&job, tile.rect));
                    let (hash, size_bytes) = self.put(worker_protocol::blob_path, bytes).await?;
                    reports.push(LeaseReport { lease: tile.lease, outcome: LeaseOutcome::Blob { hash, size_bytes } });
                }
                Ok(reports)
            }
            BatchWork::Render { whole_frame: true, .. } | BatchWork::Stitch { .. } => {
                self.picture(&job, run.frame, run.leases().map(|(lease, _)| lease)).await
            }
        }
    }

    async fn job(&self, id: JobId) -> anyhow::Result<Arc<Job>> {
        let known = self.job.lock().expect("no holder panics").clone();
        if let Some((_, job)) = known.filter(|(known, _)| *known == id) {
            return Ok(job);
        }
        let answer = self.http.get(format!("{}{}", self.server, worker_protocol::job_path(id))).send().await?;
        let job = Arc::new(scene::parse(&answer.error_for_status()?.bytes().await?)?);
        *self.job.lock().expect("no holder panics") = Some((id, Arc::clone(&job)));
        Ok(job)
    }

    async fn picture(
        &self,
        job: &Job,
        frame: u32,
        leases: impl IntoIterator<Item = LeaseId>,
    ) -> anyhow::Result<Vec<LeaseReport>> {
        let picture = PictureSpec::new(&job.at(frame)?);
        let pixels = [black(job, Rect::full(picture.width, picture.height))];
        let mut file = Cursor::new(Vec::new());
        picture.write(&mut TileRows(&pixels), &mut file, &CancelFlag::new())?;
        let (hash, size_bytes) = self.put(worker_protocol::picture_path, file.into_inner()).await?;
        let outcome = LeaseOutcome::Picture { hash, size_bytes };
        Ok(leases.into_iter().map(|lease| LeaseReport { lease, outcome: outcome.clone() }).collect())
    }

    /// Stores bytes; returns their hash and their size.
    async fn put(&self, path: fn(&str) -> String, bytes: Vec<u8>) -> anyhow::Result<(String, u64)> {
        let (hash, size_bytes) = (blob::hash(&bytes), bytes.len() as u64);
        self.http.put(format!("{}{}", self.server, path(&hash))).body(bytes).send().await?.error_for_status()?;
        Ok((hash, size_bytes))
    }
}

fn black(job: &Job, rect: Rect) -> TilePixels {
    let plane = vec![0.0; rect.pixels() as usize];
    TilePixels { rect, planes: vec![plane; job.image.film().rendered_channels().len()] }
}
