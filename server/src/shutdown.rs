//! The two stages of a shutdown: first the server stops accepting jobs, then it ends waiting requests and its tasks.

use tokio_util::sync::CancellationToken;

/// Handle of a shutdown; clones share its stages.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shutdown {
    begun: CancellationToken,
    closing: CancellationToken,
}

impl Shutdown {
    /// First stage: new jobs are rejected, and local workers finish or release their leases.
    pub(crate) fn begun(&self) -> &CancellationToken {
        &self.begun
    }

    /// Second stage: waiting requests and background tasks end.
    pub(crate) fn closing(&self) -> &CancellationToken {
        &self.closing
    }
}
