//! Changes of a worker by an administrator: it drains, or takes no work until it is released.

use proto::WorkerId;

use crate::db::{self, Durability};
use crate::queue::{Connection, Queue, Result, Wake};

/// Change of a worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WorkerChange {
    /// It finishes what it holds, and exits.
    Drain,
    /// It finishes what it holds, and gets no more until it is released.
    Quarantine,
    /// It gets work again.
    Release,
}

/// Outcome of a change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WorkerChangeOutcome {
    /// The worker is in the requested state.
    Done,
    /// It drains, which is not undone.
    Draining,
    /// There is no such worker, or it has exited.
    Unknown,
}

impl WorkerChange {
    /// Statement that makes the change. A worker that is in that state already is left as it is.
    fn statement(self) -> &'static str {
        match self {
            Self::Drain => {
                "UPDATE worker SET state = 'draining' WHERE id = ? AND state IN ('starting', 'ready', 'quarantined')"
            }
            Self::Quarantine => {
                "UPDATE worker SET state = 'quarantined' WHERE id = ? AND state IN ('starting', 'ready')"
            }
            // Otherwise its next error would quarantine it again.
            Self::Release => {
                "UPDATE worker SET state = 'ready', wrong_results = 0 WHERE id = ? AND state = 'quarantined'"
            }
        }
    }

    fn target(self) -> &'static str {
        match self {
            Self::Drain => "draining",
            Self::Quarantine => "quarantined",
            Self::Release => "ready",
        }
    }
}

async fn change(connection: &mut Connection, worker: WorkerId, change: WorkerChange) -> Result<WorkerChangeOutcome> {
    let id = worker.to_string();
    let changed = db::query(change.statement()).bind(&id).execute(&mut *connection).await?;
    if changed.rows_affected() > 0 {
        if change == WorkerChange::Release {
            // Also of the workers that were quarantined with it, or were registered before it.
            db::query(
                "DELETE FROM strike WHERE worker = ?1 OR worker IN (SELECT id FROM worker AS same
                     WHERE same.pool = 0 AND same.owner = (SELECT owner FROM worker WHERE id = ?1 AND pool = 0))",
            )
            .bind(&id)
            .execute(connection)
            .await?;
        }
        tracing::info!(%worker, state = change.target(), "an administrator changed a worker's state");
        return Ok(WorkerChangeOutcome::Done);
    }
    let state: Option<String> =
        db::query_scalar("SELECT state FROM worker WHERE id = ?").bind(&id).fetch_optional(connection).await?;
    Ok(match state.as_deref() {
        None | Some("gone") => WorkerChangeOutcome::Unknown,
        Some("draining") if change != WorkerChange::Drain => WorkerChangeOutcome::Draining,
        Some(_) => WorkerChangeOutcome::Done,
    })
}

impl Queue {
    /// Changes a worker's state.
    pub(crate) async fn change_worker(&self, worker: WorkerId, to: WorkerChange) -> Result<WorkerChangeOutcome> {
        let done =
            self.database.write(Durability::Full, move |connection| Box::pin(change(connection, worker, to))).await?;
        // Others may now get what only this worker could render, and this one may wait for work.
        self.wake(Wake { work: true, news: true });
        Ok(done)
    }
}
