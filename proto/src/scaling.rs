//! Number of workers that the backlog needs, as the HTTP API returns it to autoscalers.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Time in which the backlog should be finished, if a request names none, in seconds.
pub const DEFAULT_TARGET_SECONDS: u32 = 600;
/// Maximum of that time, in seconds: a day.
pub const MAX_TARGET_SECONDS: u32 = 86_400;

/// Response of `GET /v1/scaling`, at most a few seconds old.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScalingView {
    /// Time in which the backlog should be finished, in seconds.
    pub target_seconds: u32,
    /// Unfinished jobs that are not paused; 0 if the farm is paused.
    pub jobs: u64,
    /// Their tiles that are not done.
    pub tiles: u64,
    /// Their camera rays that are not rendered.
    pub rays: u64,
    /// Workers on CPUs, for what the ready GPUs leave.
    pub cpu: DeviceScaling,
    /// Workers on GPUs.
    pub cuda: DeviceScaling,
}

/// Workers of one kind of device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DeviceScaling {
    /// Workers that would finish their part of the backlog in time: 0 without work, 1 while no speed is known,
    /// and never more than tiles.
    pub wanted_workers: u64,
    /// Workers that take work now.
    pub ready_workers: u64,
    /// Mean measured camera rays per second of one worker; null if none is known.
    pub rays_per_second: Option<f64>,
    /// Time that one worker would need for their part of the backlog, in seconds; null if no speed is known.
    pub work_seconds: Option<f64>,
}
