//! A batch's use of the device: from the first render until the last one leaves the device free for the next batch.
//!
//! Knows nothing of leases, tiles or results.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use proto::JobId;
use tokio::sync::{Semaphore, SemaphorePermit};

use super::executor::{BatchEvent, BatchExecutor};

/// Semaphores of a device.
#[derive(Debug)]
pub(super) struct DeviceSlots {
    /// One permit: for the batch that renders.
    renders: Semaphore,
    /// A permit for each batch that is prepared, renders, or fetches its pixels.
    stages: Semaphore,
}

impl DeviceSlots {
    /// Slots of a device whose renders overlap this many at a time.
    pub(super) fn new(overlapping: usize) -> Self {
        Self { renders: Semaphore::new(1), stages: Semaphore::new(overlapping.max(1)) }
    }

    /// Waits for a slot in the pipeline of stages.
    pub(super) async fn stage(&self) -> SemaphorePermit<'_> {
        self.stages.acquire().await.expect("the semaphore is never closed")
    }
}

/// Time in which batches shared the device, by which their time limits grow.
#[derive(Debug, Default)]
pub(super) struct SharedTime(Mutex<Sharing>);

#[derive(Clone, Copy, Debug, Default)]
struct Sharing {
    /// Batches that render beside another.
    beside: usize,
    since: Option<Instant>,
    ended: Duration,
}

impl SharedTime {
    fn lock(&self) -> MutexGuard<'_, Sharing> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A batch begins to render beside another, until the guard is dropped.
    pub(super) fn begin(&self) -> impl Drop + '_ {
        let mut sharing = self.lock();
        sharing.beside += 1;
        sharing.since.get_or_insert_with(Instant::now);
        drop(sharing);
        SharingGuard(self)
    }

    /// All of it until now.
    pub(super) fn total(&self) -> Duration {
        let sharing = *self.lock();
        sharing.ended + sharing.since.map(|since| since.elapsed()).unwrap_or_default()
    }
}

struct SharingGuard<'a>(&'a SharedTime);

impl Drop for SharingGuard<'_> {
    fn drop(&mut self) {
        let mut sharing = self.0.lock();
        sharing.beside = sharing.beside.saturating_sub(1);
        if sharing.beside == 0
            && let Some(since) = sharing.since.take()
        {
            sharing.ended += since.elapsed();
        }
    }
}

/// Use of the device by one batch.
pub(super) struct DeviceUse<'a> {
    executor: &'a BatchExecutor,
    permit: Option<SemaphorePermit<'a>>,
    start: Option<Instant>,
    /// Job of the batch, if that is a whole frame.
    frame_of: Option<JobId>,
    is_reported: bool,
}

impl<'a> DeviceUse<'a> {
    pub(super) fn new(executor: &'a BatchExecutor, frame_of: Option<JobId>) -> Self {
        Self { executor, permit: None, start: None, frame_of, is_reported: false }
    }

    /// Waits until the batch has the device.
    pub(super) async fn acquire(&mut self) {
        if self.permit.is_none() {
            let permit = self.executor.device.renders.acquire().await;
            self.permit = Some(permit.expect("the semaphore is never closed"));
            self.start.get_or_insert_with(Instant::now);
        }
    }

    /// Frees the device for the next batch, and reports it the first time.
    pub(super) fn release(&mut self) {
        self.permit = None;
        if !self.is_reported {
            self.is_reported = true;
            let took = self.start.map(|start| start.elapsed());
            self.executor.send(BatchEvent::Rendered { took, frame_of: self.frame_of });
        }
    }

    /// Time since the batch first had the device.
    pub(super) fn elapsed(&self) -> Duration {
        self.start.map(|start| start.elapsed()).unwrap_or_default()
    }
}
