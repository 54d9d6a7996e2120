//! Rendering within a time limit.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use anyhow::Context;
use proto::Rect;
use scene::Job;
use worker::{CancelFlag, CpuRenderer, RenderError, Renderer, TilePixels, TileRequest};

/// Interval between two looks at the progress of a render.
const LOOK_INTERVAL: Duration = Duration::from_millis(10);
/// Time after which the progress of a render tells how long it takes.
const CERTAIN_AFTER: Duration = Duration::from_millis(60);

/// Time for preparing a scene, beside half of the limit: it does not depend on the number of pixels.
const TO_PREPARE: Duration = Duration::from_secs(1);

/// A render with a limit.
pub(super) struct Attempt {
    /// Maximum time for the rays, after the scene was prepared.
    pub(super) limit: Duration,
    /// Whether it ends as soon as its progress shows that it will exceed the limit.
    pub(super) gives_up_early: bool,
}

pub(super) enum Outcome {
    Finished(TilePixels),
    /// The fraction that would have been rendered in the time.
    TooSlow(f64),
    /// The scene was not prepared in time: fewer pixels would not help.
    NotPrepared,
}

impl Attempt {
    pub(super) fn render(&self, renderer: &CpuRenderer, job: &Job, frame: u32) -> anyhow::Result<Outcome> {
        let start = Instant::now();
        let cancel = CancelFlag::new();
        let (finished, rays, prepared) = (AtomicU64::new(0), job.image.rays(), OnceLock::new());
        let certain_after = CERTAIN_AFTER.max(self.limit / 4);
        let mut fraction = 1.0;
        let look = || {
            let Some(since) = prepared.get().map(Instant::elapsed) else {
                return (start.elapsed() <= self.limit / 2 + TO_PREPARE).then_some(LOOK_INTERVAL);
            };
            let done = finished.load(Ordering::Relaxed) as f64 / rays as f64;
            fraction = done * (self.limit.as_secs_f64() / since.as_secs_f64());
            let is_hopeless = self.gives_up_early && since > certain_after && fraction > 0.0 && fraction < 0.9;
            (since <= self.limit && !is_hopeless).then_some(LOOK_INTERVAL)
        };
        let rect = Rect::full(job.image.film().width, job.image.film().height);
        let count = |more: u64| {
            prepared.get_or_init(Instant::now);
            finished.fetch_add(more, Ordering::Relaxed);
        };
        let render = || renderer.render(&TileRequest { job, frame, rect }, &cancel, &count);
        match watched(&cancel, look, render) {
            Ok(pixels) => Ok(Outcome::Finished(pixels)),
            Err(RenderError::Cancelled) if prepared.get().is_none() => Ok(Outcome::NotPrepared),
            Err(RenderError::Cancelled) => Ok(Outcome::TooSlow(fraction.min(1.0))),
            Err(error) => Err(error).context("could not render the frame"),
        }
    }
}

/// Does work and cancels it after the time limit, if there is one.
pub(super) fn limited<T>(cancel: &CancelFlag, limit: Option<Duration>, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let look = || match limit {
        Some(limit) => limit.checked_sub(start.elapsed()).filter(|rest| !rest.is_zero()),
        None => Some(Duration::MAX),
    };
    watched(cancel, look, work)
}

/// Does work beside a thread that looks at it, again after each time that a look returns; one that returns none cancels.
fn watched<T>(cancel: &CancelFlag, mut look: impl FnMut() -> Option<Duration> + Send, work: impl FnOnce() -> T) -> T {
    let (working, over) = mpsc::channel::<()>();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            while let Some(pause) = look() {
                if over.recv_timeout(pause) != Err(RecvTimeoutError::Timeout) {
                    return;
                }
            }
            cancel.cancel();
        });
        let done = work();
        drop(working);
        done
    })
}

#[cfg(test)]
mod tests {
    use worker::Simd;

    use super::*;

    #[test]
    fn a_render_that_takes_too_long_tells_how_much_it_would_have_rendered() {
        let text = include_bytes!("../../../scenes/csg.json");
        let mut job = scene::parse(text).expect("a shipped scene");
        job.image.resize(4000, 4000);
        let renderer = CpuRenderer::new(Some(1), Simd::Scalar).expect("threads");
        let attempt = Attempt { limit: Duration::from_millis(100), gives_up_early: true };
        match attempt.render(&renderer, &job, 0).expect("no error") {
            Outcome::TooSlow(fraction) => assert!(fraction < 0.9, "{fraction}"),
            Outcome::Finished(_) => panic!("16 million pixels take more than 100 ms"),
            Outcome::NotPrepared => panic!("a small scene is prepared at once"),
        }
    }

    #[test]
    fn work_is_cancelled_at_its_limit_only() {
        let cancel = CancelFlag::new();
        let wait = || {
            let start = Instant::now();
            while !cancel.is_cancelled() && start.elapsed() < Duration::from_mins(1) {
                std::thread::sleep(Duration::from_millis(1));
            }
            start.elapsed()
        };
        assert_eq!(limited(&cancel, None, || 1), 1);
        assert_eq!(limited(&cancel, Some(Duration::from_mins(1)), || 2), 2);
        assert!(!cancel.is_cancelled());
        let took = limited(&cancel, Some(Duration::from_millis(20)), wait);
        assert!(took >= Duration::from_millis(10) && took < Duration::from_secs(50), "{took:?}");
    }
}
