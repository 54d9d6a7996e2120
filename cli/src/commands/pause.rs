//! `sdfarm pause` and `sdfarm resume`: pause and resume a job, or the whole farm.

use clap::Args;

use crate::arguments::ServerArguments;
use crate::follow;
use crate::job_name::JobName;
use crate::terminal::print_line;

/// Arguments of `pause` and `resume`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest [default: the whole farm].
    #[arg(value_name = "JOB")]
    id: Option<JobName>,
    #[command(flatten)]
    server: ServerArguments,
}

/// Pauses or resumes the job or the farm.
pub(crate) async fn run(arguments: Arguments, pause: bool) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let id = match arguments.id {
        Some(name) => Some(name.find(&client).await?),
        None => None,
    };
    let farm = match (id, pause) {
        (Some(id), true) => return print_line(&follow::line(&client.pause(id).await?)),
        (Some(id), false) => return print_line(&follow::line(&client.resume(id).await?)),
        (None, true) => client.pause_farm().await?,
        (None, false) => client.resume_farm().await?,
    };
    print_line(if farm.paused {
        "the farm is paused: no new tiles are leased until `sdfarm resume`"
    } else {
        "the farm is resumed"
    })
}
