//! Verdicts: compares the hash of a second rendering with the first, and decides who was wrong.

use crate::db;
use std::collections::{BTreeMap, HashMap};

use db::Row;
use proto::LeaseId;
use proto::worker_protocol::{LeaseOutcome, LeaseReport};

use super::{VerificationOutcome, leases};
use crate::queue::tiles::reported::RejectedResult;
use crate::queue::tiles::undo;
use crate::queue::workers::exclusion;
use crate::queue::workers::state::WorkerState;
use crate::queue::{Connection, LeaseEnd, Result, TransitionContext, Wake, json_numbers, workers};

/// A result, and what the second worker rendered, if it differs.
struct Case {
    number: i64,
    job: i64,
    frame: u32,
    position: i64,
    first: Testimony,
    lease: String,
    second: Option<Testimony>,
}

/// A worker, and the hash that it delivered.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Testimony {
    worker: String,
    hash: String,
}

/// Decision about a case.
#[derive(Debug, PartialEq, Eq)]
enum Verdict {
    /// The first result was confirmed; this worker was wrong about it, if any.
    Confirmed { wrong: Option<String> },
    /// The first result is wrong; these workers were.
    Refuted { wrong: Vec<String> },
    /// Another worker must decide.
    Open,
    /// Three workers rendered three different things.
    Undecided,
}

impl Case {
    fn read(row: &Row) -> Result<Self> {
        let second: Option<String> = row.get("second_worker")?;
        let second = match second {
            Some(worker) => Some(Testimony { worker, hash: row.get("second_hash")? }),
            None => None,
        };
        Ok(Self {
            number: row.get("number")?,
            job: row.get("job")?,
            frame: row.get("frame")?,
            position: row.get("position")?,
            first: Testimony { worker: row.get("worker")?, hash: row.get("hash")? },
            lease: row.get("lease")?,
            second,
        })
    }

    /// Decides after another rendering; a worker of the pool is always right.
    fn decide(&self, hash: &str, is_pool: bool) -> Verdict {
        let first = || self.first.worker.clone();
        match &self.second {
            None if hash == self.first.hash => Verdict::Confirmed { wrong: None },
            None if is_pool => Verdict::Refuted { wrong: vec![first()] },
            None => Verdict::Open,
            Some(second) if hash == self.first.hash => Verdict::Confirmed { wrong: Some(second.worker.clone()) },
            Some(second) if hash == second.hash => Verdict::Refuted { wrong: vec![first()] },
            Some(second) if is_pool => Verdict::Refuted { wrong: vec![first(), second.worker.clone()] },
            Some(_) => Verdict::Undecided,
        }
    }
}

/// A live lease of a verifier.
pub(in crate::queue) struct VerifierLease {
    /// Its id.
    pub(in crate::queue) lease: String,
    case: Case,
}

/// Live leases of a worker on verifications.
pub(in crate::queue) async fn live_leases(connection: &mut Connection, worker: &str) -> Result<Vec<VerifierLease>> {
    let rows = db::query(
        "SELECT verification_lease.id, verification.* FROM verification JOIN verification_lease ON verification = number
         WHERE verifier = ?",
    )
    .bind(worker)
    .fetch_all(connection)
    .await?;
    rows.iter().map(|row| Ok(VerifierLease { lease: row.get("id")?, case: Case::read(row)? })).collect()
}

