//! `sdfarm check`: reports every error of a job file, or its warnings and what would be rendered.

mod size;

use clap::Args;
use proto::problem::ValidationErrorView;
use serde_json::json;

use self::size::Outlook;
use crate::error::InvalidJob;
use crate::job_file::JobFile;
use crate::preview_helper::sample;
use crate::terminal::{print_line, print_note};

/// Arguments of `check`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job file; - for standard input.
    job: String,
    /// Spend 0.7 s instead of 0.2 s on the estimate of its time.
    #[arg(long, env = "SDFARM_ESTIMATE", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    estimate: bool,
    /// Print all as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Most time for rendering a sample, in milliseconds.
const RENDER_MS: u64 = 700;
/// The same, where nobody asked for an estimate.
const QUICK_RENDER_MS: u64 = 200;

/// Checks it.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let file = JobFile::read(&arguments.job)?;
    let job = match file.parse() {
        Ok(job) => job,
        Err(error) => {
            if let (true, Some(bad)) = (arguments.json, error.downcast_ref::<InvalidJob>()) {
                print_line(&refusal(&bad.faults))?;
            }
            return Err(error);
        }
    };
    let warnings = job.warnings();
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let sample = sample(&job, threads, if arguments.estimate { RENDER_MS } else { QUICK_RENDER_MS });
    // That a sample takes too long says much of the job, and nothing against it.
    let outlook = Outlook::new(&job, threads, sample.as_ref().ok());
    if arguments.json {
        return print_line(&format!("{:#}", outlook.json(&warnings)));
    }
    for warning in &warnings {
        print_note(&format!("{}: warning: {warning}", file.name));
    }
    print_line(&format!("{}: sound", file.name))?;
    for line in outlook.lines() {
        print_line(&format!("  {line}"))?;
    }
    Ok(())
}

/// The faults of a job, as JSON.
fn refusal(faults: &[ValidationErrorView]) -> String {
    format!("{:#}", json!({ "valid": false, "errors": faults }))
}
