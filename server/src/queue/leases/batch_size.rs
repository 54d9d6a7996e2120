//! Batch size: the number of a frame's tiles that one worker gets. Arithmetic only.

use std::time::Duration;

use crate::queue::workers::speeds::JobSpeed;

/// A worker without a measured speed gets frames up to this many rays complete.
const SMALL_FRAME_RAYS: u64 = 1 << 22;
/// Target duration of a batch.
const TARGET_BATCH: Duration = Duration::from_secs(1);
/// Batches up to this long go to any worker, and frames up to this long are not split, because the delay is not
/// worth another claim.
const MIN_BATCH: Duration = Duration::from_millis(50);
/// The same for a worker whose speed in the job is not known yet while others share it: the job may be a hundred times
/// as heavy as the scenes that its report comes from.
const TRIAL_BATCH: Duration = Duration::from_millis(125);
const MIN_TRIAL_BATCH: Duration = Duration::from_millis(5);
/// A worker gets its part of what is left divided by this.
const SHARED_ROUNDS: f64 = 2.0;
/// Maximum pixel data for which one worker gets a complete frame.
pub(in crate::queue) const MAX_WHOLE_FRAME_BYTES: u64 = 256 << 20;

/// Ready tile, with the data that the batch size depends on.
#[derive(Clone, Copy, Debug)]
pub(in crate::queue) struct ReadyTile {
    /// Camera rays of the tile.
    pub(in crate::queue) rays: u64,
    /// Whether the tile was lost with its worker before, so that it is leased alone.
    pub(in crate::queue) is_isolated: bool,
}

/// Frame of the tiles.
#[derive(Clone, Copy, Debug)]
pub(in crate::queue) struct FrameLoad {
    /// Number of its tiles, ready or not.
    pub(in crate::queue) tiles: u64,
    /// Number of their rays.
    pub(in crate::queue) rays: u64,
    /// Bytes of its finished data.
    pub(in crate::queue) size_bytes: u64,
    /// Camera rays of the job's frames that are not opened yet.
    pub(in crate::queue) rays_unopened: u64,
}

/// Worker that gets a batch, compared with the others that can render the job.
#[derive(Clone, Copy, Debug)]
pub(in crate::queue) struct WorkerShare {
    /// Its speed.
    pub(in crate::queue) speed: Option<JobSpeed>,
    /// Number of other workers that share the job.
    pub(in crate::queue) others: u64,
    /// Their mean camera rays per second.
    pub(in crate::queue) mean_other: f64,
    /// Camera rays per second of the fastest other worker, even if that renders another job now.
    pub(in crate::queue) fastest_other: Option<f64>,
}

impl WorkerShare {
    /// A worker that shares the job with no other.
    pub(in crate::queue) fn alone(speed: Option<JobSpeed>) -> Self {
        Self { speed, others: 0, mean_other: 0.0, fastest_other: None }
    }

    /// Rays of its part of what is left.
    fn part(self, left: u64) -> u64 {
        if self.others == 0 {
            return left;
        }
        let own = self.speed.map_or(self.mean_other, JobSpeed::get);
        (left as f64 * own / (own + self.mean_other * self.others as f64) / SHARED_ROUNDS) as u64
    }

    /// Whether its speed in the job is unknown and other workers wait, so that a batch may be far longer than it seems.
    fn is_trial(self) -> bool {
        self.others > 0 && !matches!(self.speed, Some(JobSpeed::Measured(_)))
    }

    /// Target duration of its batch, and the one up to which a batch is not worth splitting.
    fn durations(self) -> [Duration; 2] {
        if self.is_trial() { [TRIAL_BATCH, MIN_TRIAL_BATCH] } else { [TARGET_BATCH, MIN_BATCH] }
    }
}

/// Number of `ready` tiles, from the first, that a worker gets.
///
/// Workers that share a job each take half of their part of what is left (Hummel, Schonberg, Flynn, "Factoring",
/// Communications of the ACM 35(8), 1992), so that they finish together although tiles differ and speeds are guesses.
/// The batch takes the worker no longer than the fastest other worker would need for all remaining work of the job.
pub(in crate::queue) fn batch_len(ready: &[ReadyTile], frame: FrameLoad, worker: WorkerShare) -> usize {
    if ready.first().is_none_or(|tile| tile.is_isolated) {
        return ready.len().min(1);
    }
    let sharable = ready.iter().take_while(|tile| !tile.is_isolated).count();
    let left = rays_left(ready, frame);
    let by_other = worker.fastest_other.map_or(f64::INFINITY, |rate| (left as f64 / rate).max(MIN_BATCH.as_secs_f64()));
    let [target, least] = worker.durations().map(|duration| duration.as_secs_f64());
    let rate = worker.speed.map(JobSpeed::get);
    let budget = rate.map(|rate| (rate * target.min(by_other)) as u64);
    let min_rays = rate.map_or(0, |rate| (rate * least) as u64);
    if frame.rays <= SMALL_FRAME_RAYS.min(budget.unwrap_or(SMALL_FRAME_RAYS)).max(min_rays) {
        return sharable;
    }
    let share = if worker.is_trial() { worker.part(left) } else { worker.part(left).max(min_rays) };
    let affordable = budget.map_or(1, |budget| {
        let (limit, mut rays) = (budget.min(share), 0);
        ready
            .iter()
            .take_while(|tile| {
                rays += tile.rays;
                rays <= limit
            })
            .count()
    });
    affordable.clamp(1, sharable)
}

