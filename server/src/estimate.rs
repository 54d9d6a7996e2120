//! Estimates the time of a job: a helper process renders a sample of its pixels, and the result is scaled to
//! the current workers.

use std::sync::Arc;
use std::time::Duration;

use proto::preview_helper::{CostSample, Estimate, HelperRequest, PricePlan};
use proto::price::{Price, PriceSample, Rates};
use proto::rounding;

use crate::fair_queue::{FairQueue, WaitingLimits};
use crate::pool::Pool;
use crate::preview_helper::{HelperError, PreviewHelper, TIME_LIMIT};
use crate::queue::{Queue, ReadyWorker};
use crate::tile_plan::TilePlan;

/// Maximum time for rendering a sample, in milliseconds.
const SAMPLE_BUDGET_MS: u64 = 700;
/// Maximum times for rendering what a price is measured by, in milliseconds.
const PRICE_SAMPLE_MS: u64 = 1200;
const MAP_MS: u64 = 800;
const SAVINGS_MS: u64 = 3000;
/// Maximum wait of a dry run for a turn; without one, its response has no estimate.
const MAX_WAIT: Duration = Duration::from_secs(10);
/// Maximum wait of a price for a turn: longer than another's waits for a helper and runs.
const MAX_PRICE_WAIT: Duration = TIME_LIMIT.saturating_mul(3);
/// Maximum number of estimates that one submitter waits for.
const MAX_WAITING: usize = 64;
/// Estimates at a time: the other helper process stays free for previews.
const MAX_CONCURRENT: usize = 1;
/// Overhead of a job in seconds: claim, delivery, commits.
const JOB_OVERHEAD_SECONDS: f64 = 0.01;

/// Estimates of jobs.
#[derive(Debug)]
pub(crate) struct Estimator {
    queue: Queue,
    pool: Arc<Pool>,
    preview_helper: Arc<PreviewHelper>,
    /// Threads that the pool's CPU workers share.
    threads: usize,
    /// Turns of submitters.
    turns: Arc<FairQueue>,
}

impl Estimator {
    /// Estimates for the current workers; the pool's CPU workers share `threads` threads.
    pub(crate) fn new(queue: Queue, pool: Arc<Pool>, preview_helper: Arc<PreviewHelper>, threads: usize) -> Self {
        let turns = FairQueue::new(MAX_CONCURRENT, WaitingLimits::of_one(MAX_WAITING));
        Self { queue, pool, preview_helper, threads, turns }
    }

    /// Estimates a job file; `None` if no sample could be rendered, which is logged.
    pub(crate) async fn estimate(&self, submitter: &str, text: String, plan: TilePlan) -> Option<Estimate> {
        let turn = tokio::time::timeout(MAX_WAIT, self.turns.enter(submitter)).await;
        let Ok(Ok(_turn)) = turn else {
            tracing::debug!(submitter, "too many estimates are requested");
            return None;
        };
        let present = match self.queue.ready_workers().await {
            Ok(present) => present,
            Err(error) => {
                tracing::warn!(%error, "estimating without the workers' speeds");
                Vec::new()
            }
        };
        let threads = self.threads;
        let request = HelperRequest::MeasureCost { job: text, threads, render_ms: SAMPLE_BUDGET_MS };
        match self.preview_helper.sample(&request).await {
            Ok(sample) => Some(estimate_from_sample(&sample, plan, &present, threads, self.pool.target_size())),
            Err(error) => {
                tracing::warn!(%error, "could not estimate a job");
                None
            }
        }
    }
}

/// Parts of a price that are measured besides time and cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PriceParts {
    /// Map of the time.
    pub(crate) map: bool,
    /// Numbers that would save most.
    pub(crate) savings: bool,
}

impl Estimator {
    /// Price of a job file.
    pub(crate) async fn price(
        &self,
        submitter: &str,
        text: String,
        plan: TilePlan,
        parts: PriceParts,
        rates: &Rates,
    ) -> Result<Price, HelperError> {
        let turn = tokio::time::timeout(MAX_PRICE_WAIT, self.turns.enter(submitter)).await;
        let Ok(Ok(_turn)) = turn else { return Err(HelperError::Busy) };
        let present = match self.queue.ready_workers().await {
            Ok(present) => present,
            Err(error) => {
                tracing::warn!(%error, "pricing without the workers' speeds");
                Vec::new()
            }
        };
        let of = |wanted: bool, limit_ms: u64| if wanted { limit_ms } else { 0 };
        let measured = PricePlan {
            sample_ms: PRICE_SAMPLE_MS,
            map_ms: of(parts.map, MAP_MS),
            savings_ms: of(parts.savings, SAVINGS_MS),
        };
        let threads = self.threads;
        let request = HelperRequest::Price { job: text, threads, plan: measured };
        let PriceSample { cost: sample, map, savings, .. } = self.preview_helper.measure(&request).await?;
        let estimate = estimate_from_sample(&sample, plan, &present, threads, self.pool.target_size());
        let gpus: Vec<&ReadyWorker> = present.iter().filter(|worker| worker.device.starts_with("cuda")).collect();
        let gpu_rate: f64 = gpus.iter().filter_map(|worker| worker.rays_per_second).sum();
        // The part of the rays that GPUs would render, and their time for it.
        let gpu_seconds = estimate.seconds.unwrap_or(0.0) * gpus.len() as f64;
        let by_gpus = estimate.seconds.map_or(0.0, |seconds| (gpu_rate * seconds / estimate.rays as f64).min(1.0));
        let gpu_seconds = if gpu_rate > 0.0 { gpu_seconds } else { 0.0 };
        Ok(Price {
            seconds: estimate.seconds,
            seconds_low: estimate.seconds_low,
            seconds_high: estimate.seconds_high,
            core_seconds: estimate.core_seconds,
            relative_error: rounding::fraction(sample.relative_error),
            cost: rates.cost(estimate.core_seconds * (1.0 - by_gpus), gpu_seconds),
            sample_rays: sample.rays,
            map,
            savings,
        })
    }
}

