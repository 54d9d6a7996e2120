//! Connects the services: each gets the handles that it uses. Nothing here can fail.

use std::sync::{Arc, Mutex};

use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::Started;
use crate::admission::{RateLimits, Shares};
use crate::alerts::Alerts;
use crate::api_keys::ApiKeys;
use crate::audit_log::AuditLog;
use crate::blobs::BlobStore;
use crate::cluster::Cluster;
use crate::config::Config;
use crate::counters::ServerCounters;
use crate::db::Database;
use crate::estimate::Estimator;
use crate::events::EventHub;
use crate::farm_events::FarmEvents;
use crate::http::{ApiState, Handles};
use crate::job_reader::JobReader;
use crate::listen::Listeners;
use crate::lock::FolderLock;
use crate::maintenance::{ChangeFinisher, Cleanup, HistoryRecorder, LeaseExpiry, Maintenance, OrphanSweep};
use crate::orphans::{OrphanCandidates, Orphans};
use crate::pictures::Pictures;
use crate::pool::Pool;
use crate::preview_helper::PreviewHelper;
use crate::queue::Queue;
use crate::retention::{Retention, RetentionLimits};
use crate::shutdown::Shutdown;
use crate::signed_links::LinkSigner;
use crate::space_reserve::SpaceReserve;
use crate::submissions::Submissions;
use crate::telemetry::Telemetry;
use crate::upload_ledger::UploadLedger;
use crate::webhooks::{AddressPolicy, Signer, Webhooks};
use crate::worker_sync::{FrameOpenings, ResultCheck, WorkerSync};

/// Opened parts that one service, or the server itself, takes alone.
pub(super) struct Opened {
    /// Bound addresses.
    pub(super) listeners: Listeners,
    /// The database.
    pub(super) database: Arc<Database>,
    /// API keys.
    pub(super) api_keys: ApiKeys,
    /// Audit log.
    pub(super) audit_log: AuditLog,
    /// Signer of links.
    pub(super) links: LinkSigner,
    /// Addresses that webhooks may have.
    pub(super) webhook_addresses: Arc<AddressPolicy>,
    /// Signer of webhooks.
    pub(super) signer: Signer,
    /// Lock of the data folder.
    pub(super) lock: FolderLock,
}

/// Parts that several services share.
pub(super) struct Foundation {
    /// The queue.
    pub(super) queue: Queue,
    /// Pictures and blobs.
    pub(super) content: Arc<BlobStore>,
    /// Space set aside for a full disk.
    pub(super) reserve: Arc<SpaceReserve>,
    /// Helper processes that draw previews.
    pub(super) preview_helper: Arc<PreviewHelper>,
    /// Counters since the start.
    pub(super) counters: Arc<ServerCounters>,
    /// Settings of the operator.
    pub(super) config: Arc<Config>,
}

/// Background tasks of a server.
#[derive(Debug)]
pub(crate) struct BackgroundTasks {
    cluster: Cluster,
    maintenance: Maintenance,
    candidates: mpsc::UnboundedReceiver<OrphanCandidates>,
    events: Arc<EventHub>,
    farm_events: Arc<FarmEvents>,
    alerts: Arc<Alerts>,
    webhooks: Arc<Webhooks>,
    api_keys: Arc<ApiKeys>,
    audit_log: Arc<AuditLog>,
    rate_limits: Arc<RateLimits>,
}

impl BackgroundTasks {
    /// Starts all tasks, which end at `end`; returns each with its name.
    pub(crate) fn start(self, end: &CancellationToken) -> Vec<(JoinHandle<()>, &'static str)> {
        let Self {
            cluster,
            maintenance,
            candidates,
            events,
            farm_events,
            alerts,
            webhooks,
            api_keys,
            audit_log,
            rate_limits,
        } = self;
        let admission = {
            let end = end.clone();
            async move {
                tokio::join!(api_keys.run(end.clone()), audit_log.run(end.clone()), rate_limits.run(end));
            }
        };
        let publishing = {
            let end = end.clone();
            async move {
                tokio::join!(events.run(end.clone()), farm_events.run(end.clone()), alerts.run(end));
            }
        };
        vec![
            (tokio::spawn(cluster.run(end.clone())), "contact with other servers"),
            (tokio::spawn(maintenance.run(candidates, end.clone())), "maintenance"),
            (tokio::spawn(publishing), "event distribution"),
            (tokio::spawn(webhooks.run(end.clone())), "webhook delivery"),
            (tokio::spawn(admission), "admission control"),
        ]
    }
}

