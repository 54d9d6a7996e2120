//! Records the farm's throughput once a minute.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio_util::sync::CancellationToken;

use crate::counters::ServerCounters;
use crate::queue::{Queue, Rendered};

/// Interval at which the clock is read.
const CHECK_INTERVAL: Duration = Duration::from_secs(1);

/// Records what this server's workers have rendered, by minutes of the wall clock.
#[derive(Debug)]
pub(crate) struct HistoryRecorder {
    /// The queue.
    pub(crate) queue: Queue,
    /// Counters since the start.
    pub(crate) counters: Arc<ServerCounters>,
}

impl HistoryRecorder {
    /// Records each minute when it is over, and the begun one at the end. What could not be recorded counts to the next
    /// minute.
    pub(super) async fn run(&self, end: &CancellationToken) {
        let (mut minute_ms, mut recorded) = (self.queue.minute_ms(), Rendered::default());
        loop {
            tokio::select! {
                () = end.cancelled() => break,
                () = tokio::time::sleep(CHECK_INTERVAL) => {}
            }
            let now_ms = self.queue.minute_ms();
            if now_ms != minute_ms {
                recorded = self.record(minute_ms, recorded).await;
                minute_ms = now_ms;
            }
        }
        if self.rendered() != recorded {
            self.record(minute_ms, recorded).await;
        }
    }

    /// Records what was rendered since the last row; returns what has been recorded.
    async fn record(&self, minute_ms: i64, recorded: Rendered) -> Rendered {
        let rendered = self.rendered();
        let new = Rendered {
            rays: rendered.rays - recorded.rays,
            tiles: rendered.tiles - recorded.tiles,
            frames: rendered.frames - recorded.frames,
        };
        match self.queue.record_minute(minute_ms, new).await {
            Ok(()) => rendered,
            Err(error) => {
                tracing::warn!(%error, "could not record the farm's throughput; it counts to the next minute");
                recorded
            }
        }
    }

    fn rendered(&self) -> Rendered {
        Rendered {
            rays: self.counters.rendered_rays.load(Ordering::Relaxed),
            tiles: self.counters.rendered_tiles.load(Ordering::Relaxed),
            frames: self.counters.rendered_frames.load(Ordering::Relaxed),
        }
    }
}
