//! The `sdfarm-lab` binary: runs one proof or measurement, and prints its result.

use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::Parser;
use lab::Lab;
use tokio::runtime::Handle;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::oneshot;
use tracing_subscriber::filter::LevelFilter;

/// Time for an interrupted command to end the processes that it started.
const END_TIMEOUT: Duration = Duration::from_secs(2);

#[tokio::main]
async fn main() -> ExitCode {
    let lab = Lab::parse();
    tracing_subscriber::fmt().with_max_level(LevelFilter::WARN).with_writer(std::io::stderr).init();
    match interruptible(lab).await {
        Ok(result) => {
            println!("{result}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Runs until a signal, which ends this process even if the command computes.
async fn interruptible(lab: Lab) -> anyhow::Result<String> {
    let mut terminate = signal(SignalKind::terminate()).context("could not catch signals")?;
    let (stop, stopped) = oneshot::channel::<()>();
    let mut work = tokio::task::spawn_blocking(move || {
        Handle::current().block_on(async {
            tokio::select! {
                result = lab.run() => result,
                _ = stopped => bail!("interrupted"),
            }
        })
    });
    tokio::select! {
        ended = &mut work => return ended.context("the command panicked")?,
        _ = tokio::signal::ctrl_c() => {}
        _ = terminate.recv() => {}
    }
    drop(stop);
    // It has ended, or it computes.
    drop(tokio::time::timeout(END_TIMEOUT, work).await);
    std::process::exit(1);
}
