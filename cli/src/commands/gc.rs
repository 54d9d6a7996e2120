//! `sdfarm gc`: has a server delete the jobs past their retention, or lists them.

use clap::Args;
use proto::retention::GcReport;

use crate::arguments::ServerArguments;
use crate::counted::counted_len;
use crate::terminal::{escape_line, print_line, print_note};

/// Arguments of `gc`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    server: ServerArguments,
    /// Only list what would be deleted.
    #[arg(long, env = "SDFARM_DRY_RUN", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    dry_run: bool,
    /// Print the server's response as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Repeats the collection until nothing is left to delete.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    loop {
        let collection = client.collect_garbage(arguments.dry_run).await?;
        if arguments.json {
            print_line(&serde_json::to_string_pretty(&collection)?)?;
        } else {
            print_report(&collection)?;
        }
        if arguments.dry_run || !collection.more {
            return Ok(());
        }
    }
}

fn print_report(collection: &GcReport) -> anyhow::Result<()> {
    let GcReport { dry_run, store_bytes, max_store_bytes, freed_bytes, jobs, more } = collection;
    for job in jobs {
        print_line(&format!(
            "{}  {}  {:<4}  {:>12} bytes  {}",
            job.id,
            job.finished_at,
            job.reason.name(),
            job.freed_bytes,
            escape_line(&job.name)
        ))?;
    }
    let limit = max_store_bytes.map_or_else(|| "no limit".to_owned(), |bytes| format!("at most {bytes}"));
    let (verb, rest) =
        (if *dry_run { "would free" } else { "freed" }, if *more { ", and there may be more" } else { "" });
    let jobs = counted_len(jobs.len(), "job");
    print_note(&format!("{jobs} {verb} {freed_bytes} of {store_bytes} bytes ({limit}){rest}"));
    Ok(())
}
