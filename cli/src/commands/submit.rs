//! `sdfarm submit`: submits a job, and waits for it on request.

use std::time::Duration;

use clap::Args;
use proto::client::SubmitOptions;
use proto::job::JobView;
use proto::{Client, ClientError, JobId, Retention};
use scene::{Format, Job};

use crate::arguments::ServerArguments;
use crate::counted::counted;
use crate::error::UsageError;
use crate::job_file::JobFile;
use crate::job_name::JobName;
use crate::output_file::{check_writable, format_of, is_folder};
use crate::overrides::OverrideArguments;
use crate::terminal::{escape_line, print_line, print_note};
use crate::{follow, frame_files};

/// Delays between attempts to submit.
const INITIAL_BACK_OFF: Duration = Duration::from_millis(200);
const MAX_BACK_OFF: Duration = Duration::from_secs(3);
/// Time limit for a server that was reachable to return: it may be restarting.
const SUBMIT_TIMEOUT: Duration = Duration::from_secs(30);

/// Arguments of `submit`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job file; - for standard input.
    job: String,
    #[command(flatten)]
    overrides: OverrideArguments,
    #[command(flatten)]
    server: ServerArguments,
    /// Wait until the job is finished.
    #[arg(long, env = "SDFARM_WAIT", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    wait: bool,
    /// Save the picture here when the job has succeeded: a file gets the first frame, a folder (`DIR/`) gets all
    /// frames; - for standard output.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT", requires = "wait")]
    output: Option<String>,
    /// Render the job again even if its pictures are already stored.
    #[arg(long, env = "SDFARM_NO_CACHE", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    no_cache: bool,
    /// Notify this address when the job has finished; up to four.
    #[arg(long, value_name = "URL", env = "SDFARM_WEBHOOK", value_delimiter = ' ')]
    webhook: Vec<String>,
    /// Retention of the job and its pictures after it finishes: 36h, 7d, forever [default: the server's].
    #[arg(long, value_name = "AGE", env = "SDFARM_KEEP")]
    keep: Option<Retention>,
    /// Maximum seconds that rendering one tile may take: above it the tile has failed [default: the server's].
    #[arg(long, value_name = "SECONDS", env = "SDFARM_TILE_SECONDS", value_parser = clap::value_parser!(u32).range(1..))]
    tile_seconds: Option<u32>,
    /// Keep the pixels and the records of all tiles with the job, so that another job can be based on it.
    #[arg(long, env = "SDFARM_RECORD", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    record: bool,
    /// Render only the tiles that can differ from this job's, which must be recorded; this job is recorded, too.
    #[arg(long, value_name = "JOB", env = "SDFARM_BASED_ON")]
    based_on: Option<JobName>,
}

/// Submits the job.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let file = arguments.overrides.apply(JobFile::read(&arguments.job)?)?;
    if let Some(output) = &arguments.output {
        check_output(&file.parse()?, output)?;
        check_writable(output)?;
    }
    let client = arguments.server.client()?;
    let based_on = match &arguments.based_on {
        Some(job) => Some(job.find(&client).await?),
        None => None,
    };
    let how = SubmitOptions {
        no_cache: arguments.no_cache,
        idempotency_key: Some(JobId::new().to_string()),
        webhooks: arguments.webhook.clone(),
        keep: arguments.keep,
        tile_seconds: arguments.tile_seconds,
        record: arguments.record,
        based_on,
    };
    let job = submit(&client, &file.text, &how).await.map_err(|error| file.invalid(error))?;
    for warning in &job.warnings {
        print_note(&format!("{}: warning: {}", file.name, escape_line(warning)));
    }
    // If the picture goes to standard output, nothing else may.
    if arguments.output.as_deref() == Some("-") {
        print_note(&job.id.to_string());
    } else {
        print_line(&job.id.to_string())?;
    }
    if arguments.wait {
        let job = follow::wait_for_success(&client, job.id).await?;
        if let Some(earlier) = job.based_on {
            let (kept, total) = (job.tiles_kept, job.tiles.total);
            print_note(&format!("{kept} of {total} tiles are those of {earlier}; the others were rendered"));
        }
    }
    match &arguments.output {
        Some(output) => save(&client, &job, output).await,
        None => Ok(()),
    }
}

/// Saves the requested pictures, and prints a notice about the other frames.
async fn save(client: &Client, job: &JobView, output: &str) -> anyhow::Result<()> {
    if is_folder(output) {
        return frame_files::save(client, job.id, output, false).await;
    }
    follow::fetch(client, job.id, 0, output).await?;
    if let others @ 1.. = job.frames.total.saturating_sub(1) {
        let (others, are) = (counted(others, "other frame"), if others == 1 { "is" } else { "are" });
        print_note(&format!(
            "that is frame 0; the {others} {are} stored too: `sdfarm fetch {} -o DIR/` saves all",
            job.id
        ));
    }
    Ok(())
}

/// Submits the job with an idempotency key, so that a broken connection can be retried without creating it
/// twice.
async fn submit(client: &Client, text: &[u8], how: &SubmitOptions) -> Result<JobView, ClientError> {
    let mut sent = false;
    let mut wait = INITIAL_BACK_OFF;
    let mut left = SUBMIT_TIMEOUT;
    loop {
        match client.submit_with(text.to_vec(), how).await {
            Err(ClientError::ConnectionLost { .. }) if left > Duration::ZERO => sent = true,
            Err(ClientError::Unreachable { .. }) if sent && left > Duration::ZERO => {}
            answered => return answered,
        }
        tokio::time::sleep(wait).await;
        left = left.saturating_sub(wait);
        wait = (wait * 2).min(MAX_BACK_OFF);
    }
}

/// A farm stores the format that the job asks for, so the file's extension must match it.
fn check_output(job: &Job, output: &str) -> anyhow::Result<()> {
    if is_folder(output) {
        return Ok(());
    }
    let asked = job.image.format;
    match format_of(output)? {
        Some(named) if named != asked => Err(UsageError(format!(
            "the job's format is {}, but {output} has another extension: rename the file, or set image.format",
            match asked {
                Format::Png => "png",
                Format::Exr => "exr",
            }
        ))
        .into()),
        Some(_) | None => Ok(()),
    }
}
