//! A worker's sync in one transaction: records results, renews leases, releases unlisted leases, claims work.

use std::collections::HashSet;
use std::time::Duration;

use proto::bounded::RaysPerSecond;
use proto::worker_protocol::{Batch, LeaseReport, TileRecord};
use proto::{LeaseId, WorkerId};

use crate::blobs::ContentKind;
use crate::queue::frames::open;
use crate::queue::leases;
use crate::queue::leases::claim::{self, ClaimOutcome, ClaimRequest, PassedJobs};
use crate::queue::leases::deliver;
use crate::queue::leases::{LeaseEnd, LeaseGrant};
use crate::queue::servers::doomed::{CheckedNames, content_of};
use crate::queue::tiles::recorded;
use crate::queue::tiles::reported::{self, RejectedResult};
use crate::queue::verification::{self, Age, VerificationOutcome, VerifierLease};
use crate::queue::workers::minutes::Rendered;
use crate::queue::workers::state::{self, WorkerState, WorkerStatus};
use crate::queue::{Connection, FrameOpening, Result, TransitionContext, Wake, workers};
use crate::tile_plan::TilePlan;

/// A lease granted in a response that the worker never received is released after this time: the worker does
/// not list it in its syncs.
const UNHEARD_LEASE_MS: i64 = 2000;

/// After a claim that failed, the worker's next one follows after this time.
const FAILED_CLAIM_RETRY_MS: i64 = 5000;

/// Input of a sync.
#[derive(Clone, Debug)]
pub(crate) struct SyncInput {
    /// The calling worker.
    pub(crate) worker: WorkerId,
    /// Caller that speaks for the worker.
    pub(crate) owner: String,
    /// Its measured camera rays a second.
    pub(crate) rays_per_second: Option<RaysPerSecond>,
    /// Leases that the worker holds.
    pub(crate) held_leases: Vec<LeaseId>,
    /// Results of leases that have finished.
    pub(crate) reports: Vec<LeaseReport>,
    /// Records of the tiles among them.
    pub(crate) records: Vec<TileRecord>,
    /// Results whose bytes are not what was asked for.
    pub(crate) rejected: Vec<RejectedResult>,
    /// Known states of the names of the results when their bytes were looked for, if other servers may delete them.
    pub(crate) checked: Option<CheckedNames>,
    /// Whether the worker requests a batch.
    pub(crate) wants_work: bool,
    /// Whether only a batch of a submitter of whom it holds nothing: it renders it beside another.
    pub(crate) beside: bool,
    /// Jobs whose next frame cannot be opened now.
    pub(crate) passed: PassedJobs,
    /// Maximum number of batches that it requests.
    pub(crate) max_batches: u32,
    /// Whether the worker is shutting down.
    pub(crate) shutting_down: bool,
    /// Frame that the previous pass of this sync asked to open.
    pub(crate) opening: Option<FrameOpening>,
    /// The frames after it, which are opened as further batches reach them.
    pub(crate) next_openings: Vec<FrameOpening>,
}

impl SyncInput {
    /// Whether it contains results, so that its commit must be durable before the response.
    pub(crate) fn has_reports(&self) -> bool {
        !self.reports.is_empty() || !self.rejected.is_empty()
    }

    /// Kinds and hashes of the bytes that its results and their records refer to.
    pub(crate) fn reported_content(&self) -> Vec<(ContentKind, String)> {
        let results = self.reports.iter().filter_map(|report| content_of(&report.outcome));
        results.chain(self.records.iter().map(|record| (ContentKind::Blob, record.hash.clone()))).collect()
    }

    /// The same sync after its results have been recorded.
    pub(crate) fn without_reports(&self) -> Self {
        Self { reports: Vec::new(), records: Vec::new(), rejected: Vec::new(), checked: None, ..self.clone() }
    }

    /// The same sync without its claim.
    pub(in crate::queue) fn without_claim(self) -> Self {
        Self { wants_work: false, ..self }
    }
}

/// Outcome of a sync.
#[derive(Clone, Debug)]
pub(crate) struct SyncOutcome {
    /// Leases of the call that have ended.
    pub(crate) revoked_leases: Vec<LeaseId>,
    /// The worker should finish and exit.
    pub(crate) drain: bool,
    /// The granted work, or what prevents it.
    pub(crate) next: NextWork,
    /// Further batches, granted with the first.
    pub(crate) more: Vec<Batch>,
    /// Blobs that may be orphans.
    pub(crate) orphans: Vec<String>,
    /// Number of leases found to be overdue.
    pub(crate) expired: u64,
    /// Number of fenced results.
    pub(crate) fenced: u64,
    /// Number of results that differ from the first result of the same tile.
    pub(crate) nondeterministic: u64,
    /// Number of results that are not what was asked for.
    pub(crate) rejected: u64,
    /// Results that counted.
    pub(crate) rendered: Rendered,
    /// Whether a submitter waits of whom the worker holds nothing, and no other worker is free.
    pub(crate) others_wait: bool,
    /// Changes of verifications.
    pub(crate) verification: VerificationOutcome,
    pub(in crate::queue) woken: Wake,
}

