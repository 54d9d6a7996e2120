//! The numbered SQL files of `migrations/`, embedded in the program, as the migrators of both engines.

use std::sync::LazyLock;

use rust_embed::RustEmbed;
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::{AssertSqlSafe, SqlSafeStr};

#[derive(RustEmbed)]
#[folder = "../migrations"]
struct Files;

/// Migrations of SQLite.
pub(super) static SQLITE: LazyLock<Migrator> = LazyLock::new(|| migrator(""));
/// Migrations of PostgreSQL.
pub(super) static POSTGRES: LazyLock<Migrator> = LazyLock::new(|| migrator("postgres/"));

/// The migrations of a folder: `0001_farm.sql` is version 1, "farm".
fn migrator(folder: &str) -> Migrator {
    let migration = |path: &str| {
        let name = path.strip_prefix(folder).filter(|name| !name.contains('/'))?.strip_suffix(".sql")?;
        let (version, description) = name.split_once('_').expect("a migration has a number and a name");
        let version = version.parse().expect("a migration begins with its number");
        let text = Files::get(path).expect("a listed file is embedded").data.into_owned();
        let text = AssertSqlSafe(String::from_utf8(text).expect("the files are SQL")).into_sql_str();
        Some(Migration::new(version, description.replace('_', " ").into(), MigrationType::Simple, text, false))
    };
    Migrator::with_migrations(Files::iter().filter_map(|path| migration(&path)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_is_a_migration_of_one_engine() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../migrations");
        for (folder, migrator) in [(folder.to_owned(), &SQLITE), (format!("{folder}/postgres"), &POSTGRES)] {
            let files = std::fs::read_dir(folder).expect("the folder is there").flatten();
            let files = files.filter(|file| file.path().extension().is_some_and(|extension| extension == "sql"));
            assert_eq!(migrator.iter().count(), files.count());
            assert!(migrator.iter().is_sorted_by_key(|migration| migration.version));
            assert_eq!(migrator.iter().next().map(|first| (first.version, &*first.description)), Some((1, "farm")));
        }
    }
}