/// Time that a worker needs for a granted batch, and the most that the batches of one response may need together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::queue) struct BatchTime {
    pub(in crate::queue) seconds: f64,
    pub(in crate::queue) most_seconds: f64,
}

/// Time of a whole frame, if further frames may be granted with it: its worker's speed in the job was measured. All of
/// them together are limited like a batch, where all other workers count as sharing the job.
pub(in crate::queue) fn frame_time(ready: &[ReadyTile], frame: FrameLoad, worker: WorkerShare) -> Option<BatchTime> {
    let Some(JobSpeed::Measured(rate)) = worker.speed else { return None };
    let left = rays_left(ready, frame);
    let by_other = worker.fastest_other.map_or(f64::INFINITY, |rate| left as f64 / rate);
    let most_seconds = by_other.min(worker.part(left) as f64 / rate).max(MIN_BATCH.as_secs_f64());
    Some(BatchTime { seconds: frame.rays as f64 / rate, most_seconds: most_seconds.min(TARGET_BATCH.as_secs_f64()) })
}

/// Camera rays that are left of the job, as far as this frame's claim knows.
fn rays_left(ready: &[ReadyTile], frame: FrameLoad) -> u64 {
    ready.iter().map(|tile| tile.rays).sum::<u64>() + frame.rays_unopened
}

/// Number of sharing workers from which on a worker gets only one tile.
pub(in crate::queue) fn sharing_limit(ready: &[ReadyTile], frame: FrameLoad, worker: WorkerShare) -> u64 {
    let own = worker.speed.map_or(worker.mean_other, JobSpeed::get);
    let tile_rays = ready.first().map_or(1, |tile| tile.rays.max(1)) as f64;
    (rays_left(ready, frame) as f64 / tile_rays * own / worker.mean_other.max(1.0)) as u64 + 1
}

/// Whether a batch of this many tiles is the whole frame, and small enough for its worker to encode the
/// picture.
pub(in crate::queue) fn is_whole_frame(run: usize, frame: FrameLoad) -> bool {
    run as u64 == frame.tiles && frame.size_bytes <= MAX_WHOLE_FRAME_BYTES
}

#[cfg(test)]
mod tests {
    use super::*;

    const MEGA: u64 = 1 << 20;

    fn tiles(count: usize) -> Vec<ReadyTile> {
        vec![ReadyTile { rays: MEGA, is_isolated: false }; count]
    }

    fn frame(tiles: u64) -> FrameLoad {
        FrameLoad { tiles, rays: tiles * MEGA, size_bytes: tiles * (16 << 20), rays_unopened: 0 }
    }

    /// A worker that shares the job with no other, and whose speed in it was measured.
    fn alone(rays_per_second: f64) -> WorkerShare {
        WorkerShare::alone(Some(JobSpeed::Measured(rays_per_second)))
    }

    /// A worker whose speed was measured, and that shares the job with equal ones.
    fn sharing(rays_per_second: f64, others: u64) -> WorkerShare {
        WorkerShare { others, mean_other: rays_per_second, ..alone(rays_per_second) }
    }

    #[test]
    fn a_worker_without_speed_gets_small_frames_or_one_tile() {
        let unknown = WorkerShare { others: 3, mean_other: 1.0, ..WorkerShare::alone(None) };
        assert_eq!(batch_len(&tiles(4), frame(4), unknown), 4);
        assert_eq!(batch_len(&tiles(9), frame(9), unknown), 1);
        assert_eq!(batch_len(&tiles(9), frame(9), WorkerShare::alone(None)), 1);
    }

    #[test]
    fn a_batch_takes_about_a_second() {
        for (rays_per_second, length) in [(5.5 * MEGA as f64, 5), (1.0, 1), (1e12, 100)] {
            assert_eq!(batch_len(&tiles(100), frame(100), alone(rays_per_second)), length);
            let reported = WorkerShare::alone(Some(JobSpeed::Overall(rays_per_second)));
            assert_eq!(batch_len(&tiles(100), frame(100), reported), length, "nobody waits for its tiles");
        }
    }