/// Records the results of verifications.
pub(in crate::queue) async fn deliver(
    connection: &mut Connection,
    worker: &WorkerState,
    live: &[VerifierLease],
    reports: &[LeaseReport],
    context: TransitionContext,
) -> Result<(VerificationOutcome, Wake)> {
    let (mut outcome, mut woken) = (VerificationOutcome::default(), Wake::default());
    let reported: HashMap<String, &LeaseOutcome> =
        reports.iter().map(|report| (report.lease.to_string(), &report.outcome)).collect();
    let mut cases: BTreeMap<i64, (&Case, &LeaseOutcome)> = BTreeMap::new();
    for lease in live {
        if let Some(verified) = reported.get(&lease.lease) {
            cases.entry(lease.case.number).or_insert((&lease.case, verified));
        }
    }
    let (mut released, mut failed, mut result_hashes) = (Vec::new(), Vec::new(), Vec::new());
    for (number, (case, verified)) in cases {
        match verified {
            LeaseOutcome::Blob { hash, .. } if case.position >= 0 => result_hashes.push((case, hash)),
            LeaseOutcome::Picture { hash, .. } if case.position < 0 => result_hashes.push((case, hash)),
            LeaseOutcome::Released => released.push(number),
            LeaseOutcome::Blob { .. }
            | LeaseOutcome::Picture { .. }
            | LeaseOutcome::BadBlobs { .. }
            | LeaseOutcome::Failed { .. } => {
                // Nothing can be said about the result: its blobs may be gone, or the verifier fails.
                failed.push(number);
            }
        }
    }
    woken.add(leases::release(connection, &released).await?);
    let (given_up, wake) = leases::fail(connection, &failed, &worker.id).await?;
    outcome.skipped += given_up;
    woken.add(wake);
    let mut dropped = Vec::new();
    let is_plain =
        |(case, hash): &(&Case, &String)| case.decide(hash, worker.is_pool) == Verdict::Confirmed { wrong: None };
    if result_hashes.iter().all(is_plain) {
        outcome.agreed += result_hashes.len() as u64;
        confirm(connection, result_hashes.iter().map(|(case, _)| *case)).await?;
        dropped.extend(result_hashes.iter().map(|(case, _)| case.number));
        result_hashes.clear();
    }
    drop_cases(connection, &dropped).await?;
    // In their order, because a verdict undoes what was delivered since the last confirmed result.
    for (case, hash) in result_hashes {
        woken.add(conclude(connection, case, &worker.id, hash, worker.is_pool, context, &mut outcome).await?);
    }
    Ok((outcome, woken))
}

/// Records for each worker the newest of its confirmed results.
async fn confirm(connection: &mut Connection, cases: impl Iterator<Item = &Case>) -> Result<()> {
    let mut newest: BTreeMap<&str, &str> = BTreeMap::new();
    for case in cases {
        let lease = newest.entry(&case.first.worker).or_insert(&case.lease);
        *lease = (*lease).max(&case.lease);
    }
    if newest.is_empty() {
        return Ok(());
    }
    let rows: Vec<_> = newest.into_iter().collect();
    db::query(
        "UPDATE worker SET verified_lease = @max(coalesce(verified_lease, ''), listed.value ->> 1) FROM @rows(?)
         WHERE worker.id = listed.value ->> 0",
    )
    .bind(serde_json::json!(rows).to_string())
    .execute(connection)
    .await?;
    Ok(())
}

async fn conclude(
    connection: &mut Connection,
    case: &Case,
    worker: &str,
    hash: &str,
    is_pool: bool,
    context: TransitionContext,
    outcome: &mut VerificationOutcome,
) -> Result<Wake> {
    let verdict = case.decide(hash, is_pool);
    if verdict == (Verdict::Confirmed { wrong: None }) {
        outcome.agreed += 1;
    } else {
        outcome.differed += 1;
        let job = crate::queue::job_id(connection, case.job).await?;
        tracing::error!(
            code = "result_differs", %job, frame = case.frame, position = case.position, first = ?case.first,
            second = ?case.second, verifier = worker, %hash, ?verdict, "a result was rendered again differently"
        );
    }
    let wrong = match verdict {
        Verdict::Open => {
            let mut woken = leases::release(connection, &[case.number]).await?;
            db::query("UPDATE verification SET second_worker = ?, second_hash = ? WHERE number = ?")
                .bind(worker)
                .bind(hash)
                .bind(case.number)
                .execute(&mut *connection)
                .await?;
            woken.add(Wake::WORK);
            return Ok(woken);
        }
        Verdict::Confirmed { wrong } => {
            confirm(connection, std::iter::once(case)).await?;
            wrong.into_iter().collect()
        }
        Verdict::Refuted { wrong } => wrong,
        Verdict::Undecided => Vec::new(),
    };
    drop_cases(connection, &[case.number]).await?;
    let mut woken = Wake::default();
    for wrong in wrong {
        let since = if wrong == case.first.worker { Some(case.lease.as_str()) } else { None };
        woken.add(condemn(connection, &wrong, since, context, outcome).await?);
    }
    Ok(woken)
}

