//! Measurements of a worker for the server's metrics: durations, and the memory of its GPU.
//!
//! They are sent with the next sync, and lost if that call fails: no decision depends on them.

use std::process::Stdio;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use proto::worker_protocol::{DeviceMemory, MAX_TIMINGS, Phase, Timing, WorkerMetrics};
use tokio::process::Command;
use tokio_util::task::AbortOnDropHandle;

/// Interval between readings of a GPU's memory.
const MEMORY_INTERVAL: Duration = Duration::from_secs(15);
/// Timeout of a memory reading.
const MEMORY_TIMEOUT: Duration = Duration::from_secs(5);
const MIB: u64 = 1 << 20;

/// Collects measurements until they are sent.
#[derive(Debug)]
pub(super) struct MetricsBuffer {
    timings: Vec<Timing>,
    memory: Arc<Mutex<Option<DeviceMemory>>>,
    _watching: Option<AbortOnDropHandle<()>>,
}

impl MetricsBuffer {
    /// Starts measuring for a worker on this device; the memory of an NVIDIA GPU is read periodically.
    pub(super) fn new(device: &str) -> Self {
        let memory = Arc::new(Mutex::new(None));
        let gpu = device.strip_prefix("cuda:").and_then(|number| number.parse().ok());
        let watching = gpu.map(|number: usize| {
            let visible = std::env::var("CUDA_VISIBLE_DEVICES").ok();
            tokio::spawn(watch_memory(nvidia_smi_id(number, visible.as_deref()), memory.clone()))
        });
        Self { timings: Vec::new(), memory, _watching: watching.map(AbortOnDropHandle::new) }
    }

    /// Adds a duration.
    pub(super) fn add(&mut self, phase: Phase, took: Duration, rays: u64) {
        if self.timings.len() < MAX_TIMINGS {
            self.timings.push(Timing { phase, took_ms: took.as_secs_f64() * 1e3, rays });
        }
    }

    /// Removes and returns the measurements so far.
    pub(super) fn take(&mut self) -> WorkerMetrics {
        let memory = self.memory.lock().expect("no holder panics").take();
        WorkerMetrics { timings: std::mem::take(&mut self.timings), memory }
    }
}

/// Id that nvidia-smi uses for a GPU of this ordinal: CUDA counts only the visible GPUs.
fn nvidia_smi_id(number: usize, visible: Option<&str>) -> String {
    let named = visible.and_then(|visible| visible.split(',').nth(number));
    named.map(str::trim).filter(|name| !name.is_empty()).map_or_else(|| number.to_string(), ToOwned::to_owned)
}

/// Reads a GPU's memory periodically until the measurements are dropped.
async fn watch_memory(gpu: String, memory: Arc<Mutex<Option<DeviceMemory>>>) {
    loop {
        let asked = Command::new("nvidia-smi")
            .args(["--query-gpu=memory.used,memory.total", "--format=csv,noheader,nounits", "--id", &gpu])
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .output();
        match tokio::time::timeout(MEMORY_TIMEOUT, asked).await {
            Ok(Ok(answer)) => {
                if let Some(found) = read_memory(&String::from_utf8_lossy(&answer.stdout)) {
                    *memory.lock().expect("no holder panics") = Some(found);
                }
            }
            Ok(Err(error)) => {
                tracing::debug!(%error, "no nvidia-smi: GPU memory is not measured");
                return;
            }
            Err(_) => tracing::debug!("nvidia-smi did not respond"),
        }
        tokio::time::sleep(MEMORY_INTERVAL).await;
    }
}

/// Reads `used, total` in MiB.
fn read_memory(answer: &str) -> Option<DeviceMemory> {
    let (used, total) = answer.lines().next()?.split_once(',')?;
    let bytes = |mib: &str| mib.trim().parse::<u64>().ok()?.checked_mul(MIB);
    Some(DeviceMemory { used_bytes: bytes(used)?, total_bytes: bytes(total)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gpu_memory_is_parsed_as_mebibytes() {
        let memory = read_memory("1024, 143771\n").expect("two numbers");
        assert_eq!(memory, DeviceMemory { used_bytes: 1 << 30, total_bytes: 143_771 << 20 });
        for odd in ["", "[N/A], [N/A]", "No devices were found", "12"] {
            assert_eq!(read_memory(odd), None, "{odd}");
        }
    }

    #[test]
    fn nvidia_smi_reads_the_gpu_that_cuda_sees() {
        assert_eq!(nvidia_smi_id(1, None), "1");
        assert_eq!(nvidia_smi_id(1, Some("3,5")), "5");
        assert_eq!(nvidia_smi_id(0, Some("GPU-8f3e")), "GPU-8f3e");
        assert_eq!(nvidia_smi_id(0, Some("")), "0");
    }

    #[tokio::test]
    async fn reported_measurements_are_not_reported_again() {
        let mut measurements = MetricsBuffer::new("cpu");
        for _ in 0..2 * MAX_TIMINGS {
            measurements.add(Phase::Render, Duration::from_millis(5), 7);
        }
        let reported = measurements.take();
        assert_eq!(reported.timings.len(), MAX_TIMINGS);
        assert_eq!(reported.timings[0], Timing { phase: Phase::Render, took_ms: 5.0, rays: 7 });
        assert_eq!(measurements.take(), WorkerMetrics::default());
    }
}
