//! A row that the first write of a task also writes, in the same transaction: neither is there without the other.
//!
//! The database does not know what the row says; the audit log uses this for its entries.

use std::fmt::Debug;
use std::sync::Arc;

use futures_util::future::BoxFuture;

use super::{Connection, DatabaseError};

tokio::task_local! {
    /// Row of the task.
    static FIRST_WRITE: Arc<dyn FirstWrite>;
}

/// Row that is written with a task's first write.
pub(crate) trait FirstWrite: Debug + Send + Sync {
    /// Whether the row is committed.
    fn is_written(&self) -> bool;

    /// Writes the row in the transaction of the first write; returns its number.
    fn insert<'c>(&'c self, connection: &'c mut Connection) -> BoxFuture<'c, Result<i64, DatabaseError>>;

    /// Remembers the number of the committed row.
    fn set_number(&self, number: i64);
}

/// Runs a task whose first write also writes `row`.
pub(crate) async fn with_first_write<T>(row: Arc<dyn FirstWrite>, task: impl Future<Output = T>) -> T {
    FIRST_WRITE.scope(row, task).await
}

/// Row of the current task, if it has one.
pub(super) fn of_task() -> Option<Arc<dyn FirstWrite>> {
    FIRST_WRITE.try_with(Arc::clone).ok()
}