    #[test]
    fn a_slow_worker_gets_less_than_a_fast_one() {
        let (slow, fast) = (20.0 * MEGA as f64, 400.0 * MEGA as f64);
        let against = |speed, other| WorkerShare { fastest_other: Some(other), ..alone(speed) };
        // The fast worker would take 0.25 s for all tiles.
        assert_eq!(batch_len(&tiles(100), frame(100), against(slow, fast)), 5);
        assert_eq!(batch_len(&tiles(100), frame(100), against(fast, slow)), 100);
        assert_eq!(batch_len(&tiles(100), frame(100), against(fast, fast)), 100);
        // For an animation it gets as much as it would alone, until little is left.
        let animation = FrameLoad { rays_unopened: 1000 * MEGA, ..frame(100) };
        assert_eq!(batch_len(&tiles(100), animation, against(slow, fast)), 20);
        // A short batch is always granted.
        assert_eq!(batch_len(&tiles(8), frame(100), against(slow, fast)), 1);
    }

    #[test]
    fn workers_that_share_a_frame_take_half_of_their_parts_of_what_is_left() {
        let speed = 100.0 * MEGA as f64;
        assert_eq!(batch_len(&tiles(80), frame(80), sharing(speed, 3)), 10);
        assert_eq!(batch_len(&tiles(70), frame(80), sharing(speed, 3)), 8);
        assert_eq!(batch_len(&tiles(2), frame(80), sharing(speed, 3)), 2, "less than 50 ms are not split");
        assert_eq!(
            batch_len(&tiles(9), frame(9), sharing(1e12, 3)),
            9,
            "the frame is finished before another worker could start"
        );
        let animation = FrameLoad { rays_unopened: 1000 * MEGA, ..frame(80) };
        assert_eq!(batch_len(&tiles(80), animation, sharing(speed, 3)), 80, "others get other frames");
    }

    #[test]
    fn a_report_of_light_scenes_does_not_claim_a_heavy_frame() {
        let reported = |speed: f64, others| WorkerShare {
            others,
            mean_other: speed,
            ..WorkerShare::alone(Some(JobSpeed::Overall(speed)))
        };
        let light = 2600.0 * MEGA as f64;
        // A batch of 60 tiles would take 23 ms of a light scene.
        assert_eq!(batch_len(&tiles(60), frame(60), reported(light, 1)), 15);
        assert_eq!(batch_len(&tiles(60), frame(60), reported(light, 7)), 3);
        assert_eq!(batch_len(&tiles(60), frame(60), reported(light, 0)), 60, "no other worker could help");
        assert_eq!(batch_len(&tiles(8), frame(8), reported(light, 1)), 8, "a light frame stays whole");
        let animation = FrameLoad { rays_unopened: 1000 * MEGA, ..frame(60) };
        assert_eq!(
            batch_len(&tiles(60), animation, reported(16.0 * MEGA as f64, 1)),
            2,
            "an eighth of a second, as a trial"
        );
    }

    #[test]
    fn more_workers_than_the_limit_change_nothing() {
        let worker = sharing(30.0 * MEGA as f64, 0);
        let limit = sharing_limit(&tiles(60), frame(60), worker);
        assert!(limit <= 61, "{limit}");
        for others in [limit, limit + 1, 10_000] {
            assert_eq!(batch_len(&tiles(60), frame(60), WorkerShare { others, ..worker }), 1);
        }
    }

    #[test]
    fn frames_granted_together_take_no_longer_than_a_batch() {
        let speed = 100.0 * MEGA as f64;
        let animation = |frames: u64| FrameLoad { rays_unopened: frames * MEGA, ..frame(1) };
        let time = |frames, worker| frame_time(&tiles(1), animation(frames), worker).expect("it was measured");
        assert_eq!(time(1000, alone(speed)), BatchTime { seconds: 0.01, most_seconds: 1.0 });
        assert_eq!(time(19, alone(speed)).most_seconds, 0.2, "no more than there is");
        assert_eq!(time(1000, sharing(speed, 1)).most_seconds, 1.0);
        assert_eq!(time(39, sharing(speed, 1)).most_seconds, 0.1, "half of its half");
        assert_eq!(time(3, sharing(speed, 1)).most_seconds, 0.05, "short batches go to any worker");
        let slow = WorkerShare { fastest_other: Some(10.0 * speed), ..alone(speed) };
        assert_eq!(time(99, slow).most_seconds, 0.1, "a fast worker needs that for all");
        assert_eq!(frame_time(&tiles(1), animation(9), WorkerShare::alone(Some(JobSpeed::Overall(speed)))), None);
    }

    #[test]
    fn a_tile_lost_twice_is_leased_alone() {
        let mut ready = tiles(4);
        ready[2].is_isolated = true;
        assert_eq!(batch_len(&ready, frame(4), WorkerShare::alone(None)), 2);
        assert_eq!(batch_len(&ready[2..], frame(4), WorkerShare::alone(None)), 1);
    }

    #[test]
    fn a_frame_too_large_for_memory_is_not_granted_whole() {
        assert!(is_whole_frame(16, frame(16)));
        assert!(!is_whole_frame(15, frame(16)));
        assert!(!is_whole_frame(17, frame(17)));
    }
}
