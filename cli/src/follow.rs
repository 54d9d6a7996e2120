//! Following a job on a server until nothing will change any more, and fetching its picture.

use std::time::{Duration, Instant};

use anyhow::Context;
use proto::job::{JobState, JobView};
use proto::{Client, ClientError, JobId};

use crate::output_file::OutputFile;
use crate::progress::Progress;
use crate::terminal::note;

const FIRST_WAIT: Duration = Duration::from_millis(20);
const LONGEST_WAIT: Duration = Duration::from_millis(500);
/// A server that was there may be away for so long: it restarts.
const PATIENCE: Duration = Duration::from_mins(1);
/// Steps of a progress bar: the server tells a share, not a count.
const STEPS: f64 = 10_000.0;

/// Waits until the job has succeeded; a job that failed or was cancelled is an error.
pub(crate) async fn until_done(client: &Client, id: JobId) -> anyhow::Result<JobView> {
    let mut job = client.job(id).await?;
    let progress = Progress::new(&job.name, STEPS as u64);
    let mut wait = FIRST_WAIT;
    let mut seen = Instant::now();
    while !job.state.is_final() {
        progress.set((job.progress * STEPS) as u64);
        tokio::time::sleep(wait).await;
        wait = (wait * 3 / 2).min(LONGEST_WAIT);
        match client.job(id).await {
            Ok(now) => {
                job = now;
                seen = Instant::now();
            }
            Err(ClientError::Unreachable { .. } | ClientError::Broken { .. }) if seen.elapsed() < PATIENCE => {}
            Err(other) => return Err(other.into()),
        }
    }
    progress.finish();
    match job.state {
        JobState::Succeeded => Ok(job),
        JobState::Failed => {
            let reason = if job.errors.is_empty() { "no reason is known".to_owned() } else { job.errors.join("; ") };
            anyhow::bail!("job {id} failed: {reason}")
        }
        JobState::Cancelled => anyhow::bail!("job {id} was cancelled"),
        JobState::Queued | JobState::Running => unreachable!("the loop ends at final states"),
    }
}

/// Writes a frame's picture to a file.
pub(crate) async fn fetch(client: &Client, id: JobId, frame: u32, path: &str) -> anyhow::Result<()> {
    let mut output = OutputFile::create(path)?;
    let size_bytes = client.image(id, frame, output.file()).await.with_context(|| {
        format!("could not fetch frame {frame} of job {id}: see how it stands with `sdfarm watch {id}`")
    })?;
    output.commit()?;
    if path != "-" {
        note(&format!("wrote {path}: {size_bytes} bytes"));
    }
    Ok(())
}

/// What there is to say of a job in one line.
pub(crate) fn line(job: &JobView) -> String {
    let percent = (job.progress * 100.0).floor();
    format!("{}  {:<9}  {percent:>3} %  {}  {}", job.id, job.state.name(), job.created_at, job.name)
}
