//! Tests of the audit log: what is recorded with a change, what is counted, what is pruned.

use super::*;
use crate::db;

fn record(kind: EntryKind, route: &str) -> AuditRecord {
    AuditRecord {
        kind,
        actor: "anna".to_owned(),
        key: None,
        address: "10.0.0.1".to_owned(),
        method: "POST".to_owned(),
        route: route.to_owned(),
        job: None,
        status: 200,
        code: None,
        request_id: "r".to_owned(),
    }
}

fn refused(address: u32, route: u32) -> AuditRecord {
    let code = Some("missing_key".to_owned());
    let address = format!("10.0.{}.{}", address / 256, address % 256);
    AuditRecord { address, status: 401, code, ..record(EntryKind::Refused, &format!("/{route}")) }
}

async fn log() -> (AuditLog, Arc<Database>, tempfile::TempDir) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let store = Arc::new(Database::open(folder.path()).await.expect("opens"));
    (AuditLog::new(Arc::clone(&store), Clock::manual().0), store, folder)
}

/// Writes a row, as a request does that changes something.
async fn change(store: &Database, fails: bool) {
    let done = store.write(Durability::Full, move |connection| {
        Box::pin(async move {
            db::query("UPDATE meta SET value = value + 1 WHERE name = 'paused'").execute(connection).await?;
            if fails { Err(DatabaseError::Closed) } else { Ok(()) }
        })
    });
    assert_eq!(done.await.is_err(), fails);
}

async fn entries(log: &AuditLog) -> Vec<AuditEntry> {
    log.page(None, 1000).await.expect("reads").entries
}

#[tokio::test]
async fn a_change_commits_its_entry_even_if_its_client_leaves() {
    let (log, store, _folder) = log().await;
    let left = tokio::time::timeout(
        Duration::from_millis(1),
        log.handle(record(EntryKind::Admin, "/v1/keys"), async {
            change(&store, false).await;
            std::future::pending::<()>().await;
        }),
    );
    // The client leaves at any time: either nothing is changed, or the change has its entry.
    assert!(left.await.is_err());
    // A write of its own waits for those before it.
    change(&store, false).await;
    let changes: i64 = db::query_scalar("SELECT value FROM meta WHERE name = 'paused'")
        .fetch_one(store.readers())
        .await
        .expect("reads");
    assert_eq!(i64::try_from(entries(&log).await.len()), Ok(changes - 1));
}

#[tokio::test]
async fn a_change_that_fails_leaves_no_entry_and_one_that_succeeds_leaves_one() {
    let (log, store, _folder) = log().await;
    let expected = record(EntryKind::Admin, "/v1/keys");
    let ((), entry) = log.handle(expected.clone(), change(&store, true)).await;
    assert!(!entry.is_written() && entries(&log).await.is_empty());
    let changes = async {
        change(&store, false).await;
        change(&store, false).await;
    };
    let ((), entry) = log.handle(expected.clone(), changes).await;
    assert!(entry.is_written());
    log.finish(Arc::clone(&entry), expected.clone()).await;
    let first = entries(&log).await;
    assert_eq!((first.len(), first[0].status), (1, 200));
    log.finish(entry, AuditRecord { status: 503, ..expected.clone() }).await;
    let corrected = entries(&log).await;
    assert_eq!((corrected.len(), corrected[0].status), (1, 503), "the outcome replaces what was expected");
    // A change outside the database is recorded when it is done.
    let ((), entry) = log.handle(expected.clone(), async {}).await;
    log.finish(entry, expected).await;
    assert_eq!(entries(&log).await.len(), 2);
}

#[tokio::test]
async fn an_entry_of_a_rejected_request_becomes_a_count() {
    let (log, store, _folder) = log().await;
    for _ in 0..3 {
        let ((), entry) = log.handle(record(EntryKind::Work, "/1"), change(&store, false)).await;
        assert!(entry.is_written());
        log.reject(Some(entry), refused(0, 1)).await;
    }
    log.flush().await.expect("writes");
    log.reject(None, refused(0, 1)).await;
    log.flush().await.expect("writes");
    let entries = entries(&log).await;
    assert_eq!(entries.len(), 1);
    assert_eq!((entries[0].times, entries[0].code.as_deref()), (4, Some("missing_key")));
}

#[tokio::test]
async fn sources_are_bounded_and_every_rejection_is_counted() {
    let (log, _store, _folder) = log().await;
    for route in 0..1000 {
        log.reject(None, refused(0, route)).await;
    }
    log.flush().await.expect("writes");
    let of_one_address = entries(&log).await;
    assert_eq!(of_one_address.len(), 65);
    assert_eq!(of_one_address.iter().map(|entry| entry.times).sum::<u32>(), 1000);
    assert_eq!((&*of_one_address[0].address, &*of_one_address[0].route), ("10.0.0.0", "*"));
    for address in 1..3000 {
        log.reject(None, refused(address, 0)).await;
    }
    log.flush().await.expect("writes");
    let everything = log.page(None, 10_000).await.expect("reads").entries;
    assert_eq!(everything.len(), 1001);
    assert_eq!(everything.iter().map(|entry| entry.times).sum::<u32>(), 3999);
}

#[tokio::test]
async fn a_new_period_has_new_entries() {
    let (log, _store, _folder) = log().await;
    log.reject(None, refused(0, 1)).await;
    assert_eq!(log.refusals.take_unwritten(600_000).len(), 1);
    assert!(log.refusals.take_unwritten(600_000).is_empty());
    log.reject(None, refused(0, 1)).await;
    log.flush().await.expect("writes");
    assert_eq!(entries(&log).await[0].times, 1);
}

#[tokio::test]
async fn each_kind_is_pruned_for_itself() {
    let (log, store, _folder) = log().await;
    let changed = log.handle(record(EntryKind::Admin, "/v1/keys"), change(&store, false)).await.1;
    assert!(changed.is_written());
    let filled = store.write(Durability::Relaxed, |connection| {
        Box::pin(async move {
            db::query(
                "INSERT INTO audit (at_ms, who, address, method, route, status, code, request_id, times, kind)
                 WITH RECURSIVE count (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM count WHERE n < ?)
                 SELECT 0, '-', '-', 'GET', '-', 401, 'missing_key', '', 1, 'refused' FROM count",
            )
            .bind(MAX_REFUSED_ENTRIES + 1500)
            .execute(connection)
            .await?;
            Ok(())
        })
    });
    filled.await.expect("writes");
    log.prune().await.expect("prunes");
    let counts = db::query("SELECT kind, count(*) AS entries FROM audit GROUP BY kind ORDER BY kind");
    let counts: Vec<(String, i64)> = (counts.fetch_all(store.readers()).await.expect("reads").iter())
        .map(|row| (row.get("kind").expect("a text"), row.get("entries").expect("a number")))
        .collect();
    let kept = i64::from(MAX_REFUSED_ENTRIES);
    assert_eq!(counts, [("admin".to_owned(), 1), ("refused".to_owned(), kept)]);
    let oldest: i64 = db::query_scalar("SELECT min(number) FROM audit WHERE kind = 'refused'")
        .fetch_one(store.readers())
        .await
        .expect("reads");
    assert_eq!(oldest, 1502, "the newest are kept");
}