impl Foundation {
    /// Connects everything that was opened.
    pub(super) fn connect(self, opened: Opened) -> Started {
        let Opened { listeners, database, api_keys, audit_log, links, webhook_addresses, signer, lock } = opened;
        let config = Arc::clone(&self.config);
        let queue = self.queue.clone();
        let (orphans, candidates) = Orphans::channel();
        let shutdown = Shutdown::default();
        let pool = Arc::new(Pool::new(config.pool_workers()));
        let retention = Arc::new(self.retention(orphans.clone()));
        let events = Arc::new(EventHub::new(queue.clone()));
        let telemetry = Arc::new(self.telemetry(&database));
        let farm_events = Arc::new(FarmEvents::new(queue.clone(), Arc::clone(&telemetry)));
        let alerts = Arc::new(self.alerts(&telemetry, &pool));
        let (api_keys, audit_log) = (Arc::new(api_keys), Arc::new(audit_log));
        let rate_limits = Arc::new(RateLimits::new());
        let counters = Arc::clone(&self.counters);
        let webhooks = Webhooks::new(queue.clone(), Arc::clone(&webhook_addresses), signer, counters);
        let tasks = BackgroundTasks {
            cluster: Cluster::new(queue.clone(), Arc::clone(&database), Arc::clone(&self.counters)),
            maintenance: self.maintenance(&orphans, Arc::clone(&retention)),
            candidates,
            events: Arc::clone(&events),
            farm_events: Arc::clone(&farm_events),
            alerts: Arc::clone(&alerts),
            webhooks: Arc::new(webhooks),
            api_keys: Arc::clone(&api_keys),
            audit_log: Arc::clone(&audit_log),
            rate_limits: Arc::clone(&rate_limits),
        };
        let jobs = Arc::new(JobReader::new(config.job_reader.clone()));
        let upload_ledger = Arc::new(UploadLedger::new(self.content.orphan_age(), !self.content.is_shared()));
        let state = ApiState::new(Handles {
            alerts,
            api_keys,
            audit_log,
            estimator: Arc::new(self.estimator(Arc::clone(&pool))),
            events,
            farm_events,
            links: Arc::new(links),
            pictures: Arc::new(self.pictures()),
            pool: Arc::clone(&pool),
            rate_limits,
            retention,
            shares: Arc::new(Shares::new(listeners.connections(), config.max_requests_per_caller as usize)),
            shutdown: shutdown.clone(),
            submissions: Submissions::new(queue.clone(), Arc::clone(&jobs)),
            telemetry,
            webhook_addresses,
            worker_sync: Arc::new(self.worker_sync(&jobs, &upload_ledger, orphans.clone())),
            upload_ledger,
            config: Arc::clone(&config),
            content: self.content,
            jobs,
            orphans,
            preview_helper: self.preview_helper,
            queue: queue.clone(),
            reserve: self.reserve,
        });
        Started { config, listeners, state, tasks, pool, queue, shutdown, database, lock }
    }

    fn retention(&self, orphans: Orphans) -> Retention {
        let limits =
            RetentionLimits { job_retention: self.config.job_retention, max_store_bytes: self.config.max_store_bytes };
        Retention::new(self.queue.clone(), Arc::clone(&self.content), Arc::clone(&self.reserve), orphans, limits)
    }

    fn maintenance(&self, orphans: &Orphans, retention: Arc<Retention>) -> Maintenance {
        let queue = &self.queue;
        Maintenance {
            changes: ChangeFinisher { queue: queue.clone(), orphans: orphans.clone() },
            leases: LeaseExpiry {
                queue: queue.clone(),
                reserve: Arc::clone(&self.reserve),
                counters: Arc::clone(&self.counters),
            },
            history: HistoryRecorder { queue: queue.clone(), counters: Arc::clone(&self.counters) },
            sweep: OrphanSweep { queue: queue.clone(), content: Arc::clone(&self.content), orphans: orphans.clone() },
            cleanup: Cleanup {
                queue: queue.clone(),
                retention,
                preview_helper: Arc::clone(&self.preview_helper),
                content: Arc::clone(&self.content),
            },
        }
    }

    fn alerts(&self, telemetry: &Arc<Telemetry>, pool: &Arc<Pool>) -> Alerts {
        Alerts {
            queue: self.queue.clone(),
            content: Arc::clone(&self.content),
            telemetry: Arc::clone(telemetry),
            pool: Arc::clone(pool),
            reserve: Arc::clone(&self.reserve),
            counters: Arc::clone(&self.counters),
            since: Mutex::default(),
        }
    }

    fn estimator(&self, pool: Arc<Pool>) -> Estimator {
        Estimator::new(self.queue.clone(), pool, Arc::clone(&self.preview_helper), self.config.cpu_threads())
    }

    fn pictures(&self) -> Pictures {
        let (content, reserve) = (Arc::clone(&self.content), Arc::clone(&self.reserve));
        let redirects = self.config.redirect_pictures;
        Pictures::new(self.queue.clone(), content, reserve, Arc::clone(&self.preview_helper), redirects)
    }

    fn telemetry(&self, database: &Database) -> Telemetry {
        let (content, counters) = (Arc::clone(&self.content), Arc::clone(&self.counters));
        Telemetry::new(self.config.data.clone(), database, self.queue.clone(), content, counters)
    }

    fn worker_sync(&self, jobs: &Arc<JobReader>, ledger: &Arc<UploadLedger>, orphans: Orphans) -> WorkerSync {
        WorkerSync {
            queue: self.queue.clone(),
            results: ResultCheck::new(self.queue.clone(), Arc::clone(&self.content), Arc::clone(jobs)),
            openings: FrameOpenings::new(self.queue.clone(), Arc::clone(jobs)),
            ledger: Arc::clone(ledger),
            reserve: Arc::clone(&self.reserve),
            orphans,
            preview_helper: Arc::clone(&self.preview_helper),
            counters: Arc::clone(&self.counters),
        }
    }
}
