//! Leases that end without a result: the tile becomes ready again after a back-off, or is dead after too many
//! failures.

pub(super) mod batch_size;
pub(super) mod claim;
pub(super) mod deliver;
pub(super) mod ends;
mod others;
pub(super) mod straggler;
pub(super) mod sync;

use crate::db;
use std::time::Duration;

use db::Row;
use proto::{LeaseId, WorkerId};

use crate::queue::jobs::finish;
use crate::queue::workers::exclusion;
use crate::queue::{Connection, Result, TransitionContext, Wake, expect_rows, json_list};

/// Number of renderer errors after which a tile is still retried.
const MAX_ERRORS: i64 = 3;
/// Number of worker crashes after which a tile is still retried.
const MAX_CRASHES: i64 = 3;
/// Number of lost workers after which a tile is still retried.
const MAX_LOSSES: i64 = 50;
/// A tile lost with its worker this many times is leased alone.
pub(super) const LOSSES_BEFORE_ISOLATION: i64 = 2;
/// Maximum back-off.
const MAX_BACK_OFF: Duration = Duration::from_secs(5);
/// Initial back-off; it doubles from there.
const BACK_OFF: Duration = Duration::from_millis(100);

/// Reason why a lease ended without a result. Each reason has its own counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LeaseEnd {
    /// The renderer failed.
    Failed,
    /// The worker crashed: the tile may be the cause.
    Crashed,
    /// The worker delivered something else than was asked for: its own fault, never the tile's.
    Rejected,
    /// The worker vanished, was killed, or did not renew in time.
    Lost,
    /// The worker released the tile, or never received the lease.
    Released,
}

impl LeaseEnd {
    fn name(self) -> &'static str {
        match self {
            Self::Failed | Self::Rejected => "failed",
            Self::Crashed => "crashed",
            Self::Lost => "lost",
            Self::Released => "interrupted",
        }
    }
}

/// Number of times that each reason has ended a lease of the tile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counters {
    errors: i64,
    crashes: i64,
    lost: i64,
    interrupts: i64,
}

/// Consequence for the tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RetryDecision {
    Retry { delay_ms: i64 },
    Dead,
}

impl Counters {
    fn incremented(mut self, cause: LeaseEnd) -> Self {
        match cause {
            LeaseEnd::Failed => self.errors += 1,
            LeaseEnd::Crashed => self.crashes += 1,
            LeaseEnd::Lost => self.lost += 1,
            LeaseEnd::Released | LeaseEnd::Rejected => self.interrupts += 1,
        }
        self
    }

    /// Back-off or death of the tile; `jitter` is from 0 to 1.
    fn decide(self, cause: LeaseEnd, jitter: f64) -> RetryDecision {
        if self.errors >= MAX_ERRORS || self.crashes >= MAX_CRASHES || self.lost >= MAX_LOSSES {
            return RetryDecision::Dead;
        }
        let steps = match cause {
            LeaseEnd::Failed => self.errors,
            LeaseEnd::Crashed => self.crashes,
            // Hosts vanish for reasons unrelated to the tile, so the first losses cause no delay.
            LeaseEnd::Lost => self.lost - LOSSES_BEFORE_ISOLATION,
            LeaseEnd::Released | LeaseEnd::Rejected => 0,
        };
        if steps <= 0 {
            return RetryDecision::Retry { delay_ms: 0 };
        }
        let doubled = BACK_OFF * (1 << (steps - 1).min(10));
        let delay = doubled.min(MAX_BACK_OFF).mul_f64(0.5 + 0.5 * jitter);
        RetryDecision::Retry { delay_ms: delay.as_millis() as i64 }
    }
}

/// Witness against a tile: the owner of all its leases that failed or were lost. Workers of one key are one witness, which
/// kills no tile that another could render.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Blame(Option<String>);

impl Blame {
    /// The name of several owners, or of the pool, which is trusted.
    const CONFIRMED: &str = "";

