//! Notifications to systemd: serving, alive, stopping. Without systemd they do nothing.

use sd_notify::NotifyState;

/// Reports that the server serves, and from then on that it is alive, at the requested interval.
pub(crate) fn serving(address: &str) {
    notify(&[NotifyState::Ready, NotifyState::Status(&format!("serving {address}"))]);
    let Some(timeout) = sd_notify::watchdog_enabled() else { return };
    tokio::spawn(async move {
        let mut ticks = tokio::time::interval(timeout / 3);
        loop {
            ticks.tick().await;
            notify(&[NotifyState::Watchdog]);
        }
    });
}

/// Reports that the server stops.
pub(crate) fn stopping() {
    notify(&[NotifyState::Stopping]);
}

fn notify(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        tracing::warn!(%error, "could not notify systemd");
    }
}
