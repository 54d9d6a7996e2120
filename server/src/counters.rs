//! Counters since the start, for `/metrics`: services add to them, the telemetry reads them.

use std::sync::atomic::AtomicU64;

/// Counters since the start.
#[derive(Debug, Default)]
pub(crate) struct ServerCounters {
    /// Expired leases.
    pub(crate) expired: AtomicU64,
    /// Fenced results.
    pub(crate) fenced: AtomicU64,
    /// Tiles that two workers rendered differently.
    pub(crate) nondeterministic: AtomicU64,
    /// Results that are not what was asked for.
    pub(crate) rejected: AtomicU64,
    /// Results that another worker confirmed.
    pub(crate) verified: AtomicU64,
    /// Second renderings that differ from the first.
    pub(crate) refuted: AtomicU64,
    /// Results that should have been verified, but could not be.
    pub(crate) unverified: AtomicU64,
    /// Camera rays that workers of this server have rendered.
    pub(crate) rendered_rays: AtomicU64,
    /// Tiles that they have rendered.
    pub(crate) rendered_tiles: AtomicU64,
    /// Pictures that they have made.
    pub(crate) rendered_frames: AtomicU64,
    /// Failed attempts to deliver a webhook.
    pub(crate) webhook_failures: AtomicU64,
    /// Messages to the other servers of the database.
    pub(crate) hints_sent: AtomicU64,
    /// Messages of the other servers.
    pub(crate) hints_received: AtomicU64,
    /// Number of the other servers, as of the last renewal.
    pub(crate) other_servers: AtomicU64,
}