/// Quarantines a worker whose result was wrong, and undoes what it delivered since its last confirmed result, or since the
/// lease of the wrong one if that is older.
async fn condemn(
    connection: &mut Connection,
    worker: &str,
    since: Option<&str>,
    context: TransitionContext,
    outcome: &mut VerificationOutcome,
) -> Result<Wake> {
    exclusion::quarantine_at_once(connection, worker, "another worker rendered a result of it differently").await?;
    let reason = "its worker is quarantined";
    let mut woken = workers::end_leases(connection, worker, LeaseEnd::Released, reason, context).await?;
    for statement in [
        "DELETE FROM verification WHERE worker = ?",
        "UPDATE verification SET second_worker = NULL, second_hash = NULL WHERE second_worker = ?",
    ] {
        db::query(statement).bind(worker).execute(&mut *connection).await?;
    }
    let undone = undo::undo_unconfirmed(connection, worker, since).await?;
    woken.add(Wake { work: true, news: true });
    outcome.forgotten.extend(undone);
    Ok(woken)
}

/// Releases the verifications whose results were rejected; returns the other rejected results.
pub(in crate::queue) async fn reject(
    connection: &mut Connection,
    worker: &str,
    rejected: &[RejectedResult],
) -> Result<(Vec<LeaseId>, Wake)> {
    if rejected.is_empty() {
        return Ok((Vec::new(), Wake::default()));
    }
    let live = leases::live_lease_ids(connection, worker).await?;
    let own: Vec<LeaseId> =
        rejected.iter().map(|result| result.lease).filter(|lease| live.contains(&lease.to_string())).collect();
    let ids: Vec<String> = own.iter().map(ToString::to_string).collect();
    let woken = leases::release_all(connection, &ids).await?;
    Ok((own, woken))
}

async fn drop_cases(connection: &mut Connection, numbers: &[i64]) -> Result<()> {
    if !numbers.is_empty() {
        db::query("DELETE FROM verification WHERE number IN (SELECT value FROM @numbers(?))")
            .bind(json_numbers(numbers.iter().copied()))
            .execute(connection)
            .await?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(worker: &str, hash: &str) -> Testimony {
        Testimony { worker: worker.to_owned(), hash: hash.to_owned() }
    }

    fn decide(second: Option<&str>, hash: &str, is_pool: bool) -> Verdict {
        let second = second.map(|hash| said("second", hash));
        let first = said("first", "a");
        Case { number: 1, job: 1, frame: 0, position: 0, first, lease: String::new(), second }.decide(hash, is_pool)
    }

    #[test]
    fn the_pool_or_a_majority_decides() {
        let refuted = |wrong: &[&str]| Verdict::Refuted { wrong: wrong.iter().map(ToString::to_string).collect() };
        for is_pool in [false, true] {
            assert_eq!(decide(None, "a", is_pool), Verdict::Confirmed { wrong: None });
            assert_eq!(decide(Some("b"), "a", is_pool), Verdict::Confirmed { wrong: Some("second".to_owned()) });
            assert_eq!(decide(Some("b"), "b", is_pool), refuted(&["first"]));
        }
        assert_eq!(decide(None, "b", false), Verdict::Open, "a third worker decides");
        assert_eq!(decide(None, "b", true), refuted(&["first"]));
        assert_eq!(decide(Some("b"), "c", true), refuted(&["first", "second"]));
        assert_eq!(decide(Some("b"), "c", false), Verdict::Undecided);
    }
}
