//! Follows a job on a server until it has finished, and fetches its picture.

use std::time::{Duration, Instant};

use anyhow::Context;
use proto::event::JobEvent;
use proto::job::{JobState, JobView};
use proto::{Client, ClientError, JobId};

use crate::output_file::OutputFile;
use crate::progress::Progress;
use crate::terminal::{escape_line, print_note};

const INITIAL_BACK_OFF: Duration = Duration::from_millis(20);
const MAX_BACK_OFF: Duration = Duration::from_millis(500);
/// Time limit for a server that was reachable to return: it may be restarting.
const UNREACHABLE_TIMEOUT: Duration = Duration::from_mins(1);
/// Steps of a progress bar: the server sends a fraction, not a count.
const BAR_STEPS: f64 = 10_000.0;

/// Waits until the job has succeeded; a job that failed or was cancelled is an error.
pub(crate) async fn wait_for_success(client: &Client, id: JobId) -> anyhow::Result<JobView> {
    let job = initial_state(client, id).await?;
    note_pause(client, &job).await;
    let progress = Progress::new(&job.name, BAR_STEPS as u64);
    let job = match JobFollower::new(client, id).until_final(&progress, job).await {
        Err(ClientError::UnexpectedResponse { .. }) => poll(client, id, &progress).await?,
        followed => followed?,
    };
    progress.finish();
    match job.state {
        JobState::Succeeded => Ok(job),
        JobState::Failed => {
            let reason = if job.errors.is_empty() { "the reason is unknown".to_owned() } else { job.errors.join("; ") };
            anyhow::bail!("job {id} failed: {reason}")
        }
        JobState::Cancelled => anyhow::bail!("job {id} was cancelled"),
        JobState::Queued | JobState::Running => unreachable!("following ends at final states"),
    }
}

/// Prints a notice if the job or the farm is paused. A key that may not read the farm's state gets only the job's.
async fn note_pause(client: &Client, job: &JobView) {
    if job.state.is_final() {
        return;
    }
    if job.paused {
        print_note(&format!("job {} is paused: `sdfarm resume {}` continues it", job.id, job.id));
    } else {
        note_farm_pause(client).await;
    }
}

/// Prints a notice if the farm is paused, unless the key may not read the farm's state.
pub(crate) async fn note_farm_pause(client: &Client) {
    if client.farm().await.is_ok_and(|farm| farm.paused) {
        print_note("the farm is paused: `sdfarm resume` continues it");
    }
}

/// First read of the job. It is retried if the server accepted the connection and then vanished, but not if the
/// server was never reached.
async fn initial_state(client: &Client, id: JobId) -> Result<JobView, ClientError> {
    let begun = Instant::now();
    let mut was_there = false;
    loop {
        match client.job(id).await {
            Err(error) if is_unreachable(&error) && begun.elapsed() < UNREACHABLE_TIMEOUT => {
                was_there |= !matches!(error, ClientError::Unreachable { .. });
                if !was_there {
                    return Err(error);
                }
            }
            looked => return looked,
        }
        tokio::time::sleep(MAX_BACK_OFF).await;
    }
}

/// Subscription to events; it reconnects when the server returns.
struct JobFollower<'a> {
    client: &'a Client,
    id: JobId,
    last_id: Option<String>,
    last_event_at: Instant,
}

impl<'a> JobFollower<'a> {
    fn new(client: &'a Client, id: JobId) -> Self {
        Self { client, id, last_id: None, last_event_at: Instant::now() }
    }

    async fn until_final(&mut self, progress: &Progress, mut job: JobView) -> Result<JobView, ClientError> {
        let mut wait = INITIAL_BACK_OFF;
        while !job.state.is_final() {
            match self.listen(progress).await {
                Ok(()) => wait = INITIAL_BACK_OFF,
                Err(error) if is_unreachable(&error) && self.last_event_at.elapsed() < UNREACHABLE_TIMEOUT => {}
                // A proxy or an older server may not support events.
                Err(error) if error.code() == Some("unknown_route") => {
                    return poll(self.client, self.id, progress).await;
                }
                Err(other) => return Err(other),
            }
            match self.client.job(self.id).await {
                Ok(now) => {
                    job = now;
                    self.last_event_at = Instant::now();
                    progress.set((job.progress * BAR_STEPS) as u64);
                }
                Err(error) if is_unreachable(&error) && self.last_event_at.elapsed() < UNREACHABLE_TIMEOUT => {}
                Err(other) => return Err(other),
            }
            if !job.state.is_final() {
                tokio::time::sleep(wait).await;
                wait = (wait * 3 / 2).min(MAX_BACK_OFF);
            }
        }
        Ok(job)
    }

    /// Shows events until the stream ends.
    async fn listen(&mut self, progress: &Progress) -> Result<(), ClientError> {
        let Some(mut events) = self.client.events(self.id, self.last_id.as_deref()).await? else { return Ok(()) };
        loop {
            let event = events.next().await;
            self.last_id = events.last_id().map(ToOwned::to_owned);
            self.last_event_at = Instant::now();
            let share = match event? {
                None => return Ok(()),
                Some(JobEvent::Progress(event)) => event.progress,
                Some(JobEvent::Snapshot(snapshot)) => snapshot.progress,
                Some(JobEvent::State(event)) if event.state == JobState::Succeeded => 1.0,
                Some(JobEvent::State(_) | JobEvent::Tile(_) | JobEvent::Frame(_)) => continue,
            };
            progress.set((share * BAR_STEPS) as u64);
        }
    }
}

fn is_unreachable(error: &ClientError) -> bool {
    matches!(error, ClientError::Unreachable { .. } | ClientError::ConnectionLost { .. })
        || error.code() == Some("closing")
}

/// Polls the job.
async fn poll(client: &Client, id: JobId, progress: &Progress) -> Result<JobView, ClientError> {
    let mut wait = INITIAL_BACK_OFF;
    let mut heard = Instant::now();
    loop {
        match client.job(id).await {
            Ok(job) if job.state.is_final() => return Ok(job),
            Ok(job) => {
                progress.set((job.progress * BAR_STEPS) as u64);
                heard = Instant::now();
            }
            Err(error) if is_unreachable(&error) && heard.elapsed() < UNREACHABLE_TIMEOUT => {}
            Err(other) => return Err(other),
        }
        tokio::time::sleep(wait).await;
        wait = (wait * 3 / 2).min(MAX_BACK_OFF);
    }
}

/// Writes a frame's picture to a file and prints a notice.
pub(crate) async fn fetch(client: &Client, id: JobId, frame: u32, path: &str) -> anyhow::Result<()> {
    let size_bytes = save(client, id, frame, path).await?;
    if path != "-" {
        print_note(&format!("wrote {path}: {size_bytes} bytes"));
    }
    Ok(())
}

/// Writes a frame's picture to a file; returns its size in bytes.
pub(crate) async fn save(client: &Client, id: JobId, frame: u32, path: &str) -> anyhow::Result<u64> {
    let mut output = OutputFile::create(path)?;
    let size_bytes = client
        .image(id, frame, output.file())
        .await
        .with_context(|| format!("could not fetch frame {frame} of job {id}"))?;
    output.commit()?;
    Ok(size_bytes)
}

/// Formats a job's summary as one line.
pub(crate) fn line(job: &JobView) -> String {
    let percent = (job.progress * 100.0).floor();
    let paused = if job.paused { "  (paused)" } else { "" };
    format!(
        "{}  {:<9}  {percent:>3} %  {}  {}{paused}",
        job.id.short(),
        job.state.name(),
        job.created_at,
        escape_line(&job.name)
    )
}
