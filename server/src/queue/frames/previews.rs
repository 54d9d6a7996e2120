//! Data for previews and estimates: a frame's finished tiles, and the current workers. Only reads.

use crate::db;
use proto::JobId;
use proto::job::JobState;

use crate::queue::jobs::finish;
use crate::queue::{Queue, Result};

/// Content of a frame so far.
#[derive(Clone, Debug)]
pub(crate) enum FrameContents {
    /// Its picture is stored under this hash.
    Stored {
        /// BLAKE3 of its bytes, in hex.
        hash: String,
        /// Its size.
        size_bytes: u64,
    },
    /// Some of its tiles may be finished.
    Unfinished {
        /// The state of its job.
        state: JobState,
        /// Hashes of the finished tiles' blobs.
        blobs: Vec<String>,
    },
    /// The job has fewer frames.
    NoFrame(u32),
    /// The job does not exist.
    NoJob,
}

/// Ready worker, as an estimate counts it.
#[derive(Clone, Debug)]
pub(crate) struct ReadyWorker {
    /// `cpu` or `cuda:0`.
    pub(crate) device: String,
    /// Whether it is a child process of this server.
    pub(crate) pool: bool,
    /// Its measured camera rays per second, over all scenes it rendered lately.
    pub(crate) rays_per_second: Option<f64>,
}

impl Queue {
    /// Reads the content of a frame.
    pub(crate) async fn frame_contents(&self, id: JobId, frame: u32) -> Result<FrameContents> {
        let row = db::query(
            "SELECT job.number, job.state, job.frames_total, frame.picture, frame.size_bytes
             FROM job LEFT JOIN frame ON frame.job = job.number AND frame.number = ? WHERE job.id = ?",
        )
        .bind(frame)
        .bind(id.to_string())
        .fetch_optional(self.readers())
        .await?;
        let Some(row) = row else { return Ok(FrameContents::NoJob) };
        let frames: u32 = row.get("frames_total")?;
        if frame >= frames {
            return Ok(FrameContents::NoFrame(frames));
        }
        if let Some(hash) = row.get("picture")? {
            return Ok(FrameContents::Stored { hash, size_bytes: row.get("size_bytes")? });
        }
        let blobs = db::query_scalar(
            "SELECT blob FROM tile WHERE job = ? AND frame = ? AND blob IS NOT NULL ORDER BY position",
        )
        .bind(row.get::<i64>("number")?)
        .bind(frame)
        .fetch_all(self.readers())
        .await?;
        Ok(FrameContents::Unfinished { state: finish::job_state(&row.get::<String>("state")?)?, blobs })
    }

    /// Ready workers.
    pub(crate) async fn ready_workers(&self) -> Result<Vec<ReadyWorker>> {
        let rows = db::query(
            "SELECT device, pool, rays_per_second FROM worker WHERE state <> 'gone' AND state IN ('starting', 'ready')",
        )
        .fetch_all(self.readers())
        .await?;
        let present = rows.iter().map(|row| {
            Ok(ReadyWorker {
                device: row.get("device")?,
                pool: row.get("pool")?,
                rays_per_second: row.get("rays_per_second")?,
            })
        });
        present.collect()
    }
}
