//! PostgreSQL in tests: a cluster of its own in a temporary folder, the tables of `migrations/postgres`, and the statements
//! that a test has run.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::os::unix::fs::chown;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use sqlx::postgres::{PgConnectOptions, PgConnection, PgTypeInfo, Postgres};
use sqlx::{
    AssertSqlSafe, Column as _, ConnectOptions, Executor, Row as _, SqlSafeStr, Statement as _, Type, TypeInfo,
};
use tempfile::TempDir;

use crate::db::dialect::{Dialect, translate};
use crate::db::value::Value;
use crate::db::{Database, Statement, migrations, query};
use crate::skip::skip;

/// Types that a row's columns may have.
const COLUMN_TYPES: [&str; 6] = ["INT8", "INT4", "BOOL", "FLOAT8", "TEXT", "BYTEA"];
/// Time for a cluster to start.
const START_TIMEOUT: Duration = Duration::from_mins(1);

thread_local! {
    /// Statements that this test has run, with the types of their parameters. A test's runtime has one thread.
    static SEEN: RefCell<BTreeMap<&'static str, Vec<PgTypeInfo>>> = RefCell::default();
}

/// Records a statement.
pub(in crate::db) fn record(statement: &Statement) {
    let Some((text, values)) = statement.parts() else { return };
    let of_sqlite = ["PRAGMA", "BEGIN", "COMMIT", "ROLLBACK", "SAVEPOINT", "RELEASE"];
    if of_sqlite.iter().any(|word| text.starts_with(word)) {
        return;
    }
    let kinds = values.iter().map(|value| match value {
        Value::Integer(_) => <i64 as Type<Postgres>>::type_info(),
        Value::Real(_) => <f64 as Type<Postgres>>::type_info(),
        Value::Text(_) => <str as Type<Postgres>>::type_info(),
        Value::Bytes(_) => <Vec<u8> as Type<Postgres>>::type_info(),
    });
    SEEN.with_borrow_mut(|seen| {
        seen.entry(text).or_insert_with(|| kinds.collect());
    });
}

/// A running cluster; it is stopped and removed when it is dropped.
struct Cluster {
    server: Child,
    folder: TempDir,
}

impl Cluster {
    /// Starts one with an empty farm, or skips the test if PostgreSQL is not installed.
    async fn start() -> Option<(Self, PgConnection)> {
        let Some(programs) = programs() else {
            skip("postgres", "PostgreSQL's initdb is not installed, so no statement is prepared for it");
            return None;
        };
        let folder = tempfile::tempdir().expect("a temporary folder");
        let user = unprivileged_user();
        if let Some(user) = user {
            chown(folder.path(), Some(user), None).expect("its owner can be changed");
        }
        let data = folder.path().join("data");
        let made = command(&programs.join("initdb"), user)
            .args(["--auth=trust", "--username=sdfarm", "--encoding=UTF8", "--locale=C", "--no-sync", "--pgdata"])
            .arg(&data)
            .output()
            .expect("initdb runs");
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let server = command(&programs.join("postgres"), user)
            .args(["-c", "listen_addresses=", "-c", "fsync=off", "-k"])
            .arg(folder.path())
            .arg("-D")
            .arg(&data)
            .stderr(Stdio::null())
            .spawn()
            .expect("postgres runs");
        let cluster = Self { server, folder };
        let mut connection = cluster.connect().await;
        migrations::POSTGRES.run(&mut connection).await.expect("the tables can be made");
        Some((cluster, connection))
    }

    async fn connect(&self) -> PgConnection {
        let options = PgConnectOptions::new().socket(self.folder.path()).username("sdfarm").database("postgres");
        let options = options.disable_statement_logging();
        let attempts = async {
            loop {
                match options.connect().await {
                    Ok(connection) => return connection,
                    Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
                }
            }
        };
        tokio::time::timeout(START_TIMEOUT, attempts).await.expect("the cluster starts")
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        drop(self.server.kill());
        drop(self.server.wait());
    }
}

/// Folder of PostgreSQL's programs, which distributions keep off the path.
fn programs() -> Option<PathBuf> {
    let versions = std::fs::read_dir("/usr/lib/postgresql").ok()?;
    let mut folders: Vec<PathBuf> = versions.flatten().map(|entry| entry.path().join("bin")).collect();
    folders.retain(|folder| folder.join("initdb").is_file());
    folders.sort();
    folders.pop()
}

