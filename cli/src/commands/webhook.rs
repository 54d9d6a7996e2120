//! `sdfarm webhook secret`: shows what a server signs its webhooks with, for those who receive them.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use crate::error::Misuse;
use crate::terminal::say;

/// Arguments of `webhook`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Print the secret that webhooks are signed with.
    Secret {
        /// Folder of the server's database and pictures.
        #[arg(long, value_name = "FOLDER", env = "SDFARM_DATA", default_value = "./sdfarm-data")]
        data: PathBuf,
    },
}

/// Shows it.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let Action::Secret { data } = &arguments.action;
    if !data.is_dir() {
        return Err(Misuse(format!("there is no folder {}: name the server's with --data", data.display())).into());
    }
    say(server::webhook_secret(data)?.expose())
}
