//! Batches that are rendered beside one that takes long, so that no submitter waits for another's. The long one is not handed
//! back: that would lose its samples, or need a second way to store them.

use std::sync::Arc;
use std::time::Duration;

use proto::LeaseId;
use tokio::time::Instant;

use super::executor::{BatchExecutor, LeaseHandle};

/// After this time a batch gives way: batches of other submitters are rendered at the same time.
const GIVE_WAY_AFTER: Duration = Duration::from_secs(2);
/// Maximum number of batches beside one, each of another submitter.
const MAX_BESIDE: usize = 3;
/// Time after which work is requested again, if there was none.
const PAUSE: Duration = Duration::from_secs(1);

/// Lanes of a device for batches beside the first.
pub(super) struct Beside {
    /// Whether the server and the device support it.
    is_possible: bool,
    lanes: Vec<Lane>,
    /// Leases of the batches that wait for the device's own lane.
    waiting: Vec<Vec<LeaseHandle>>,
    /// When the last batch began.
    begun: Option<Instant>,
    /// Whether the server has said that a submitter waits.
    others_wait: bool,
    not_before: Option<Instant>,
}

struct Lane {
    executor: Arc<BatchExecutor>,
    is_busy: bool,
}

impl Beside {
    pub(super) fn new(is_offered: bool) -> Self {
        Self {
            is_possible: is_offered,
            lanes: Vec::new(),
            waiting: Vec::new(),
            begun: None,
            others_wait: false,
            not_before: None,
        }
    }

    /// Number of lanes that render.
    pub(super) fn rendering(&self) -> usize {
        self.lanes.iter().filter(|lane| lane.is_busy).count()
    }

    /// A batch begins, in the device's own lane or beside it.
    pub(super) fn batch_begins(&mut self) {
        self.begun = Some(Instant::now());
    }

    /// A batch with these leases waits for the device.
    pub(super) fn waits(&mut self, holds: &[LeaseHandle]) {
        self.waiting.push(holds.to_vec());
    }

    /// The batch with this lease has the device.
    pub(super) fn has_device(&mut self, lease: LeaseId) {
        self.waiting.retain(|holds| holds.iter().all(|hold| hold.lease != lease));
    }

    pub(super) fn has_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Leases of the batches that wait, which will wait no longer.
    pub(super) fn take_waiting(&mut self) -> Vec<LeaseHandle> {
        self.waiting.drain(..).flatten().collect()
    }

    /// Time from which the last batch gives way, if another can be rendered beside it.
    pub(super) fn gives_way_at(&self) -> Option<Instant> {
        let has_lane = self.is_possible && self.rendering() < MAX_BESIDE;
        let given_way = self.begun.filter(|_| has_lane)? + GIVE_WAY_AFTER;
        Some(self.not_before.map_or(given_way, |not_before| given_way.max(not_before)))
    }

    /// Whether work may be requested now, because the server has said that a submitter waits.
    pub(super) fn wants_work(&self, now: Instant) -> bool {
        self.others_wait && self.gives_way_at().is_some_and(|at| now >= at)
    }

    /// The server has said whether a submitter waits.
    pub(super) fn heard(&mut self, others_wait: bool) {
        self.others_wait = others_wait;
    }

    /// A request for work has had this answer.
    pub(super) fn answered(&mut self, has_batch: bool) {
        self.others_wait = false;
        self.not_before = (!has_batch).then(|| Instant::now() + PAUSE);
    }

    /// Whether there is a free lane, or could be made one: work is requested only then.
    pub(super) fn has_lane(&mut self, main: &BatchExecutor) -> bool {
        if self.lanes.iter().any(|lane| !lane.is_busy) {
            return true;
        }
        let renderer = main.renderer.beside().unwrap_or_else(|error| {
            tracing::warn!(%error, "could not make a renderer for other submitters' batches");
            None
        });
        self.is_possible &= renderer.is_some();
        let executor = renderer.map(|renderer| Arc::new(main.beside(self.lanes.len(), renderer)));
        self.lanes.extend(executor.map(|executor| Lane { executor, is_busy: false }));
        self.is_possible
    }

    /// A free lane for a batch, which is busy from now on.
    pub(super) fn take_lane(&mut self) -> Option<Arc<BatchExecutor>> {
        let lane = self.lanes.iter_mut().find(|lane| !lane.is_busy)?;
        lane.is_busy = true;
        Some(lane.executor.clone())
    }

    /// A lane has rendered its batch.
    pub(super) fn free(&mut self, lane: usize) {
        if let Some(lane) = self.lanes.get_mut(lane) {
            lane.is_busy = false;
        }
    }

    /// Nothing renders any more.
    pub(super) fn free_all(&mut self) {
        for lane in &mut self.lanes {
            lane.is_busy = false;
        }
        self.begun = None;
        self.waiting.clear();
    }
}