    fn is_confirmed(&self) -> bool {
        self.0.as_deref() == Some(Self::CONFIRMED)
    }

    /// After one more failure on a worker of this owner.
    fn confirmed_by(self, owner: &str, is_pool: bool) -> Self {
        let is_same = self.0.as_ref().is_none_or(|known| known == owner);
        Self(Some(if is_same && !is_pool { owner.to_owned() } else { Self::CONFIRMED.to_owned() }))
    }
}

/// A live lease and its tile. A lease whose job has ended is not live, even before it is voided.
#[derive(Clone, Debug)]
pub(super) struct LiveLease {
    pub(super) lease: String,
    pub(super) worker: String,
    /// Owner of its worker.
    pub(super) owner: String,
    /// Whether its worker is one of the pool.
    is_pool: bool,
    pub(super) tile: i64,
    pub(super) job: i64,
    pub(super) frame: u32,
    pub(super) stitch: bool,
    pub(super) granted_ms: i64,
    counters: Counters,
    blame: Blame,
}

/// Columns of a [`LiveLease`], up to a condition.
macro_rules! held_where {
    ($condition:literal) => {
        concat!(
            "SELECT lease.id AS lease, lease.worker, coalesce(worker.owner, worker.id) AS owner, worker.pool, tile.id AS tile,
                    tile.job, tile.frame, tile.kind, lease.granted_ms, tile.errors, tile.crashes, tile.lost,
                    tile.interrupts, tile.blamed_by
             FROM lease JOIN tile ON tile.id = lease.tile JOIN job ON job.number = tile.job
             JOIN worker ON worker.id = lease.worker
             WHERE @unindexed(lease.ended) IS NULL AND job.finished_at_ms IS NULL AND ",
            $condition
        )
    };
}

impl LiveLease {
    /// Reads a row with the columns of [`held_where`].
    pub(super) fn read(row: &Row) -> Result<Self> {
        Ok(Self {
            lease: row.get("lease")?,
            worker: row.get("worker")?,
            owner: row.get("owner")?,
            is_pool: row.get("pool")?,
            tile: row.get("tile")?,
            job: row.get("job")?,
            frame: row.get("frame")?,
            stitch: row.get::<String>("kind")? == "stitch",
            granted_ms: row.get("granted_ms")?,
            counters: Counters {
                errors: row.get("errors")?,
                crashes: row.get("crashes")?,
                lost: row.get("lost")?,
                interrupts: row.get("interrupts")?,
            },
            blame: Blame(row.get("blamed_by")?),
        })
    }
}

/// The live ones of a worker's given leases.
pub(super) async fn live_leases_among(
    connection: &mut Connection,
    worker: WorkerId,
    leases: &[LeaseId],
) -> Result<Vec<LiveLease>> {
    let rows = db::query(held_where!("@unindexed(lease.worker) = ? AND lease.id IN (SELECT value FROM @texts(?))"))
        .bind(worker.to_string())
        .bind(json_list(leases))
        .fetch_all(connection)
        .await?;
    rows.iter().map(LiveLease::read).collect()
}

/// Live leases of a worker.
pub(super) async fn live_lease_ids(connection: &mut Connection, worker: &str) -> Result<Vec<String>> {
    Ok(live_leases(connection, worker).await?.into_iter().map(|live| live.lease).collect())
}

/// Live lease, with the data that a sync needs.
pub(super) struct LeaseGrant {
    pub(super) lease: String,
    pub(super) granted_ms: i64,
}

impl LeaseGrant {
    /// Of a live lease.
    pub(super) fn of(live: &LiveLease) -> Self {
        Self { lease: live.lease.clone(), granted_ms: live.granted_ms }
    }
}