/// User for a cluster if this process is root, as whom PostgreSQL refuses to run.
fn unprivileged_user() -> Option<u32> {
    if !rustix::process::geteuid().is_root() {
        return None;
    }
    let users = std::fs::read_to_string("/etc/passwd").expect("there are users");
    let id = |name: &str| {
        let user = users.lines().find(|line| line.split(':').next() == Some(name))?;
        user.split(':').nth(2)?.parse().ok()
    };
    Some(id("postgres").or_else(|| id("nobody")).expect("the system has the user nobody"))
}

fn command(program: &Path, user: Option<u32>) -> Command {
    let mut command = Command::new(program);
    command.env_clear().current_dir("/").stdin(Stdio::null()).stdout(Stdio::null());
    if let Some(user) = user {
        command.uid(user);
    }
    command
}

/// Prepares for PostgreSQL every statement that this test has run; returns how many, or `None` if it is not installed.
pub(crate) async fn prepare_all() -> Option<usize> {
    let (cluster, mut connection) = Cluster::start().await?;
    let seen = SEEN.take();
    let mut failed = Vec::new();
    for (text, parameters) in &seen {
        let translated = translate(text, Dialect::Postgres);
        match connection.prepare_with(AssertSqlSafe(translated.clone()).into_sql_str(), parameters).await {
            Err(error) => failed.push(format!("{error} in {translated}")),
            Ok(statement) => failed.extend(
                (statement.columns().iter())
                    .filter(|column| !COLUMN_TYPES.contains(&column.type_info().name()))
                    .map(|column| format!("{} is {} in {translated}", column.name(), column.type_info())),
            ),
        }
    }
    assert!(failed.is_empty(), "{} of {} statements:\n{}", failed.len(), seen.len(), failed.join("\n\n"));
    drop(cluster);
    Some(seen.len())
}

#[tokio::test]
async fn both_databases_have_the_same_tables_columns_and_indexes() {
    let Some((cluster, mut connection)) = Cluster::start().await else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let store = Database::open_file(folder.path()).await.expect("opens");
    let of_sqlite = query(
        "SELECT tables.name || '.' || columns.name || ' ' || columns.type
                || CASE WHEN columns.\"notnull\" OR columns.pk THEN ' NOT NULL' ELSE '' END AS line
         FROM sqlite_master AS tables CROSS JOIN pragma_table_info(tables.name) AS columns
         WHERE tables.type = 'table' AND tables.name NOT LIKE 'sqlite_%' AND tables.name NOT LIKE '_sqlx_%'
         UNION ALL SELECT name FROM sqlite_master WHERE type = 'index' AND sql IS NOT NULL",
    );
    let of_sqlite = of_sqlite.scalar::<String>().fetch_all(store.readers()).await.expect("reads");
    let of_postgres = "SELECT table_name || '.' || column_name || ' '
                || CASE data_type WHEN 'bigint' THEN 'INTEGER' WHEN 'double precision' THEN 'REAL' WHEN 'bytea' THEN 'BLOB'
                                  ELSE upper(data_type) END
                || CASE WHEN is_nullable = 'NO' THEN ' NOT NULL' ELSE '' END
         FROM information_schema.columns WHERE table_schema = 'public' AND table_name NOT LIKE '\\_sqlx\\_%'
         UNION ALL SELECT indexname FROM pg_indexes WHERE schemaname = 'public' AND indexname NOT LIKE '%\\_pkey'
               AND indexname NOT LIKE '%\\_key'";
    let of_postgres = connection.fetch_all(of_postgres).await.expect("reads");
    let of_sqlite: BTreeSet<String> = of_sqlite.into_iter().collect();
    let of_postgres: BTreeSet<String> = of_postgres.iter().map(|row| row.get(0)).collect();
    let only =
        |these: &BTreeSet<String>, those: &BTreeSet<String>| these.difference(those).cloned().collect::<Vec<_>>();
    let none: Vec<String> = Vec::new();
    assert_eq!(only(&of_sqlite, &of_postgres), none, "only SQLite has these");
    assert_eq!(only(&of_postgres, &of_sqlite), none, "only PostgreSQL has these");
    store.close().await;
    drop(cluster);
}
