//! Exports traces to an OpenTelemetry collector by OTLP over HTTP, without delaying the traced work.
//!
//! If the collector is unreachable, only the traces are lost.

use std::fmt;
use std::time::Duration;

use anyhow::Context;
use opentelemetry::KeyValue;
use opentelemetry::trace::TracerProvider;
use opentelemetry_otlp::{SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::SdkTracerProvider;
use tracing::{Metadata, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::filter_fn;
use tracing_subscriber::registry::LookupSpan;

use crate::error::UsageError;

/// Time limit of a request to the collector.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Path of the collector's endpoint.
const PATH: &str = "/v1/traces";
/// Name of the spans of polling requests.
const POLL: &str = "poll";

/// Sends the last traces when dropped.
pub(crate) struct TraceExporter(SdkTracerProvider);

impl fmt::Debug for TraceExporter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TraceExporter")
    }
}

impl TraceExporter {
    /// Exports sdfarm's own spans to the collector at this address.
    pub(super) fn start<S>(address: &str) -> anyhow::Result<(Box<dyn Layer<S> + Send + Sync>, Self)>
    where
        S: Subscriber + for<'a> LookupSpan<'a> + Send + Sync,
    {
        if !address.starts_with("http://") && !address.starts_with("https://") {
            return Err(
                UsageError(format!("--otlp {address:?} is not an address: write it as http://127.0.0.1:4318")).into()
            );
        }
        // Fails only if a propagator was set before.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let base = address.trim_end_matches('/');
        let endpoint = if base.ends_with(PATH) { base.to_owned() } else { format!("{base}{PATH}") };
        let exporter = SpanExporter::builder()
            .with_http()
            .with_endpoint(endpoint)
            .with_timeout(TIMEOUT)
            .build()
            .with_context(|| format!("could not prepare to send traces to {address}: check --otlp"))?;
        let resource = Resource::builder()
            .with_service_name("sdfarm")
            .with_attribute(KeyValue::new("service.version", env!("CARGO_PKG_VERSION")))
            .with_attribute(KeyValue::new("process.pid", i64::from(std::process::id())))
            .build();
        let provider = SdkTracerProvider::builder().with_batch_exporter(exporter).with_resource(resource).build();
        let layer = tracing_opentelemetry::layer().with_tracer(provider.tracer("sdfarm"));
        Ok((layer.with_filter(filter_fn(is_traced)).boxed(), Self(provider)))
    }
}

impl Drop for TraceExporter {
    fn drop(&mut self) {
        // If the collector is unreachable, the traces are lost.
        let _ = self.0.shutdown_with_timeout(TIMEOUT);
    }
}

fn is_traced(metadata: &Metadata<'_>) -> bool {
    let is_ours = ["server", "worker", "sdfarm"].iter().any(|name| metadata.target().split("::").next() == Some(name));
    metadata.is_span() && is_ours && metadata.name() != POLL && *metadata.level() <= tracing::Level::INFO
}
