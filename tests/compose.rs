//! The commands at the head of docker/compose.yml, without an engine: what the containers would run is run here, in
//! their order and with their variables.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::{Farm, eventually, finish, root, sdfarm, text, wait};

fn model() -> String {
    std::fs::read_to_string(root().join("docker/compose.yml")).expect("the compose file is there")
}

/// What the head runs in the server's container, in order.
fn commands(model: &str) -> Vec<Vec<String>> {
    let head = model.lines().take_while(|line| line.starts_with('#'));
    head.filter(|line| line.starts_with("#   docker compose"))
        .filter_map(|line| line.split_once(" run --rm server "))
        .map(|(_, arguments)| arguments.split_whitespace().map(str::to_owned).collect())
        .collect()
}

fn key(data: &Path, arguments: &[String]) -> String {
    let mut command = sdfarm(&[]);
    // What docker/Dockerfile sets, with the volume in a folder of ours.
    command.args(arguments).env("SDFARM_DATA", data).env("SDFARM_LOG_FORMAT", "json");
    let output = finish(command, b"");
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout).trim().to_owned()
}

#[test]
fn commands_of_the_compose_file_need_no_variable_that_a_later_one_makes() {
    let model = model();
    // Compose fills in every variable of the file for every command, `build` too.
    assert!(!model.contains(":?"), "a required variable keeps the first commands from running");
    let keys = commands(&model);
    assert!(keys.len() >= 2, "{keys:?}");
    assert!(keys[0].ends_with(&["--scope".to_owned(), "admin".to_owned()]), "the first key is an administrator's");
}

#[test]
fn keys_of_the_compose_file_let_its_workers_in() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let secrets: Vec<String> = commands(&model()).iter().map(|arguments| key(&data, arguments)).collect();
    // The farm listens beyond loopback without --insecure, for it has keys.
    let mut serve = sdfarm(&["serve"]);
    serve.envs([("SDFARM_WORKERS", "0"), ("SDFARM_HOST", "server"), ("SDFARM_DEVICE", "cpu")]);
    let farm = Farm::start_at("0.0.0.0:0", serve, folder.path(), &[]);
    let port = farm.address.rsplit(':').next().expect("a port");
    let address = format!("http://127.0.0.1:{port}");
    let mut health = sdfarm(&["status", "--ready"]);
    health.env("SDFARM_SERVER", &address);
    let health = finish(health, b"");
    assert!(health.status.success(), "{}", text(&health.stderr));

    let worker = |key: &str| -> Command {
        let mut command = sdfarm(&["worker", "--device", "cpu"]);
        command.env("SDFARM_SERVER", &address).env("SDFARM_KEY", key);
        command
    };
    let mut child = worker(&secrets[1]).stderr(Stdio::null()).spawn().expect("starts");
    let status = || {
        let mut command = sdfarm(&["status", "--json"]);
        command.env("SDFARM_SERVER", &address).env("SDFARM_KEY", &secrets[0]);
        text(&finish(command, b"").stdout)
    };
    eventually("the worker is ready", || status().contains("\"state\": \"ready\"").then_some(()));
    child.kill().expect("a child of ours");
    wait(&mut child);
    let without = finish(worker(""), b"");
    let told = text(&without.stderr);
    assert!(without.status.code() == Some(2) && told.contains("SDFARM_KEY"), "{told}");
}
