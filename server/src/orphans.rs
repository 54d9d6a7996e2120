//! Announces stored bytes that may have become orphans; the maintenance task deletes those that no row refers to.

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
pub(crate) struct Orphans(mpsc::UnboundedSender<OrphanCandidates>);

impl Orphans {
    /// Sender, and the receiver for the maintenance task.
    pub(crate) fn channel() -> (Self, mpsc::UnboundedReceiver<OrphanCandidates>) {
        let (sender, receiver) = mpsc::unbounded_channel();
        (Self(sender), receiver)
    }

    /// Requests the maintenance task to delete what no row refers to any more.
    pub(crate) fn sweep_removed(&self, removed: RemovedContent) {
        self.sweep_later(ContentKind::Picture, removed.pictures);
        self.sweep_later(ContentKind::Blob, removed.blobs);
    }

    /// Requests the maintenance task to delete those of the given bytes that no row refers to.
    pub(crate) fn sweep_later(&self, kind: ContentKind, hashes: Vec<String>) {
        if !hashes.is_empty() {
            // Without a maintenance task the server is shutting down; the next one sweeps.
            drop(self.0.send(OrphanCandidates { kind, hashes }));
        }
    }
}
