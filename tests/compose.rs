//! Tests the commands at the heads of the compose files without a container engine: it runs the containers' commands of
//! docker/compose.yml directly, in the same order and with the same variables.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::{Farm, eventually, finish, root, sdfarm, text, wait};

fn model(name: &str) -> String {
    std::fs::read_to_string(root().join("docker").join(name)).expect("the compose file is there")
}

/// Commands that the head runs in the server's container, in order.
fn commands(model: &str) -> Vec<Vec<String>> {
    let head = model.lines().take_while(|line| line.starts_with('#'));
    head.filter(|line| line.starts_with("#   docker compose"))
        .filter_map(|line| line.split_once(" run --rm server "))
        .map(|(_, arguments)| arguments.split_whitespace().map(str::to_owned).collect())
        .collect()
}

fn key(data: &Path, arguments: &[String]) -> String {
    let mut command = sdfarm(&[]);
    // The variables of docker/Dockerfile, with the volume in a temporary folder.
    command.args(arguments).env("SDFARM_DATA", data).env("SDFARM_LOG_FORMAT", "json");
    let output = finish(command, b"");
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout).trim().to_owned()
}

#[test]
fn first_compose_commands_need_no_later_variable() {
    for name in ["compose.yml", "compose.cluster.yml"] {
        let model = model(name);
        // Compose evaluates every variable of the file for every command, also for `build`.
        assert!(!model.contains(":?"), "{name}: a required variable would make the first commands fail");
        let keys = commands(&model);
        assert!(keys.len() >= 2, "{name}: {keys:?}");
        let is_admin = keys[0].ends_with(&["--scope".to_owned(), "admin".to_owned()]);
        assert!(is_admin, "{name}: the first key is an administrator's");
    }
}

#[test]
fn compose_keys_authorize_the_workers() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let secrets: Vec<String> = commands(&model("compose.yml")).iter().map(|arguments| key(&data, arguments)).collect();
    // The farm listens beyond loopback without --insecure, because it has keys.
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
    child.kill().expect("a child process");
    wait(&mut child);
    let without = finish(worker(""), b"");
    let printed = text(&without.stderr);
    assert!(without.status.code() == Some(2) && printed.contains("SDFARM_KEY"), "{printed}");
}
