//! Tests the printed schema in programs that others use: the JSON language server of editors, and a strict validator.
//! The tests themselves are in `tests/clients/`, in the language of those programs.

use std::process::Command;

use crate::skip::skip;
use crate::support::{root, succeed, text};

/// Runs a test of `tests/clients/` with the printed schema.
fn read(script: &str) {
    let packages = root().join(".tools/clients");
    let is_node = Command::new("node").arg("--version").output().is_ok();
    if !is_node || !packages.join("node_modules/ajv").is_dir() {
        return skip("node", format!("tests/clients/node_packages has not installed the packages of {script}"));
    }
    let folder = tempfile::tempdir().expect("a folder");
    let schema = folder.path().join("schema.json");
    std::fs::write(&schema, succeed(&["schema"])).expect("a file");
    let script = root().join("tests/clients").join(script);
    let output = Command::new("node").arg(script).arg(packages).arg(schema).output().expect("node runs");
    assert!(output.status.success(), "{}{}", text(&output.stdout), text(&output.stderr));
}

#[test]
fn editors_complete_and_explain_jobs() {
    read("editors.js");
}

#[test]
fn strict_validators_accept_shipped_jobs_and_refuse_wrong_ones() {
    read("validators.js");
}
