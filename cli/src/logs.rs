//! Logs to standard error, as text or JSON, filtered by `SDFARM_LOG`; optionally, traces to a collector.

mod json_format;
mod text_fields;
mod traces;

use std::io::{IsTerminal, stderr};
use std::sync::OnceLock;

use clap::{Args, ValueEnum};
use tracing_subscriber::fmt::format::JsonFields;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

use crate::error::UsageError;
pub(crate) use traces::TraceExporter;

/// Settings of logs and traces of this process, which its workers inherit.
static CHILD_ENV: OnceLock<Vec<(&'static str, String)>> = OnceLock::new();

/// Format of logs.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum LogFormat {
    /// One line of text for each event.
    Text,
    /// One JSON object for each event.
    Json,
}

/// Log flags that every command accepts.
#[derive(Debug, Args)]
pub(crate) struct LogArguments {
    /// Format of logs on standard error.
    #[arg(long = "log", value_name = "FORMAT", env = "SDFARM_LOG_FORMAT", default_value = "text", global = true)]
    format: LogFormat,
    /// Log more; `SDFARM_LOG` sets levels in detail, for example `SDFARM_LOG=server=debug,info`.
    #[arg(
        long,
        short,
        env = "SDFARM_VERBOSE",
        value_parser = clap::builder::FalseyValueParser::new(),
        action = clap::ArgAction::SetTrue,
        global = true
    )]
    verbose: bool,
    /// Send traces of `serve` and `worker` to this collector, by OTLP over HTTP [default: none, or
    /// `OTEL_EXPORTER_OTLP_ENDPOINT`].
    #[arg(long, value_name = "URL", env = "SDFARM_OTLP", global = true)]
    otlp: Option<String>,
}

impl LogArguments {
    /// Starts logging. Commands that serve log their work, and export traces if configured; the others
    /// log only warnings. Dropping the returned guard sends the last traces.
    pub(crate) fn start(&self, is_long_lived: bool) -> anyhow::Result<Option<TraceExporter>> {
        let usual = match (self.verbose, is_long_lived) {
            (true, _) => "debug,hyper=info,h2=info,reqwest=info,sqlx=info,opentelemetry=info",
            (false, true) => "info,sqlx=warn,opentelemetry=warn",
            (false, false) => "warn,sqlx=error",
        };
        let filter = match std::env::var("SDFARM_LOG") {
            Ok(wanted) if !wanted.is_empty() => EnvFilter::try_new(&wanted).map_err(|reason| {
                UsageError(format!("SDFARM_LOG={wanted:?} is no log filter ({reason}): write it as server=debug,info"))
            })?,
            _ => EnvFilter::new(usual),
        };
        let wanted = self.otlp.clone().or_else(|| std::env::var("OTEL_EXPORTER_OTLP_ENDPOINT").ok());
        let collector = wanted.filter(|address| is_long_lived && !address.is_empty());
        self.remember(collector.as_deref());
        let (layer, traces) = match collector.map(|address| TraceExporter::start(&address)).transpose()? {
            Some((layer, traces)) => (Some(layer), Some(traces)),
            None => (None, None),
        };
        let lines = match self.format {
            LogFormat::Text => {
                let layer = tracing_subscriber::fmt::layer().fmt_fields(text_fields::PlainFields);
                layer.with_writer(stderr).with_ansi(stderr().is_terminal()).boxed()
            }
            LogFormat::Json => tracing_subscriber::fmt::layer()
                .with_writer(stderr)
                .with_ansi(false)
                .fmt_fields(JsonFields::new())
                .event_format(json_format::FlatJsonFormat)
                .boxed(),
        };
        tracing_subscriber::registry().with(layer).with(lines.with_filter(filter)).init();
        Ok(traces)
    }

    fn remember(&self, collector: Option<&str>) {
        let mut inherited = Vec::new();
        if let LogFormat::Json = self.format {
            inherited.push(("SDFARM_LOG_FORMAT", "json".to_owned()));
        }
        if self.verbose {
            inherited.push(("SDFARM_VERBOSE", "true".to_owned()));
        }
        if let Some(address) = collector {
            inherited.push(("SDFARM_OTLP", address.to_owned()));
        }
        // Each process starts its logs only once.
        let _ = CHILD_ENV.set(inherited);
    }
}

/// Variables that give workers the log and trace settings of this process.
pub(crate) fn child_env() -> Vec<(String, String)> {
    let reported = CHILD_ENV.get().map_or(&[][..], Vec::as_slice);
    reported.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect()
}
