//! Camera rays a second of a worker, from what it has rendered.

use proto::bounded::RaysPerSecond;

/// Rendered rays and their time; older measurements have less weight.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ThroughputEstimate {
    rays: f64,
    seconds: f64,
}

impl ThroughputEstimate {
    /// Measurements older than about this have almost no weight.
    const DECAY_SECONDS: f64 = 4.0;
    /// Added to the measured time, so that one very short first batch does not produce a huge speed estimate.
    const PRIOR_SECONDS: f64 = 0.05;

    /// Adds a measurement.
    pub(super) fn update(&mut self, rays: f64, seconds: f64) {
        let fade = (1.0 - seconds / Self::DECAY_SECONDS).max(0.0);
        *self = Self { rays: self.rays * fade + rays, seconds: self.seconds * fade + seconds };
    }

    /// `None` before the first measurement.
    pub(super) fn rays_per_second(self) -> Option<RaysPerSecond> {
        let is_measured = self.seconds > 0.0 && self.rays > 0.0;
        is_measured.then(|| RaysPerSecond::new(self.rays / (self.seconds + Self::PRIOR_SECONDS))).flatten()
    }
}
