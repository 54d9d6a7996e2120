//! Announces stored bytes that may have become orphans; the maintenance task deletes those that no row refers to.

use std::collections::HashSet;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::mpsc;

use crate::blobs::ContentKind;
use crate::queue::RemovedContent;

/// Stored bytes that may be orphans.
#[derive(Clone, Debug)]
pub(crate) struct OrphanCandidates {
    /// Pictures or blobs.
    pub(crate) kind: ContentKind,
    /// Their hashes.
    pub(crate) hashes: Vec<String>,
}

/// Sender of orphan candidates to the maintenance task.
#[derive(Clone, Debug)]
pub(crate) struct Orphans {
    sender: mpsc::UnboundedSender<OrphanCandidates>,
    /// Candidates that were too young, and that need no check until they are sent again.
    young: Arc<Mutex<HashSet<(ContentKind, String)>>>,
}

impl Orphans {
    /// Sender, and the receiver for the maintenance task.
    pub(crate) fn channel() -> (Self, mpsc::UnboundedReceiver<OrphanCandidates>) {
        let (sender, receiver) = mpsc::unbounded_channel();
        (Self { sender, young: Arc::default() }, receiver)
    }

    /// Requests the maintenance task to delete what no row refers to any more.
    pub(crate) fn sweep_removed(&self, removed: RemovedContent) {
        self.sweep_later(ContentKind::Picture, removed.pictures);
        self.sweep_later(ContentKind::Blob, removed.blobs);
    }

    /// Requests the maintenance task to delete the given bytes if no row refers to them.
    pub(crate) fn sweep_later(&self, kind: ContentKind, hashes: Vec<String>) {
        if !hashes.is_empty() {
            // Without a maintenance task the server is shutting down; the next one sweeps.
            drop(self.sender.send(OrphanCandidates { kind, hashes }));
        }
    }

    /// The same after a delay, once for each of them, because frames often share bytes.
    pub(crate) fn sweep_after(&self, delay: Duration, kind: ContentKind, mut hashes: Vec<String>) {
        let mut young = self.young.lock().expect("no holder panics");
        hashes.retain(|hash| young.insert((kind, hash.clone())));
        drop(young);
        let orphans = self.clone();
        tokio::spawn(async move {
            tokio::time::sleep(delay).await;
            let mut young = orphans.young.lock().expect("no holder panics");
            for hash in &hashes {
                young.remove(&(kind, hash.clone()));
            }
            drop(young);
            orphans.sweep_later(kind, hashes);
        });
    }

    /// The candidates that do not wait for a later check.
    pub(crate) fn due(&self, kind: ContentKind, hashes: &[String]) -> Vec<String> {
        let young = self.young.lock().expect("no holder panics");
        hashes.iter().filter(|hash| !young.contains(&(kind, (*hash).clone()))).cloned().collect()
    }
}
