//! `sdfarm workers`: lists the workers of a farm with what they hold, or changes one.

use clap::{Args, ValueEnum};
use proto::client::WorkerChange;
use proto::pool::WorkerView;
use proto::{Client, WorkerId};

use crate::arguments::ServerArguments;
use crate::counted::counted;
use crate::error::UsageError;
use crate::overview::scaled;
use crate::terminal::{escape_line, print_line};

/// Minimum length of a part of an id, in characters.
const MIN_ID_CHARACTERS: usize = 4;

/// Arguments of `workers`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Change of a worker [default: list all].
    #[arg(value_name = "CHANGE", requires = "worker", value_enum)]
    change: Option<Change>,
    /// The worker: its id, four or more of the first or last characters of it, or its name.
    #[arg(value_name = "WORKER", requires = "change")]
    worker: Option<String>,
    #[command(flatten)]
    server: ServerArguments,
    /// Print the server's response as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Change {
    /// It gets no more work, and exits when it has finished what it holds.
    Drain,
    /// It gets no work until it is released.
    Quarantine,
    /// It gets work again, and its errors are forgotten.
    Release,
}

impl Change {
    fn request(self) -> WorkerChange {
        match self {
            Self::Drain => WorkerChange::Drain,
            Self::Quarantine => WorkerChange::Quarantine,
            Self::Release => WorkerChange::Release,
        }
    }
}

/// Lists the workers, or changes one.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    if let (Some(change), Some(name)) = (arguments.change, &arguments.worker) {
        let worker = client.change_worker(find(&client, name).await?, change.request()).await?;
        let text = if arguments.json { serde_json::to_string_pretty(&worker)? } else { line(&worker) };
        return print_line(&text);
    }
    let list = client.workers().await?;
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&list)?);
    }
    for worker in &list.workers {
        print_line(&line(worker))?;
    }
    Ok(())
}

/// Finds the only worker that matches.
async fn find(client: &Client, name: &str) -> anyhow::Result<WorkerId> {
    let workers = client.workers().await?.workers;
    let found: Vec<&WorkerView> = workers.iter().filter(|worker| is_named(worker, name)).collect();
    match found[..] {
        [worker] => Ok(worker.id),
        [] => Err(UsageError(format!(
            "no worker matches {name:?}: give its id, four or more of its first or last characters, or its name; \
             `sdfarm workers` lists them"
        ))
        .into()),
        _ => {
            let lines: Vec<String> = found.into_iter().map(line).collect();
            let lines = lines.join("\n  ");
            Err(UsageError(format!("{name:?} matches several workers: give the id of one\n  {lines}")).into())
        }
    }
}

fn is_named(worker: &WorkerView, name: &str) -> bool {
    let (id, part) = (worker.id.to_string(), name.to_ascii_lowercase());
    worker.name == name || (part.len() >= MIN_ID_CHARACTERS && (id.starts_with(&part) || id.ends_with(&part)))
}

/// A worker as one line.
fn line(worker: &WorkerView) -> String {
    let state = format!("{:?}", worker.state).to_lowercase();
    let speed = worker.rays_per_second.map_or_else(|| "-".to_owned(), |speed| format!("{}rays/s", scaled(speed)));
    let mut parts = vec![format!(
        "{}  {:<20} {:<8} {state:<11} {speed:>14}",
        worker.id.short(),
        escape_line(&worker.name),
        escape_line(&worker.device)
    )];
    parts.extend((worker.errors > 0).then(|| counted(worker.errors, "error")));
    parts.extend(worker.holds.iter().map(|hold| {
        let name = escape_line(&hold.name);
        format!("{} of {name} ({}), frame {}", counted(hold.tiles, "tile"), hold.job.short(), hold.frame)
    }));
    parts.extend(worker.last_error.iter().map(|error| format!("last error: {}", escape_line(error))));
    parts.join("  ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn worker() -> WorkerView {
        let text = r#"{"id": "01890a5d-ac96-774b-bcce-b302099a8057", "name": "pool-1", "device": "cpu", "state": "ready",
            "rays_per_second": 2000000.0, "leases": 8, "pool": true, "registered_at": "2026-01-01T00:00:00.000Z",
            "last_seen_at": "2026-01-01T00:00:00.000Z", "quarantined": false, "draining": false, "errors": 1,
            "last_error": "out of\nmemory", "holds": [{"job": "01890a5d-ac96-774b-bcce-b302099a8058", "name": "fjord",
            "frame": 3, "tiles": 8}]}"#;
        serde_json::from_str(text).expect("a worker")
    }

    #[test]
    fn a_worker_is_one_line() {
        let wanted = "099a8057  pool-1               cpu      ready          2.0 Mrays/s  1 error  \
                      8 tiles of fjord (099a8058), frame 3  last error: out of\\nmemory";
        assert_eq!(line(&worker()), wanted);
    }

    #[test]
    fn a_worker_is_known_by_its_name_and_by_the_ends_of_its_id() {
        let worker = worker();
        for name in ["pool-1", "01890a5d-ac96-774b-bcce-b302099a8057", "0189", "099A8057", "8057"] {
            assert!(is_named(&worker, name), "{name}");
        }
        for name in ["pool", "057", "", "ac96", "cpu"] {
            assert!(!is_named(&worker, name), "{name}");
        }
    }
}
