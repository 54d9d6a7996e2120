//! Logs: to standard error, as text or JSON, filtered by `SDFARM_LOG`.

use std::io::{IsTerminal, stderr};

use clap::{Args, ValueEnum};
use tracing_subscriber::EnvFilter;

use crate::failure::Misuse;

/// How logs are written.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Format {
    /// One line of text an event.
    Text,
    /// One JSON object an event.
    Json,
}

/// The flags every command takes.
#[derive(Debug, Args)]
pub(crate) struct Logs {
    /// How logs are written to standard error.
    #[arg(long = "log", value_name = "FORMAT", env = "SDFARM_LOG_FORMAT", default_value = "text", global = true)]
    format: Format,
    /// Log more; `SDFARM_LOG` chooses in detail, as `SDFARM_LOG=server=debug,info`.
    #[arg(
        long,
        short,
        env = "SDFARM_VERBOSE",
        value_parser = clap::builder::FalseyValueParser::new(),
        action = clap::ArgAction::SetTrue,
        global = true
    )]
    verbose: bool,
}

impl Logs {
    /// Starts logging. Commands that serve log what they do; the others only what is amiss.
    pub(crate) fn start(&self, is_long_lived: bool) -> anyhow::Result<()> {
        let usual = match (self.verbose, is_long_lived) {
            (true, _) => "debug,hyper=info,h2=info,reqwest=info,sqlx=info",
            (false, true) => "info,sqlx=warn",
            (false, false) => "warn,sqlx=error",
        };
        let filter = match std::env::var("SDFARM_LOG") {
            Ok(wanted) if !wanted.is_empty() => EnvFilter::try_new(&wanted).map_err(|reason| {
                Misuse(format!("SDFARM_LOG={wanted:?} is no log filter ({reason}): write it as server=debug,info"))
            })?,
            _ => EnvFilter::new(usual),
        };
        let subscriber = tracing_subscriber::fmt().with_writer(stderr).with_env_filter(filter);
        match self.format {
            Format::Text => subscriber.with_ansi(stderr().is_terminal()).init(),
            Format::Json => subscriber.json().flatten_event(true).init(),
        }
        Ok(())
    }
}