/// Live leases of a worker. The index is forced, because with another one the query would read every lease the
/// worker ever had.
pub(super) async fn live_leases(connection: &mut Connection, worker: &str) -> Result<Vec<LeaseGrant>> {
    let rows = db::query(
        "SELECT lease.id, lease.granted_ms FROM lease @index(lease_live_by_worker)
         @join tile ON tile.id = lease.tile @join job ON job.number = tile.job
         WHERE lease.worker = ? AND lease.ended IS NULL AND job.finished_at_ms IS NULL",
    )
    .bind(worker)
    .fetch_all(connection)
    .await?;
    rows.iter().map(|row| Ok(LeaseGrant { lease: row.get("id")?, granted_ms: row.get("granted_ms")? })).collect()
}

/// A lease, if it is live.
pub(super) async fn live_lease(connection: &mut Connection, lease: &str) -> Result<Option<LiveLease>> {
    let row = db::query(held_where!("lease.id = ?")).bind(lease).fetch_optional(connection).await?;
    row.as_ref().map(LiveLease::read).transpose()
}

/// Ends a lease without a result. Its tile becomes ready again, or is dead and its job fails. If the tile has a
/// duplicate lease, it stays with the other worker.
pub(super) async fn end_without_result(
    connection: &mut Connection,
    held: &LiveLease,
    cause: LeaseEnd,
    message: &str,
    context: TransitionContext,
) -> Result<Wake> {
    let used_us = (context.now_ms - held.granted_ms).max(0).saturating_mul(1000);
    ends::give_up(connection, &held.lease, cause.name(), used_us, context).await?;
    if matches!(cause, LeaseEnd::Failed | LeaseEnd::Rejected) {
        exclusion::count_error(connection, &held.worker, message).await?;
    }
    if cause == LeaseEnd::Failed {
        exclusion::record_error(connection, &held.worker, held.job, context).await?;
    }
    let counters = held.counters.incremented(cause);
    let blame = match cause {
        LeaseEnd::Failed | LeaseEnd::Crashed | LeaseEnd::Lost => {
            held.blame.clone().confirmed_by(&held.owner, held.is_pool)
        }
        LeaseEnd::Rejected | LeaseEnd::Released => held.blame.clone(),
    };
    if is_leased(connection, held.tile).await? {
        set_state(connection, held.tile, TileState::Leased, counters, &blame).await?;
        return Ok(Wake::default());
    }
    let mut decision = counters.decide(cause, spread(held.tile));
    if decision == RetryDecision::Dead
        && !blame.is_confirmed()
        && exclusion::exclude_owner(connection, held, context).await?
    {
        decision = RetryDecision::Retry { delay_ms: 0 };
    }
    match decision {
        RetryDecision::Retry { delay_ms } => {
            let not_before_ms = if delay_ms == 0 { 0 } else { context.now_ms + delay_ms };
            let avoids = match cause {
                LeaseEnd::Failed => !exclusion::is_other_worker_excluded(connection, held, context).await?,
                LeaseEnd::Rejected => true,
                LeaseEnd::Crashed | LeaseEnd::Lost | LeaseEnd::Released => false,
            };
            let state = TileState::Ready { not_before_ms, avoid: avoids.then_some(held.worker.as_str()) };
            set_state(connection, held.tile, state, counters, &blame).await?;
            Ok(Wake::WORK)
        }
        RetryDecision::Dead => {
            set_state(connection, held.tile, TileState::Dead, counters, &blame).await?;
            let place = if held.stitch { "could not be stitched" } else { "could not be rendered" };
            let message = format!("frame {} {place}: {message}", held.frame);
            let job = crate::queue::job_id(connection, held.job).await?;
            tracing::warn!(%job, frame = held.frame, tile = held.tile, %message, "tile is dead");
            finish::fail(connection, held.job, &message, context).await?;
            Ok(Wake::UPDATES)
        }
    }
}

/// Whether a tile has a live lease.
async fn is_leased(connection: &mut Connection, tile: i64) -> Result<bool> {
    let live: Option<i64> = db::query_scalar("SELECT 1 FROM lease WHERE tile = ? AND ended IS NULL LIMIT 1")
        .bind(tile)
        .fetch_optional(connection)
        .await?;
    Ok(live.is_some())
}

