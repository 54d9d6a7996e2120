//! State of the router: one handle for each service. A handler takes those that it uses, each as `State<Handle>`.
//!
//! Only the start of the server sees all of them.

use std::sync::Arc;

use axum::extract::FromRef;

use crate::admission::{RateLimits, Shares};
use crate::alerts::Alerts;
use crate::api_keys::ApiKeys;
use crate::audit_log::AuditLog;
use crate::blobs::BlobStore;
use crate::config::Config;
use crate::estimate::Estimator;
use crate::events::EventHub;
use crate::farm_events::FarmEvents;
use crate::job_reader::JobReader;
use crate::orphans::Orphans;
use crate::pictures::Pictures;
use crate::pool::Pool;
use crate::preview_helper::PreviewHelper;
use crate::queue::Queue;
use crate::retention::Retention;
use crate::shutdown::Shutdown;
use crate::signed_links::LinkSigner;
use crate::space_reserve::SpaceReserve;
use crate::submissions::Submissions;
use crate::telemetry::Telemetry;
use crate::upload_ledger::UploadLedger;
use crate::webhooks::AddressPolicy;
use crate::worker_sync::WorkerSync;

/// State of the router; a clone is one count more.
#[derive(Clone, Debug)]
pub(crate) struct ApiState(Arc<Handles>);

/// Declares the handles, each of another type, and how a handler gets one.
macro_rules! handles_of_state {
    ($($(#[$meta:meta])* $name:ident: $handle:ty,)*) => {
        /// Handles to the services; cheap to clone.
        #[derive(Debug)]
        pub(crate) struct Handles {
            $($(#[$meta])* pub(crate) $name: $handle,)*
        }

        $(impl FromRef<ApiState> for $handle {
            fn from_ref(state: &ApiState) -> Self {
                state.0.$name.clone()
            }
        })*
    };
}

handles_of_state! {
    /// Conditions that need an operator.
    alerts: Arc<Alerts>,
    /// API keys.
    api_keys: Arc<ApiKeys>,
    /// Audit log.
    audit_log: Arc<AuditLog>,
    /// Settings of the operator.
    config: Arc<Config>,
    /// Pictures and blobs.
    content: Arc<BlobStore>,
    /// Estimates of jobs.
    estimator: Arc<Estimator>,
    /// Distributor of events.
    events: Arc<EventHub>,
    /// Events of all jobs.
    farm_events: Arc<FarmEvents>,
    /// Parsed job files.
    jobs: Arc<JobReader>,
    /// Signer of links.
    links: Arc<LinkSigner>,
    /// Announcement of orphans.
    orphans: Orphans,
    /// Checked pictures.
    pictures: Arc<Pictures>,
    /// Local workers.
    pool: Arc<Pool>,
    /// Helper processes that draw previews.
    preview_helper: Arc<PreviewHelper>,
    /// Jobs, with tiles, leases and workers.
    queue: Queue,
    /// Request rates.
    rate_limits: Arc<RateLimits>,
    /// Space set aside for a full disk.
    reserve: Arc<SpaceReserve>,
    /// Deletion of jobs past their retention.
    retention: Arc<Retention>,
    /// Requests and bytes that callers have in progress.
    shares: Arc<Shares>,
    /// Stages of the shutdown.
    shutdown: Shutdown,
    /// Acceptance of jobs.
    submissions: Submissions,
    /// Metrics and status.
    telemetry: Arc<Telemetry>,
    /// Unreported bytes of worker keys.
    upload_ledger: Arc<UploadLedger>,
    /// Addresses that webhooks may have.
    webhook_addresses: Arc<AddressPolicy>,
    /// Syncs of workers.
    worker_sync: Arc<WorkerSync>,
}

impl ApiState {
    /// State with these handles.
    pub(crate) fn new(handles: Handles) -> Self {
        Self(Arc::new(handles))
    }
}

/// Declares a few handles that are used together, as one that a handler can take.
macro_rules! handle_group {
    ($(#[$group_meta:meta])* $group:ident { $($(#[$meta:meta])* $name:ident: $handle:ty,)* }) => {
        $(#[$group_meta])*
        #[derive(Clone, Debug)]
        pub(in crate::http) struct $group {
            $($(#[$meta])* pub(in crate::http) $name: $handle,)*
        }

        impl axum::extract::FromRef<$crate::http::ApiState> for $group {
            fn from_ref(state: &$crate::http::ApiState) -> Self {
                Self { $($name: axum::extract::FromRef::from_ref(state),)* }
            }
        }
    };
}

pub(in crate::http) use handle_group;
