//! `sdfarm check`: reports every error of a job file, or its warnings and what would be rendered.

pub(crate) mod size;

use clap::Args;
use proto::problem::ValidationErrorView;
use serde_json::json;

use self::size::Outlook;
use crate::error::InvalidJob;
use crate::job_file::JobFile;
use crate::overrides::OverrideArguments;
use crate::terminal::{escape_line, print_line, print_note};

/// Arguments of `check`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job file; - for standard input.
    job: String,
    #[command(flatten)]
    overrides: OverrideArguments,
    /// Spend at least 0.7 s instead of 0.2 s on the estimate of the job's time.
    #[arg(long, env = "SDFARM_ESTIMATE", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    estimate: bool,
    /// Print the errors, or the size and the warnings, as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Time limit for rendering a sample with `--estimate`, in milliseconds.
const RENDER_MS: u64 = 700;
/// Time limit for rendering a sample without `--estimate`, in milliseconds.
const QUICK_RENDER_MS: u64 = 200;

/// Checks the job file.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let file = arguments.overrides.apply(JobFile::read(&arguments.job)?)?;
    let job = match file.parse() {
        Ok(job) => job,
        Err(error) => {
            if let (true, Some(bad)) = (arguments.json, error.downcast_ref::<InvalidJob>()) {
                print_line(&refusal(&bad.faults))?;
            }
            return Err(error);
        }
    };
    let warnings = scene::warnings(&job);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let sample = helper::sample(&job, threads, if arguments.estimate { RENDER_MS } else { QUICK_RENDER_MS });
    // A job is valid even if no sample of it finishes in time.
    let outlook = Outlook::new(&job, threads, sample.as_ref().ok());
    if arguments.json {
        return print_line(&format!("{:#}", outlook.json(&warnings)));
    }
    for warning in &warnings {
        print_note(&format!("{}: warning: {}", file.name, escape_line(warning)));
    }
    print_line(&format!("{}: valid", file.name))?;
    for line in outlook.lines() {
        print_line(&format!("  {line}"))?;
    }
    Ok(())
}

/// Formats the errors of a job as JSON.
fn refusal(faults: &[ValidationErrorView]) -> String {
    format!("{:#}", json!({ "valid": false, "errors": faults }))
}