/// State of a tile after one of its leases has ended.
enum TileState<'a> {
    /// Its duplicate lease is live.
    Leased,
    /// It may be leased from this time on, if possible not by the worker to avoid.
    Ready {
        not_before_ms: i64,
        avoid: Option<&'a str>,
    },
    Dead,
}

/// Sets the state of a leased tile, and who speaks against it.
async fn set_state(
    connection: &mut Connection,
    tile: i64,
    state: TileState<'_>,
    counters: Counters,
    blame: &Blame,
) -> Result<()> {
    let (name, not_before_ms, avoid) = match state {
        TileState::Leased => ("leased", 0, None),
        TileState::Ready { not_before_ms, avoid } => ("ready", not_before_ms, avoid),
        TileState::Dead => ("dead", 0, None),
    };
    let done = db::query(
        "UPDATE tile SET state = ?, not_before_ms = ?, avoid = coalesce(?, avoid), errors = ?, crashes = ?, lost = ?,
                         interrupts = ?, blamed_by = ?
         WHERE id = ? AND state = 'leased'",
    )
    .bind(name)
    .bind(not_before_ms)
    .bind(avoid)
    .bind(counters.errors)
    .bind(counters.crashes)
    .bind(counters.lost)
    .bind(counters.interrupts)
    .bind(blame.0.as_deref())
    .bind(tile)
    .execute(connection)
    .await?;
    expect_rows("tile: lease ended", 1, done)
}

/// Renews live leases.
pub(super) async fn renew(connection: &mut Connection, leases: &[&str], context: TransitionContext) -> Result<()> {
    if leases.is_empty() {
        return Ok(());
    }
    let renewed = db::query(
        "UPDATE lease SET expires_ms = ? WHERE @unindexed(ended) IS NULL AND id IN (SELECT value FROM @texts(?))",
    )
    .bind(context.now_ms + context.lease_ms)
    .bind(json_list(leases))
    .execute(connection)
    .await?;
    expect_rows("lease: renewed", leases.len() as u64, renewed)
}

/// Expires overdue leases and marks remote workers as gone if they have not synced for one lease length.
pub(super) async fn rescue(connection: &mut Connection, context: TransitionContext) -> Result<(u64, Wake)> {
    let mut woken = Wake::default();
    let mut count = 0;
    if !context.expires_leases {
        return Ok((count, woken));
    }
    let missed_ms = context.now_ms - context.lease_ms;
    let expired: Vec<String> =
        db::query_scalar("SELECT id FROM lease WHERE ended IS NULL AND expires_ms <= ? ORDER BY expires_ms")
            .bind(context.now_ms)
            .fetch_all(&mut *connection)
            .await?;
    for lease in &expired {
        // The failure of a job, earlier in this loop, may have ended more of these leases.
        let Some(held) = live_lease(connection, lease).await? else { continue };
        let job = crate::queue::job_id(connection, held.job).await?;
        tracing::warn!(%lease, worker = %held.worker, %job, frame = held.frame, tile = held.tile, "lease expired");
        woken.add(
            end_without_result(connection, &held, LeaseEnd::Lost, "its workers vanished repeatedly", context).await?,
        );
        count += 1;
    }
    db::query("UPDATE worker SET state = 'gone' WHERE state <> 'gone' AND pool = 0 AND seen_ms <= ?")
        .bind(missed_ms)
        .execute(connection)
        .await?;
    Ok((count, woken))
}

/// Number from 0 to 1 that differs between neighboring tiles, so that those that failed together are not retried
/// together: the fractional parts of multiples of the golden ratio.
fn spread(tile: i64) -> f64 {
    (tile as f64 * 0.618_033_988_749_895).fract().abs()
}

