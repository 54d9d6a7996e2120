//! A farm that moves to PostgreSQL and back. The tests need the server of `tests/on_postgres`.

use std::path::Path;
use std::process::Command;

use crate::support::{Farm, finish, rendered_here, run, sdfarm, succeed, text};
use crate::{jobs, postgres_server};

/// Every table and row of a database file in alphabetic order, as an independent reader prints them, without what each migration
/// notes for itself.
fn dump(file: &Path) -> String {
    const PROGRAM: &str = "import sqlite3, sys
for line in sorted(sqlite3.connect(sys.argv[1]).iterdump()):
    # A count of 0 says the same as none.
    if '_sqlx_migrations' not in line and not ('sqlite_sequence' in line and line.endswith(',0);')):
        print(line)";
    let mut python = Command::new("python3");
    python.args(["-c", PROGRAM]).arg(file);
    let output = finish(python, b"");
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout)
}

/// Starts a server on `FOLDER/data` and its own database, whatever the variables of the tests say.
fn start(folder: &Path, database: Option<&str>) -> Farm {
    let mut command = sdfarm(&["serve"]);
    match database {
        Some(address) => command.env("SDFARM_DATABASE", address),
        None => command.env_remove("SDFARM_DATABASE"),
    };
    Farm::start_by(command, folder, &["--workers", "1"])
}

#[test]
fn a_farm_moves_to_postgresql_and_back_with_every_row() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let word = data.to_str().expect("plain");
    let Some(database) = postgres_server::required().and_then(|_| postgres_server::database_of(&data)) else { return };
    let job = jobs::as_png(&jobs::sized(&jobs::named("csg"), 64, 2));
    let farm = start(folder.path(), None);
    let id = farm.accept(&job.to_string());
    farm.succeeded(&id);
    let deleted = farm.accept(&jobs::seeded(&job, 7).to_string());
    farm.succeeded(&deleted);
    assert_eq!(farm.send("DELETE", &format!("/v1/jobs/{deleted}"), &[], Vec::new()).status, 204);
    let in_use = run(&["move", "--data", word, "--to", &database]);
    assert!(text(&in_use.stderr).contains("stop it first"), "{}", text(&in_use.stderr));
    farm.terminate();

    // Earlier releases accepted names that PostgreSQL cannot store.
    let rename = |name: &str| {
        let program = "import sqlite3, sys
farm = sqlite3.connect(sys.argv[1])
farm.execute('UPDATE job SET name = ? WHERE id = ?', (sys.argv[3].replace('_', chr(0)), sys.argv[2]))
farm.commit()";
        let mut python = Command::new("python3");
        python.args(["-c", program]).arg(data.join("farm.sqlite")).args([&id, name]);
        assert!(finish(python, b"").status.success());
    };
    rename("a_b");
    let unstorable = run(&["move", "--data", word, "--to", &database]);
    let printed = text(&unstorable.stderr);
    assert!(!unstorable.status.success() && printed.contains(&id) && printed.contains("U+0000"), "{printed}");
    rename("csg");

    let printed = succeed(&["move", "--data", word, "--to", &database]);
    assert!(printed.contains("is kept") && printed.contains("--database postgres://"), "{printed}");
    let moved = data.join("farm.sqlite.moved");
    let before = dump(&moved);
    // Back at once: every row is as before.
    succeed(&["move", "--data", word, "--to", "file"]);
    assert!(dump(&data.join("farm.sqlite")) == before, "a row differs");
    let twice = run(&["move", "--data", word, "--to", &database]);
    assert!(text(&twice.stderr).contains("already has a farm"), "{}", text(&twice.stderr));
    assert!(dump(&data.join("farm.sqlite")) == before, "nothing was changed");

    // And away again, to work there.
    let other = postgres_server::database_of(&folder.path().join("other")).expect("a database");
    std::fs::remove_file(&moved).expect("it is kept until it is deleted");
    succeed(&["move", "--data", word, "--to", &other]);
    let refused = run(&["serve", "--data", word, "--listen", "127.0.0.1:0"]);
    assert!(text(&refused.stderr).contains("has its database in postgres://"), "{}", text(&refused.stderr));
    let farm = start(folder.path(), Some(&other));
    assert!(farm.picture(&id) == rendered_here(&job, 0));
    let next = farm.accept(&jobs::seeded(&job, 8).to_string());
    farm.succeeded(&next);
    farm.terminate();
    succeed(&["move", "--data", word, "--to", "file"]);
    let farm = start(folder.path(), None);
    for id in [&id, &next] {
        farm.succeeded(id);
    }
    farm.terminate();
    let printed = succeed(&["doctor", "--data", word]);
    assert!(!printed.contains("ERROR"), "{printed}");
}

#[test]
fn a_database_is_migrated_without_a_server() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let word = data.to_str().expect("plain");
    let Some(database) = postgres_server::required().and_then(|_| postgres_server::database_of(&data)) else { return };
    let none = run(&["migrate", "--data", word]);
    assert!(text(&none.stderr).contains("there is no farm"), "{}", text(&none.stderr));
    let first = succeed(&["migrate", "--data", word, "--database", &database]);
    assert!(first.contains("was migrated by"), "{first}");
    let second = succeed(&["migrate", "--data", word, "--database", &database]);
    assert!(second.contains("is up to date"), "{second}");
    let farm = start(folder.path(), Some(&database));
    // A server that does not share its database excludes everything else.
    let in_use = run(&["migrate", "--data", word, "--database", &database]);
    assert!(text(&in_use.stderr).contains("stop a server that does not share it"), "{}", text(&in_use.stderr));
    farm.terminate();
}

#[test]
fn keys_are_not_made_in_another_database_than_the_data_folders() {
    let folder = tempfile::tempdir().expect("a folder");
    let (data, elsewhere) = (folder.path().join("data"), folder.path().join("elsewhere"));
    let word = data.to_str().expect("plain");
    let Some(database) = postgres_server::required().and_then(|_| postgres_server::database_of(&data)) else { return };
    let other = postgres_server::database_of(&elsewhere).expect("a database");
    start(folder.path(), Some(&database)).terminate();
    let key = ["key", "new", "anna", "--scope", "admin", "--data", word, "--database"];
    let refused = run(&[&key[..], &[&other]].concat());
    let printed = text(&refused.stderr);
    assert!(
        printed.contains("has its database in postgres://") && printed.contains("leave --database out"),
        "{printed}"
    );
    succeed(&[&key[..], &[&database]].concat());
}
