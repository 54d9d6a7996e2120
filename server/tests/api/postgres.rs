//! A farm on PostgreSQL: what its server says of a database that it cannot use, and what a lost connection costs. The tests
//! need the server of `tests/on_postgres`.

use std::path::Path;

use proto::job::JobState;
use server::{PostgresAddress, Server, StartError};

use super::harness::{Farm, assert_state, config, in_time, small_job};
use crate::postgres_server::{self, cut_connections, psql};

/// Starts a server on a database that it must refuse; returns its error.
async fn start_error(data: &Path, address: &str) -> String {
    let mut config = config(data);
    config.database = Some(address.parse().expect("an address"));
    Server::start(config).await.expect_err("the server must not start").to_string()
}

#[tokio::test]
async fn a_database_that_cannot_be_used_is_refused_with_the_cure() {
    let Some(server) = postgres_server::required() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let own = postgres_server::database_of(folder.path()).expect("a database");
    let host = server.rsplit('@').next().expect("an address");
    psql(&own, "DROP ROLE IF EXISTS guest; CREATE ROLE guest LOGIN");
    for (address, parts) in [
        ("postgres://sdfarm@127.0.0.1:1/sdfarm".to_owned(), ["Connection refused", "correct the host and port"]),
        (format!("{server}/nowhere"), ["\"nowhere\" does not exist", "createdb"]),
        (format!("postgres://stranger@{host}/postgres"), ["role \"stranger\" does not exist", "correct the user"]),
        (own.replace("sdfarm@", "guest@"), ["permission denied for schema public", "all rights"]),
    ] {
        let error = start_error(folder.path(), &address).await;
        assert!(parts.iter().all(|part| error.contains(part)), "{address}: {error}");
        let shown = address.parse::<PostgresAddress>().expect("an address").to_string();
        assert!(error.contains(&format!("the database {shown} cannot be used")), "{error}");
    }
}

#[tokio::test]
async fn a_lost_table_is_named_and_a_read_only_database_is_refused() {
    let Some(_) = postgres_server::required() else { return };
    let folder = Farm::start().await.stop().await;
    let address = postgres_server::database_of(folder.path()).expect("a database");
    let name = address.rsplit('/').next().expect("a name");
    psql(&address, &format!("ALTER DATABASE {name} SET default_transaction_read_only = on"));
    let error = start_error(folder.path(), &address).await;
    assert!(error.contains("read-only") && error.contains("the primary"), "{error}");
    let writable = format!("{address}?options=-c%20default_transaction_read_only%3Doff");
    psql(&writable, &format!("ALTER DATABASE {name} RESET default_transaction_read_only"));
    psql(&address, "ALTER TABLE lease RENAME TO leases");
    let error = start_error(folder.path(), &address).await;
    assert!(error.contains("\"lease\" does not exist") && error.contains("pg_restore"), "{error}");
    psql(&address, "ALTER TABLE leases RENAME TO lease");
    psql(&address, "INSERT INTO _sqlx_migrations VALUES (9999, 'later', now(), true, '\\x00', 1)");
    let error = start_error(folder.path(), &address).await;
    assert!(error.contains("9999") && error.contains("newer release"), "{error}");
    psql(&address, "DELETE FROM _sqlx_migrations WHERE version = 9999");
    Farm::start_in(folder, |_| {}).await.stop().await;
}

#[tokio::test]
async fn a_database_has_one_server_and_a_data_folder_one_database() {
    let Some(server) = postgres_server::required() else { return };
    let farm = Farm::start().await;
    let address = postgres_server::database_of(farm.folder.path()).expect("a database");
    let other = tempfile::tempdir().expect("a temporary folder");
    let error = start_error(other.path(), &address).await;
    assert!(error.contains("another server uses it") && error.contains("--database"), "{error}");
    let folder = farm.stop().await;
    for wrong in [None, Some(format!("{server}/postgres"))] {
        let mut config = config(folder.path());
        config.database = wrong.map(|address| address.parse().expect("an address"));
        let error = Server::start(config).await.expect_err("it has another database");
        assert!(matches!(error, StartError::OtherDatabase { .. }), "{error}");
        assert!(error.to_string().contains("start it with the database it has"), "{error}");
    }
    Farm::start_in(folder, |_| {}).await.stop().await;
}

#[tokio::test]
async fn connections_that_are_cut_lose_and_double_nothing() {
    let Some(_) = postgres_server::required() else { return };
    let farm = Farm::start().await;
    let address = postgres_server::database_of(farm.folder.path()).expect("a database");
    // Between two requests a lost connection costs nothing.
    for seed in 0..5 {
        let job = farm.submit(&small_job(seed)).await;
        assert!(cut_connections(&address) > 0);
        farm.worker("one").await.work_off().await;
        assert_state(&farm, job.id, JobState::Succeeded).await;
    }
    // In the midst of requests it may fail them, with an answer that tells to retry.
    let body = small_job(100).to_string();
    let rounds = 20;
    for round in 0..rounds {
        let send = async |key: String| {
            let post = farm.client.post(farm.url("/v1/jobs")).header("idempotency-key", key).body(body.clone());
            in_time(post.send()).await.expect("the server responds").status().as_u16()
        };
        let key = format!("round {round}");
        let cutting = tokio::task::spawn_blocking({
            let address = address.clone();
            move || cut_connections(&address)
        });
        let mut status = send(key.clone()).await;
        cutting.await.expect("psql runs");
        while status == 503 {
            status = send(key.clone()).await;
        }
        assert!(status == 201 || status == 200, "{status}");
    }
    let jobs = psql(&address, "SELECT count(*) FROM job");
    assert_eq!(jobs, (5 + rounds).to_string(), "each key has one job");
    let folder = farm.stop().await;
    let report = server::check_integrity(folder.path()).await.expect("checked");
    assert_eq!(report.violations, Vec::<String>::new());
}
