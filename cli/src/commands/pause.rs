//! `sdfarm pause` and `sdfarm resume`: of a job, or of the whole farm.

use clap::Args;
use proto::JobId;

use crate::arguments::ServerArguments;
use crate::follow;
use crate::terminal::say;

/// Arguments of `pause` and `resume`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job's id [default: the whole farm].
    id: Option<JobId>,
    #[command(flatten)]
    server: ServerArguments,
}

/// Does it.
pub(crate) async fn run(arguments: Arguments, pause: bool) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let farm = match (arguments.id, pause) {
        (Some(id), true) => return say(&follow::line(&client.pause(id).await?)),
        (Some(id), false) => return say(&follow::line(&client.resume(id).await?)),
        (None, true) => client.pause_farm().await?,
        (None, false) => client.resume_farm().await?,
    };
    say(if farm.paused {
        "the farm is paused: nothing more is started until `sdfarm resume`"
    } else {
        "the farm goes on"
    })
}