/// Scales a sample to workers; the pool's CPU workers share `threads` threads.
fn estimate_from_sample(
    sample: &CostSample,
    plan: TilePlan,
    present: &[ReadyWorker],
    threads: usize,
    pool: u32,
) -> Estimate {
    let rays = plan.rays_total();
    let core_seconds =
        sample.core_seconds(rays, plan.tiles_total(), u64::from(plan.frames), rays / u64::from(plan.samples));
    // Workers beyond the number of tiles are idle.
    let share = (plan.tiles_total() as f64 / present.len().max(1) as f64).min(1.0);
    let each = (threads / pool.max(1) as usize).max(1);
    let is_ours = |worker: &&ReadyWorker| worker.pool && worker.device == "cpu";
    let our_threads = (present.iter().filter(is_ours).count() * each).min(threads.max(each));
    let ours = our_threads as f64 * rays as f64 / core_seconds;
    let others: f64 =
        present.iter().filter(|worker| !is_ours(worker)).filter_map(|worker| worker.rays_per_second).sum();
    let rate = share * (ours + others);
    let seconds = (rate > 0.0).then(|| rays as f64 / rate + JOB_OVERHEAD_SECONDS);
    let range = seconds.map(|seconds| sample.range(seconds));
    Estimate {
        seconds: seconds.map(rounding::seconds),
        seconds_low: range.map(|(low, _)| rounding::seconds(low)),
        seconds_high: range.map(|(_, high)| rounding::seconds(high)),
        core_seconds: rounding::seconds(core_seconds),
        rays,
        sample_rays: sample.rays,
        memory_bytes: sample.memory_bytes,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAN: TilePlan =
        TilePlan { width_px: 1000, height_px: 1000, samples: 4, pixel_bytes: 16, edge_px: Some(256), frames: 2 };
    const SAMPLE: CostSample = CostSample {
        rays: 10,
        thread_seconds_per_ray: 1e-6,
        setup_seconds_per_tile: 0.03125,
        shared_seconds_per_frame: 0.0,
        encode_seconds_per_pixel: 1e-6,
        relative_error: 0.1,
        memory_bytes: 7,
    };

    fn worker(device: &str, pool: bool, rays_per_second: Option<f64>) -> ReadyWorker {
        ReadyWorker { device: device.to_owned(), pool, rays_per_second }
    }

    fn seconds(present: &[ReadyWorker], pool: u32) -> Option<f64> {
        estimate_from_sample(&SAMPLE, PLAN, present, 4, pool).seconds
    }

    #[test]
    fn cost_grows_with_rays_frames_and_pixels() {
        let estimate = estimate_from_sample(&SAMPLE, PLAN, &[], 4, 0);
        assert_eq!((estimate.rays, estimate.sample_rays, estimate.memory_bytes), (8_000_000, 10, 7));
        assert!((estimate.core_seconds - 11.0).abs() < 1e-9, "{estimate:?}");
        assert_eq!(estimate.seconds, None, "without a worker there is no estimate");
    }

    #[test]
    fn pool_workers_share_cores_and_remote_workers_use_measured_speeds() {
        let ours = worker("cpu", true, Some(3.0));
        let one = seconds(std::slice::from_ref(&ours), 1).expect("a worker is there");
        let two = seconds(&[ours.clone(), ours.clone()], 2).expect("workers are there");
        assert!((one - (11.0 / 4.0 + JOB_OVERHEAD_SECONDS)).abs() < 1e-9, "{one}");
        assert_eq!(one, two);
        let half = seconds(std::slice::from_ref(&ours), 2).expect("one of two is there");
        assert!((half - (11.0 / 2.0 + JOB_OVERHEAD_SECONDS)).abs() < 1e-9, "{half}");
        let gpu = worker("cuda:0", false, Some(8e6));
        assert!((seconds(&[gpu], 0).expect("a worker is there") - 1.0 - JOB_OVERHEAD_SECONDS).abs() < 1e-9);
        assert_eq!(seconds(&[worker("cuda:0", false, None)], 0), None, "its speed is unknown");
    }
}