impl SyncOutcome {
    /// Whether the worker must get the response at once.
    pub(crate) fn needs_response(&self) -> bool {
        self.others_wait || !self.revoked_leases.is_empty() || matches!(self.next, NextWork::Run(_))
    }

    /// The outcome of a sync whose claim failed.
    pub(in crate::queue) fn after_failed_claim(self) -> Self {
        Self { next: NextWork::Nothing(Some(FAILED_CLAIM_RETRY_MS)), ..self }
    }

    /// If a tile is backing off: the time until it is ready.
    pub(crate) fn retry_in(&self) -> Option<Duration> {
        match self.next {
            NextWork::Nothing(Some(ready_in_ms)) => Some(Duration::from_millis(ready_in_ms.unsigned_abs())),
            NextWork::Nothing(None) | NextWork::Run(_) | NextWork::OpenFrame { .. } => None,
        }
    }
}

/// The granted work, or what prevents it.
#[derive(Clone, Debug)]
pub(crate) enum NextWork {
    /// Granted batch.
    Run(Batch),
    /// A frame must be opened first: repeat the sync with its [`FrameOpening`].
    OpenFrame {
        /// The job's number.
        job: i64,
        /// The frame.
        frame: u32,
        /// Tile plan of its frames.
        plan: TilePlan,
    },
    /// No work now; if a tile is backing off, it is ready in this many milliseconds.
    Nothing(Option<i64>),
}

/// Carries out a worker's sync; `None` if the worker is unknown, or belongs to another caller.
pub(in crate::queue) async fn sync(
    connection: &mut Connection,
    turn: SyncInput,
    context: TransitionContext,
) -> Result<Option<SyncOutcome>> {
    let Some(mut worker) = WorkerState::read(connection, &turn, context).await? else { return Ok(None) };
    // A pass with the opening that the previous pass asked for belongs to the same sync.
    let is_new = turn.opening.is_none();
    let (mut expired, mut woken) = (0, Wake::default());
    if is_new && worker.is_anything_overdue {
        state::touch(connection, &turn, false, context).await?;
        (expired, woken) = leases::rescue(connection, context).await?;
        let Some(rescued) = WorkerState::read(connection, &turn, context).await? else { return Ok(None) };
        worker = rescued;
    }
    // The leases of verifications are apart from the tiles'.
    let verified: Vec<VerifierLease> =
        if worker.has_verifications { verification::live_leases(connection, &worker.id).await? } else { Vec::new() };
    let is_verified = |lease: &LeaseId| {
        let lease = if verified.is_empty() { String::new() } else { lease.to_string() };
        verified.iter().any(|verified| verified.lease == lease)
    };
    let (verifications, reports): (Vec<_>, Vec<_>) =
        turn.reports.iter().cloned().partition(|report| is_verified(&report.lease));
    let delivered = deliver::deliver(connection, &worker, &reports, context).await?;
    recorded::store(connection, &turn.records, &delivered.ended).await?;
    if is_new {
        state::touch(connection, &turn, delivered.has_results, context).await?;
    }
    woken.add(delivered.woken);
    let (mut verification, verdict_wake) =
        verification::deliver(connection, &worker, &verified, &verifications, context).await?;
    woken.add(verdict_wake);
    verification.skipped += delivered.unverified;
    let (fenced, nondeterministic) = (delivered.lost.len() as u64, delivered.nondeterministic);
    let mut lost = delivered.lost;
    let (late, is_quarantined, rejection_wake) =
        reported::reject(connection, turn.worker, &turn.rejected, context).await?;
    lost.extend(late);
    woken.add(rejection_wake);
    // Otherwise nothing has happened but to the delivered leases and their tiles.
    let is_known = verification.differed == 0 && turn.rejected.is_empty() && !delivered.has_failures;
    if is_new {
        let (held, tiles): (Vec<LeaseId>, Vec<LeaseId>) = turn.held_leases.iter().partition(|lease| is_verified(lease));
        if verified.len() > verifications.len() {
            let held: Vec<String> = held.iter().map(ToString::to_string).collect();
            woken.add(verification::renew(connection, &worker.id, &held, context).await?);
        }
        let live = if is_known {
            let open = worker.leases.iter().filter(|held| held.is_open && !delivered.ended.contains(&held.live.lease));
            open.map(|held| LeaseGrant::of(&held.live)).collect()
        } else {
            leases::live_leases(connection, &worker.id).await?
        };
        woken.add(renew_leases(connection, turn.worker, &live, &tiles, context, &mut lost).await?);
    }
    if turn.shutting_down {
        woken.add(workers::deregister(connection, turn.worker, context).await?);
    }
    let (next, more) =
        if turn.wants_work && !turn.shutting_down && worker.status == WorkerStatus::Ready && !is_quarantined {
            if !is_known {
                worker.others_max_nodes = claim::others_max_nodes(connection, &worker.id).await?;
            }
            claim_work(connection, &turn, &worker, context).await?
        } else {
            (NextWork::Nothing(None), Vec::new())
        };
    let drain = turn.shutting_down || worker.status == WorkerStatus::Draining;
    Ok(Some(SyncOutcome {
        revoked_leases: lost,
        drain,
        next,
        more,
        orphans: delivered.orphans,
        expired,
        fenced,
        nondeterministic,
        rejected: turn.rejected.len() as u64,
        rendered: delivered.rendered,
        verification,
        others_wait: false,
        woken,
    }))
}

