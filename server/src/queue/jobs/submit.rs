//! Accepts a job: one row and its file. Frames and tiles are created later, when each frame is opened.

use proto::{JobId, Retention};

use crate::db;
use crate::queue::jobs::{retention, transitions};
use crate::queue::{Connection, Result, TransitionContext};
use crate::tile_plan::TilePlan;

/// Job that passed validation.
#[derive(Clone, Debug)]
pub(crate) struct NewJob {
    /// Its id.
    pub(crate) id: JobId,
    /// Name from the job file.
    pub(crate) name: String,
    /// Submitter: a key's name, or `local` without keys. Fair share is computed by submitter.
    pub(crate) submitter: String,
    /// Jobs of higher priority are leased first.
    pub(crate) priority: i32,
    /// Number of nodes of its scene; 0 if unknown.
    pub(crate) nodes: u32,
    /// Tile plan of its frames.
    pub(crate) plan: TilePlan,
    /// Media type of its pictures.
    pub(crate) media_type: &'static str,
    /// Warnings for the author; the job renders all the same.
    pub(crate) warnings: Vec<String>,
    /// Render it even if its pictures are stored.
    pub(crate) no_cache: bool,
    /// Retention; `None` means the server's default.
    pub(crate) retention: Option<Retention>,
    /// Time limit for rendering a tile, in seconds.
    pub(crate) tile_seconds: u32,
    /// Keep its tiles, with records of what their rays asked for.
    pub(crate) recorded: bool,
    /// A recorded job, whose pixels it keeps where they can't differ; it is recorded, too.
    pub(crate) based_on: Option<JobId>,
    /// Submitted bytes.
    pub(crate) file_text: String,
}

impl NewJob {
    /// Job of these tiles that ignores the picture cache, without a scene.
    pub(crate) fn of_plan(submitter: &str, plan: TilePlan) -> Self {
        Self {
            id: JobId::new(),
            name: String::new(),
            submitter: submitter.to_owned(),
            priority: 0,
            nodes: 1,
            plan,
            media_type: "image/png",
            warnings: Vec::new(),
            no_cache: true,
            retention: None,
            tile_seconds: 600,
            recorded: false,
            based_on: None,
            file_text: "{}".to_owned(),
        }
    }

    /// Job of one tile.
    #[cfg(test)]
    pub(crate) fn example() -> Self {
        let plan = TilePlan { width_px: 64, height_px: 64, samples: 1, pixel_bytes: 16, edge_px: Some(64), frames: 1 };
        Self { name: "example".to_owned(), ..Self::of_plan("local", plan) }
    }
}

/// Inserts a job's row and its file; returns its number.
pub(in crate::queue) async fn submit(
    connection: &mut Connection,
    job: &NewJob,
    context: TransitionContext,
) -> Result<i64> {
    let number = transitions::insert(connection, job, context).await?;
    db::query("INSERT INTO job_file (job, text) VALUES (?, ?)")
        .bind(number)
        .bind(&job.file_text)
        .execute(&mut *connection)
        .await?;
    if let Some(keep) = job.retention {
        retention::keep(connection, number, keep).await?;
    }
    Ok(number)
}
