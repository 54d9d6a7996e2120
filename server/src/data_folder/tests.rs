//! Migration: databases of earlier releases are migrated with all their data.

use sqlx::Connection;

use super::{Depth, Repair, Severity, run_checks};
use crate::db::{self, Database};

/// Tables of earlier releases: migrations 1 to 8, as their files have them; the first release had two.
const EARLIER: [(i64, &str, &str); 8] = [
    (1, "farm", include_str!("../../../migrations/0001_farm.sql")),
    (2, "nodes", include_str!("../../../migrations/0002_nodes.sql")),
    (3, "keys", include_str!("../../../migrations/0003_keys.sql")),
    (4, "queue", include_str!("../../../migrations/0004_queue.sql")),
    (5, "events", include_str!("../../../migrations/0005_events.sql")),
    (6, "webhooks", include_str!("../../../migrations/0006_webhooks.sql")),
    (7, "retention", include_str!("../../../migrations/0007_retention.sql")),
    (8, "watch", include_str!("../../../migrations/0008_watch.sql")),
];
/// Number of migrations of the first release.
const FIRST_RELEASE: usize = 2;

const ROWS: &str = "
    INSERT INTO job (number, id, name, submitter, priority, state, fresh, width_px, height_px, samples, pixel_bytes,
                     edge_px, media_type, frames_total, frames_opened, frames_stored, tiles_total, tiles_done,
                     rays_total, rays_done, rays_peak, warnings, created_at_ms, started_at_ms, finished_at_ms, nodes)
    VALUES (1, '01890a5d-ac96-774b-bcce-b302099a8057', 'old', 'local', 5, 'succeeded', 0, 64, 64, 1, 16,
            NULL, 'image/png', 1, 1, 1, 1, 1, 4096, 4096, 4096, '[]', 1767225600001, 1767225600002, 1767225600003, 3),
           (2, '01890a5d-ac96-774b-bcce-b302099a8058', 'waiting', 'local', 0, 'running', 0, 64, 64, 1, 16,
            NULL, 'image/png', 2, 1, 0, 2, 0, 8192, 0, 0, '[]', 1767225600004, 1767225600005, NULL, 0);
    INSERT INTO job_file (job, text) VALUES (1, '{}'), (2, '{}');
    INSERT INTO picture (key, hash, size_bytes, media_type, stored_at_ms)
    VALUES ('a key', '37b6bf34e9e2a7c4c5bc2c1e34f3a1ed8f9f6d2f6d0e4f1f2a1b0c9d8e7f6a5b', 5, 'image/png', 1767225600003);
    INSERT INTO frame (job, number, state, picture_key, tiles_total, tiles_done, picture, size_bytes)
    VALUES (1, 0, 'stored', 'a key', 1, 1, '37b6bf34e9e2a7c4c5bc2c1e34f3a1ed8f9f6d2f6d0e4f1f2a1b0c9d8e7f6a5b', 5),
           (2, 0, 'open', 'another key', 1, 0, NULL, NULL);
    INSERT INTO tile (id, job, frame, kind, position, x_px, y_px, width_px, height_px, rays, state, epoch)
    VALUES (7, 2, 0, 'render', 0, 0, 0, 64, 64, 4096, 'leased', 1);
    INSERT INTO worker (id, name, device, state, pool, process, generation, seen_ms)
    VALUES ('01890a5d-ac96-774b-bcce-b302099a8059', 'pool-1', 'cpu', 'ready', 1, 99, 1, 0);
    INSERT INTO lease (id, tile, epoch, worker, generation, granted_ms, expires_ms)
    VALUES ('01890a5d-ac96-774b-bcce-b302099a8060', 7, 1, '01890a5d-ac96-774b-bcce-b302099a8059', 1, 0, 30000);
    UPDATE meta SET value = 4 WHERE name = 'boot_generation';
";

/// Creates the database of an old farm, as a release with this many migrations left it.
async fn old_farm(data: &std::path::Path, migrations: usize, later_rows: &'static str) {
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(Database::file(data)).create_if_missing(true);
    let mut connection = sqlx::sqlite::SqliteConnection::connect_with(&options).await.expect("opens");
    let done = "CREATE TABLE _sqlx_migrations (
        version BIGINT PRIMARY KEY, description TEXT NOT NULL, installed_on TIMESTAMP NOT NULL DEFAULT CURRENT_TIMESTAMP,
        success BOOLEAN NOT NULL, checksum BLOB NOT NULL, execution_time BIGINT NOT NULL)";
    sqlx::raw_sql(done).execute(&mut connection).await.expect("makes");
    for (version, name, text) in EARLIER.into_iter().take(migrations) {
        sqlx::raw_sql(text).execute(&mut connection).await.expect("migrates");
        let (_, checksum) = db::migrations().find(|(known, _)| *known == version).expect("never dropped");
        sqlx::query("INSERT INTO _sqlx_migrations VALUES (?, ?, CURRENT_TIMESTAMP, TRUE, ?, 1)")
            .bind(version)
            .bind(name)
            .bind(checksum)
            .execute(&mut connection)
            .await
            .expect("notes");
    }
    sqlx::raw_sql(ROWS).execute(&mut connection).await.expect("fills");
    sqlx::raw_sql(later_rows).execute(&mut connection).await.expect("fills");
    connection.close().await.expect("closes");
}

