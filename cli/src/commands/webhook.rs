//! `sdfarm webhook secret`: prints the secret that signs a server's webhooks, for their receivers.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use server::ClusterSecret;

use crate::error::UsageError;
use crate::terminal::print_line;

/// Arguments of `webhook`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    action: WebhookCommand,
}

#[derive(Debug, Subcommand)]
enum WebhookCommand {
    /// Print the secret that signs webhooks.
    Secret {
        /// Folder of the server's database and pictures.
        #[arg(long, value_name = "FOLDER", env = "SDFARM_DATA", default_value = "./sdfarm-data")]
        data: PathBuf,
        /// Secret that the servers of the farm share; the webhooks' secret is derived from it.
        #[arg(long, value_name = "SECRET", env = "SDFARM_CLUSTER_SECRET", hide_env_values = true)]
        cluster_secret: Option<ClusterSecret>,
    },
}

/// Prints the secret.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let WebhookCommand::Secret { data, cluster_secret } = &arguments.action;
    if let Some(shared) = cluster_secret {
        return print_line(shared.for_webhooks().expose());
    }
    if !data.is_dir() {
        return Err(UsageError(format!("there is no folder {}: name the server's with --data", data.display())).into());
    }
    print_line(server::webhook_secret(data)?.expose())
}
