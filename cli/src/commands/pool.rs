//! `sdfarm pool`: shows or sets the number of workers that the server runs on its own machine.

use clap::Args;
use proto::pool::{MAX_POOL_WORKERS, PoolSize};

use crate::arguments::ServerArguments;
use crate::counted::counted;
use crate::terminal::print_line;

/// Arguments of `pool`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Number of workers to run [default: leave the number unchanged].
    #[arg(value_name = "N", value_parser = clap::value_parser!(u32).range(0..=i64::from(MAX_POOL_WORKERS)))]
    workers: Option<u32>,
    #[command(flatten)]
    server: ServerArguments,
}

/// Shows the pool, or sets its size.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let pool = match arguments.workers {
        Some(workers) => client.set_pool(PoolSize { workers }).await?,
        None => client.pool().await?,
    };
    print_line(&format!("{} wanted, {} ready", counted(pool.workers, "worker"), pool.ready))
}
