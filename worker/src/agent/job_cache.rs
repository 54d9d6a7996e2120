//! Caches the job files used last, each fetched and parsed once.

use std::collections::VecDeque;
use std::sync::Arc;

use proto::JobId;
use scene::Job;
use tokio::sync::Mutex;

use super::server_client::{ServerClient, ServerError};

/// Number of cached jobs.
const MAX_CACHED_JOBS: usize = 8;

/// The jobs used last, the newest first.
#[derive(Debug, Default)]
pub(super) struct JobCache(Mutex<VecDeque<(JobId, Arc<Job>)>>);

impl JobCache {
    pub(super) async fn get(&self, link: &ServerClient, id: JobId) -> Result<Arc<Job>, JobFetchError> {
        let mut kept = self.0.lock().await;
        if let Some(place) = kept.iter().position(|&(kept, _)| kept == id) {
            let entry = kept.remove(place).expect("it was just found");
            let job = entry.1.clone();
            kept.push_front(entry);
            return Ok(job);
        }
        drop(kept);
        let text = link.job(id).await?;
        let job =
            tokio::task::spawn_blocking(move || scene::parse(&text)).await.map_err(|_| JobFetchError::Panicked)??;
        let job = Arc::new(job);
        let mut kept = self.0.lock().await;
        kept.push_front((id, job.clone()));
        kept.truncate(MAX_CACHED_JOBS);
        Ok(job)
    }
}

/// Error when loading a job.
#[derive(Debug, thiserror::Error)]
pub(super) enum JobFetchError {
    /// It could not be fetched.
    #[error("could not fetch the job: {0}")]
    Server(#[from] ServerError),
    /// The server accepted a job that this worker cannot parse.
    #[error("this worker cannot parse the job: {0}")]
    Refused(#[from] scene::ParseError),
    /// The parser panicked.
    #[error("reading the job panicked")]
    Panicked,
}
