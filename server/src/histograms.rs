//! Histograms of the metrics: their buckets, in one place, so that all durations can be compared.

use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};

/// Buckets from 0.1 ms to 100 s.
pub(crate) fn seconds() -> Histogram {
    Histogram::new(exponential_buckets(1e-4, 10f64.sqrt(), 13))
}

/// Buckets of counts up to 512.
pub(crate) fn counts() -> Histogram {
    Histogram::new(exponential_buckets(1.0, 2.0, 10))
}
