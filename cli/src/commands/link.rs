//! `sdfarm link`: creates a signed link to a picture, which works without a key until it expires.

use anyhow::Context;
use clap::Args;
use proto::Retention;
use proto::link::{LinkContent, LinkRequest, MAX_LINK_SECONDS};

use crate::arguments::ServerArguments;
use crate::error::UsageError;
use crate::job_name::JobName;
use crate::terminal::{print_line, print_note};

/// Arguments of `link`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    server: ServerArguments,
    /// Frame number, from 0.
    #[arg(long, value_name = "N", env = "SDFARM_FRAME", default_value_t = 0)]
    frame: u32,
    /// Validity of the link: 30m, 36h, 7d; at most 366d.
    #[arg(long, value_name = "AGE", env = "SDFARM_EXPIRES", default_value = "7d")]
    expires: Retention,
    /// Link to a preview of the finished part instead of the stored picture.
    #[arg(long, env = "SDFARM_PREVIEW", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    preview: bool,
}

/// Prints the link.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let Arguments { id, server, frame, expires, preview } = arguments;
    let seconds = match expires {
        Retention::For(time) => u32::try_from(time.as_secs()).ok(),
        Retention::Forever => None,
    };
    let expires_in_seconds = seconds
        .filter(|seconds| (1..=MAX_LINK_SECONDS).contains(seconds))
        .ok_or_else(|| UsageError(format!("a link cannot be valid for {expires}: use 1s to 366d")))?;
    let shows = if preview { LinkContent::Preview } else { LinkContent::Image };
    let client = server.client()?;
    let id = id.find(&client).await?;
    let link = client
        .link(id, frame, &LinkRequest { expires_in_seconds, shows })
        .await
        .with_context(|| format!("could not sign a link to frame {frame} of job {id}"))?;
    print_note(&format!("valid until {}", link.expires_at));
    print_line(&format!("{}{}", client.server(), link.url))
}