#[tokio::test]
async fn a_first_release_farm_is_migrated_with_its_data() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    old_farm(folder.path(), FIRST_RELEASE, "").await;
    let before = run_checks(folder.path(), Depth::Names, Repair::None).await.expect("looks");
    let schema = before.iter().find(|finding| finding.subject == "schema").expect("a finding");
    assert!(schema.severity != Severity::Error && schema.message.contains("pending"), "{schema:?}");

    let store = Database::open_file(folder.path()).await.expect("upgrades");
    let (clock, _hand) = crate::clock::Clock::manual();
    let (queue, recovered) = crate::queue::Queue::open(store.into(), clock, 1000, "test").await.expect("opens");
    assert_eq!((recovered.generation, recovered.jobs, recovered.leases), (5, 1, 1));
    let page = queue.jobs(None, None, 10, None).await.expect("lists");
    let seen: Vec<(&str, &str, u64)> =
        page.jobs.iter().map(|job| (job.name.as_str(), job.state.name(), job.frames.done)).collect();
    assert_eq!(seen, [("waiting", "running", 0), ("old", "succeeded", 1)]);
    let counts = queue.counts().await.expect("counts");
    assert_eq!((counts.tiles_ready, counts.leases, counts.rays_left), (1, 0, 8192));
    let versions: i64 =
        db::query_scalar("SELECT count(*) FROM _sqlx_migrations").fetch_one(queue.readers()).await.expect("counts");
    assert_eq!(versions as usize, db::migrations().count());
    drop(queue);

    let after = run_checks(folder.path(), Depth::Names, Repair::None).await.expect("looks");
    let named = |subject| after.iter().filter(move |finding| finding.subject == subject).collect::<Vec<_>>();
    assert!(named("schema").iter().all(|finding| finding.severity == Severity::Ok), "{after:?}");
    assert!(named("database").iter().all(|finding| finding.severity == Severity::Ok), "{after:?}");
    assert!(named("store").iter().any(|finding| finding.message.contains("1 pictures are missing")), "{after:?}");
}

#[tokio::test]
async fn data_of_a_newer_release_is_rejected_with_the_reason() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    Database::open_file(folder.path()).await.expect("makes").close().await;
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(Database::file(folder.path()));
    let mut connection = sqlx::sqlite::SqliteConnection::connect_with(&options).await.expect("opens");
    sqlx::query("INSERT INTO _sqlx_migrations VALUES (9999, 'later', CURRENT_TIMESTAMP, TRUE, x'00', 1)")
        .execute(&mut connection)
        .await
        .expect("notes");
    connection.close().await.expect("closes");
    let findings = run_checks(folder.path(), Depth::Names, Repair::None).await.expect("looks");
    let wrong = findings.iter().find(|finding| finding.severity == Severity::Error).expect("a finding");
    assert_eq!(wrong.message, "migration 9999 is from a newer release");
}

/// Shares and a speed as a worker left them that reported a speed of almost zero.
const ABSURD_BOOKS: &str = "
    INSERT INTO share_clock (priority, served_us) VALUES (0, 9223372036854775807)
    ON CONFLICT DO UPDATE SET served_us = excluded.served_us;
    INSERT INTO share (submitter, priority, jobs, served_us) VALUES ('other', 0, 0, 9223372036854775807)
    ON CONFLICT DO UPDATE SET served_us = excluded.served_us;
    UPDATE share SET served_us = 9223372036854775807;
    UPDATE worker SET rays_per_second = 1e-3;
";

/// Largest amount served, and whether a speed is stored.
async fn books(data: &std::path::Path) -> (i64, Option<f64>) {
    let mut connection = super::database::open(data).await.expect("opens");
    let books =
        "SELECT (SELECT max(served_us) FROM share) AS served, (SELECT max(rays_per_second) FROM worker) AS speed";
    let books = db::query(books).fetch_one(&mut connection).await.expect("reads");
    (books.get("served").expect("a number"), books.get("speed").expect("a number or none"))
}

#[tokio::test]
async fn a_farm_with_absurd_shares_is_mended_by_its_migration() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    old_farm(folder.path(), EARLIER.len(), ABSURD_BOOKS).await;
    assert_eq!(books(folder.path()).await, (i64::MAX, Some(1e-3)));
    Database::open_file(folder.path()).await.expect("migrates").close().await;
    assert_eq!(books(folder.path()).await, (0, None));
}

#[tokio::test]
async fn doctor_finds_and_mends_absurd_shares() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    old_farm(folder.path(), EARLIER.len(), "").await;
    Database::open_file(folder.path()).await.expect("migrates").close().await;
    let books_of = async |repair| {
        let findings = run_checks(folder.path(), Depth::Names, repair).await.expect("looks");
        findings.into_iter().find(|finding| finding.subject == "books").expect("a finding")
    };
    assert_eq!(books_of(Repair::None).await.severity, Severity::Ok);
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(Database::file(folder.path()));
    let mut connection = sqlx::sqlite::SqliteConnection::connect_with(&options).await.expect("opens");
    sqlx::raw_sql(ABSURD_BOOKS).execute(&mut connection).await.expect_err("the columns have bounds");
    sqlx::raw_sql("UPDATE share SET served_us = 4611686018427387904").execute(&mut connection).await.expect("writes");
    connection.close().await.expect("closes");
    let found = books_of(Repair::None).await;
    assert_eq!(found.severity, Severity::Error, "{found:?}");
    assert!(found.cure.expect("a fix").contains("doctor --repair"));
    assert_eq!(books_of(Repair::Store).await.severity, Severity::Ok);
    assert_eq!(books_of(Repair::None).await.severity, Severity::Ok);
    assert_eq!(books(folder.path()).await, (0, None));
}
