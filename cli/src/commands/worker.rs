//! `sdfarm worker`: renders tiles for a server.

use std::time::Duration;

use anyhow::Context;
use clap::Args;
use proto::worker_protocol::TOKEN_ENV_VAR;
use rustix::process::{Signal, getpid, kill_process, nice};
use tokio_util::sync::CancellationToken;
use worker::agent::{self, AgentConfig, AgentError};

use crate::arguments::{AuthArguments, RendererArguments};
use crate::commands::selftest::check;
use crate::error::UnusableDevice;
use crate::signals::Signals;

/// The device of a renderer on a processor.
const CPU: &str = "cpu";
/// How long the process may take to exit.
const EXIT_TIMEOUT: Duration = Duration::from_secs(2);
/// Niceness of a server's own workers.
const POOL_NICENESS: i32 = 10;

/// Arguments of `worker`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Address of the server, or of each server of the farm: the next one is called once one cannot be reached.
    #[arg(long, value_name = "URL,…", env = "SDFARM_SERVER", value_delimiter = ',', num_args = 1, default_value = crate::arguments::DEFAULT_SERVER)]
    server: Vec<String>,
    #[command(flatten)]
    access: AuthArguments,
    #[command(flatten)]
    renderer: RendererArguments,
    /// Name of the worker, for users [default: this host's name and the process id].
    #[arg(long, env = "SDFARM_NAME")]
    name: Option<String>,
    /// Run as a child of a server: exit when standard input closes.
    #[arg(long, hide = true)]
    pool: bool,
}

/// Renders until it is stopped.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    if arguments.pool {
        // Render threads are started from here, and yield to the server.
        nice(POOL_NICENESS).context("could not lower this process's priority")?;
    }
    let signals = Signals::install()?;
    let shutdown = CancellationToken::new();
    let renderer = arguments.renderer.renderer().map_err(|error| UnusableDevice(error.into()))?;
    if renderer.device() == CPU {
        // A GPU was already tested when it was started.
        check(&*renderer).map_err(UnusableDevice)?;
    }
    // Pool workers send the pool's token; a key in the server's environment is not meant for them.
    let access = match std::env::var(TOKEN_ENV_VAR) {
        Ok(token) => arguments.access.with_key(token.into())?,
        Err(_) => arguments.access.auth()?,
    };
    let config = AgentConfig {
        auth: access,
        // A killed server leaves no worker behind: its end of the pipe closes.
        is_pool_worker: arguments.pool,
        ..AgentConfig::new(arguments.server, arguments.name.unwrap_or_else(own_name))
    };
    signals.cancel_then_exit(shutdown.clone());
    let ended = agent::run(config, renderer, shutdown).await;
    kill_this_process_after(EXIT_TIMEOUT);
    match ended {
        Err(retired @ AgentError::DeviceLost { .. }) => Err(UnusableDevice(retired.into()).into()),
        ended => Ok(ended?),
    }
}

/// Makes sure that this process does not outlive its work: a driver may wait for its GPU when the process exits.
fn kill_this_process_after(timeout: Duration) {
    std::thread::spawn(move || {
        std::thread::sleep(timeout);
        // Whatever it returns, there is nothing else to try.
        let _ = kill_process(getpid(), Signal::KILL);
    });
}

fn own_name() -> String {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host = host.trim();
    format!("{}-{}", if host.is_empty() { "worker" } else { host }, std::process::id())
}