/// Renews the leases that the worker lists, reports those that have ended, and releases those that it never
/// received.
async fn renew_leases(
    connection: &mut Connection,
    worker: WorkerId,
    live: &[LeaseGrant],
    held_leases: &[LeaseId],
    context: TransitionContext,
    lost: &mut Vec<LeaseId>,
) -> Result<Wake> {
    let mut holding: HashSet<String> = held_leases.iter().map(ToString::to_string).collect();
    let (held, unknown): (Vec<_>, Vec<_>) = live.iter().partition(|live| holding.remove(&live.lease));
    lost.extend(held_leases.iter().filter(|lease| holding.contains(&lease.to_string())));
    let held: Vec<&str> = held.into_iter().map(|live| live.lease.as_str()).collect();
    leases::renew(connection, &held, context).await?;
    let mut woken = Wake::default();
    for unheard in unknown.into_iter().filter(|live| live.granted_ms <= context.now_ms - UNHEARD_LEASE_MS) {
        // The failure of a job, earlier in this loop, may have ended more of these leases.
        let Some(held) = leases::live_lease(connection, &unheard.lease).await? else { continue };
        tracing::warn!(lease = %held.lease, %worker, "a worker never received its lease");
        woken.add(
            leases::end_without_result(
                connection,
                &held,
                LeaseEnd::Released,
                "its worker never received the lease",
                context,
            )
            .await?,
        );
    }
    Ok(woken)
}

/// Claims a batch, and further ones as long as they are short and the worker asks for them.
async fn claim_work(
    connection: &mut Connection,
    turn: &SyncInput,
    worker: &WorkerState,
    context: TransitionContext,
) -> Result<(NextWork, Vec<Batch>)> {
    if let Some(opening) = &turn.opening {
        open::open(connection, opening, context).await?;
    }
    if worker.is_paused {
        return Ok((NextWork::Nothing(None), Vec::new()));
    }
    let claimant = ClaimRequest {
        worker: turn.worker,
        rays_per_second: turn.rays_per_second,
        max_nodes: worker.max_nodes,
        others_max_nodes: worker.others_max_nodes,
        beside: turn.beside,
    };
    // A worker does not verify what it has just delivered.
    if worker.has_verifications
        && !turn.beside
        && let Some(batch) = verification::claim(connection, claimant, Age::Recent, context).await?
    {
        return Ok((NextWork::Run(batch), Vec::new()));
    }
    let mut openings = turn.next_openings.iter();
    let (mut first, mut more, mut seconds) = (None, Vec::new(), 0.0);
    let reason = loop {
        let time = match claim::claim(connection, claimant, &turn.passed, context).await? {
            ClaimOutcome::Run(batch, time) => {
                match first {
                    None => first = Some(batch),
                    Some(_) => more.push(batch),
                }
                time
            }
            ClaimOutcome::NeedsFrame { job, frame, plan } => {
                match openings.find(|opening| (opening.job, opening.frame) == (job, frame)) {
                    Some(opening) => open::open(connection, opening, context).await?,
                    None => break NextWork::OpenFrame { job, frame, plan },
                };
                continue;
            }
            ClaimOutcome::Nothing(ready_in_ms) => break NextWork::Nothing(ready_in_ms),
        };
        let Some(time) = time else { break NextWork::Nothing(None) };
        seconds += time.seconds;
        if more.len() + 1 >= turn.max_batches as usize || seconds + time.seconds > time.most_seconds {
            break NextWork::Nothing(None);
        }
    };
    if worker.has_verifications
        && !turn.beside
        && first.is_none()
        && matches!(reason, NextWork::Nothing(_))
        && let Some(batch) = verification::claim(connection, claimant, Age::Old, context).await?
    {
        return Ok((NextWork::Run(batch), Vec::new()));
    }
    Ok((first.map_or(reason, NextWork::Run), more))
}
