//! Handles the signals that ask a process to stop: Ctrl-C and SIGTERM.

use anyhow::Context;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio_util::sync::CancellationToken;

/// Handlers of both signals: from here on they no longer end the process.
#[derive(Debug)]
pub(crate) struct Signals {
    interrupt: Signal,
    terminate: Signal,
}

impl Signals {
    /// Installs the handlers; must be called within a Tokio runtime.
    pub(crate) fn install() -> anyhow::Result<Self> {
        let catch = |kind| signal(kind).context("could not catch signals");
        Ok(Self { interrupt: catch(SignalKind::interrupt())?, terminate: catch(SignalKind::terminate())? })
    }

    /// Returns at the next signal.
    pub(crate) async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }

    /// Makes the first signal request a graceful shutdown and the second one end the process at once.
    pub(crate) fn cancel_then_exit(mut self, shutdown: CancellationToken) {
        tokio::spawn(async move {
            self.next().await;
            tracing::info!("stopping after leased tiles are finished or released; a second signal stops immediately");
            shutdown.cancel();
            self.next().await;
            std::process::exit(1);
        });
    }
}