/// Random number from 0 to 1, so that what failed together is not retried together.
pub(crate) fn jitter() -> f64 {
    f64::from(uuid::Uuid::new_v4().as_fields().0) / f64::from(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends_after(cause: LeaseEnd) -> Option<i64> {
        let mut counters = Counters::default();
        (1..=1000).find(|_| {
            counters = counters.incremented(cause);
            counters.decide(cause, 0.5) == RetryDecision::Dead
        })
    }

    #[test]
    fn each_lease_end_has_its_own_limit() {
        assert_eq!(ends_after(LeaseEnd::Failed), Some(3));
        assert_eq!(ends_after(LeaseEnd::Crashed), Some(3));
        assert_eq!(ends_after(LeaseEnd::Lost), Some(50));
        assert_eq!(ends_after(LeaseEnd::Released), None);
    }

    #[test]
    fn back_off_grows_and_is_bounded() {
        let lost = |lost| Counters { lost, ..Counters::default() }.decide(LeaseEnd::Lost, 1.0);
        assert_eq!(lost(1), RetryDecision::Retry { delay_ms: 0 });
        assert_eq!(lost(2), RetryDecision::Retry { delay_ms: 0 });
        assert_eq!(lost(3), RetryDecision::Retry { delay_ms: 100 });
        assert_eq!(lost(4), RetryDecision::Retry { delay_ms: 200 });
        assert_eq!(lost(49), RetryDecision::Retry { delay_ms: 5000 });
    }

    #[test]
    fn back_off_grows_after_failures_and_crashes_but_not_releases() {
        let delay = |counters: Counters, cause, jitter| match counters.decide(cause, jitter) {
            RetryDecision::Retry { delay_ms } => delay_ms,
            RetryDecision::Dead => panic!("{counters:?}"),
        };
        let failed = |errors| Counters { errors, ..Counters::default() };
        let crashed = |crashes| Counters { crashes, ..Counters::default() };
        assert_eq!([1, 2].map(|errors| delay(failed(errors), LeaseEnd::Failed, 1.0)), [100, 200]);
        assert_eq!([1, 2].map(|crashes| delay(crashed(crashes), LeaseEnd::Crashed, 1.0)), [100, 200]);
        assert_eq!(
            [1, 2].map(|errors| delay(failed(errors), LeaseEnd::Failed, 0.0)),
            [50, 100],
            "half of it is random"
        );
        assert_eq!(delay(failed(2), LeaseEnd::Released, 1.0), 0);
        assert_eq!(delay(Counters { interrupts: 1000, ..Counters::default() }, LeaseEnd::Released, 1.0), 0);
    }

    #[test]
    fn workers_of_one_owner_are_one_witness() {
        let blame = Blame(None).confirmed_by("key", false);
        assert_eq!(blame, Blame(Some("key".to_owned())));
        assert!(!blame.clone().confirmed_by("key", false).is_confirmed());
        assert!(blame.clone().confirmed_by("another", false).confirmed_by("key", false).is_confirmed());
        assert!(
            blame.confirmed_by("pool", true).is_confirmed() && Blame(None).confirmed_by("pool", true).is_confirmed()
        );
    }

    #[test]
    fn neighboring_tiles_are_spread() {
        let spreads: Vec<f64> = (1..=8).map(spread).collect();
        assert!(spreads.iter().all(|spread| (0.0..=1.0).contains(spread)), "{spreads:?}");
        assert!(spreads.windows(2).all(|pair| (pair[0] - pair[1]).abs() > 0.3), "{spreads:?}");
    }

    #[test]
    fn jitter_is_a_fraction_and_varies() {
        let drawn: Vec<f64> = (0..100).map(|_| jitter()).collect();
        assert!(drawn.iter().all(|jitter| (0.0..=1.0).contains(jitter)), "{drawn:?}");
        assert!(drawn.iter().any(|&jitter| jitter < 0.4) && drawn.iter().any(|&jitter| jitter > 0.6), "{drawn:?}");
    }
}
