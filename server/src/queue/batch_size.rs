//! Number of a frame's tiles that one worker gets: arithmetic only.

use std::time::Duration;

/// Frames of at most this many rays go whole to a worker whose speed is not known.
const SMALL_FRAME_RAYS: u64 = 1 << 22;
/// Target duration of a batch.
const TARGET_BATCH: Duration = Duration::from_secs(1);
/// Batches up to this long go to any worker, and frames up to this long are not split, because the delay is not worth another claim.
const MIN_BATCH: Duration = Duration::from_millis(50);
/// Maximum data that a worker with a whole frame keeps of it.
const MAX_WHOLE_FRAME_BYTES: u64 = 256 << 20;

/// Ready tile, with what the batch size needs.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReadyTile {
    /// Its camera rays.
    pub(super) rays: u64,
    /// It was lost with its worker before: lease it alone.
    pub(super) is_isolated: bool,
}

/// The frame the tiles are of.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrameLoad {
    /// All its tiles, ready or not.
    pub(super) tiles: u64,
    /// Their rays.
    pub(super) rays: u64,
    /// Bytes of its finished data.
    pub(super) size_bytes: u64,
    /// Camera rays of the job's frames that are not opened yet.
    pub(super) rays_unopened: u64,
}

/// How many of `ready`, from the first, a worker gets. The batch takes it no longer than the fastest other
/// worker would need for all that is left of the job.
pub(super) fn batch_len(
    ready: &[ReadyTile],
    frame: FrameLoad,
    rays_per_second: Option<f64>,
    idle_workers: u64,
    fastest_other: Option<f64>,
) -> usize {
    if ready.first().is_none_or(|tile| tile.is_isolated) {
        return ready.len().min(1);
    }
    let sharable = ready.iter().take_while(|tile| !tile.is_isolated).count();
    let left = ready.iter().map(|tile| tile.rays).sum::<u64>() + frame.rays_unopened;
    let by_other = fastest_other.map_or(f64::INFINITY, |rate| (left as f64 / rate).max(MIN_BATCH.as_secs_f64()));
    let budget = rays_per_second.map(|rate| (rate * TARGET_BATCH.as_secs_f64().min(by_other)) as u64);
    let min_rays = rays_per_second.map_or(0, |rate| (rate * MIN_BATCH.as_secs_f64()) as u64);
    if frame.rays <= SMALL_FRAME_RAYS.min(budget.unwrap_or(SMALL_FRAME_RAYS)).max(min_rays) {
        return sharable;
    }
    let fair = ready.len().div_ceil(idle_workers.max(1) as usize);
    let affordable = budget.map_or(1, |budget| {
        let mut rays = 0;
        ready
            .iter()
            .take_while(|tile| {
                rays += tile.rays;
                rays <= budget
            })
            .count()
    });
    affordable.min(fair).clamp(1, sharable)
}

/// Whether a batch of this many tiles is the whole frame, and small enough for its worker to encode the
/// picture.
pub(super) fn is_whole_frame(run: usize, frame: FrameLoad) -> bool {
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

    #[test]
    fn an_unknown_worker_gets_a_small_frame_whole_and_one_tile_of_a_large_one() {
        assert_eq!(batch_len(&tiles(4), frame(4), None, 3, None), 4);
        assert_eq!(batch_len(&tiles(9), frame(9), None, 1, None), 1);
    }

    #[test]
    fn a_run_is_worth_a_second() {
        assert_eq!(batch_len(&tiles(100), frame(100), Some(5.5 * MEGA as f64), 1, None), 5);
        assert_eq!(batch_len(&tiles(100), frame(100), Some(1.0), 1, None), 1);
        assert_eq!(batch_len(&tiles(100), frame(100), Some(1e12), 1, None), 100);
    }

    #[test]
    fn a_slow_worker_keeps_no_more_than_a_fast_one_needs_for_all() {
        let (slow, fast) = (20.0 * MEGA as f64, 400.0 * MEGA as f64);
        // The fast one would take a quarter of a second for all.
        assert_eq!(batch_len(&tiles(100), frame(100), Some(slow), 1, Some(fast)), 5);
        assert_eq!(batch_len(&tiles(100), frame(100), Some(fast), 1, Some(slow)), 100);
        assert_eq!(batch_len(&tiles(100), frame(100), Some(fast), 1, Some(fast)), 100);
        // Of an animation it takes as much as it would alone, until little is left.
        let animation = FrameLoad { rays_unopened: 1000 * MEGA, ..frame(100) };
        assert_eq!(batch_len(&tiles(100), animation, Some(slow), 1, Some(fast)), 20);
        // Something short is always worth it.
        assert_eq!(batch_len(&tiles(8), frame(100), Some(slow), 1, Some(fast)), 1);
    }

    #[test]
    fn idle_workers_share_a_frame() {
        assert_eq!(batch_len(&tiles(9), frame(9), Some(100.0 * MEGA as f64), 3, None), 3);
        assert_eq!(batch_len(&tiles(2), frame(9), Some(100.0 * MEGA as f64), 3, None), 1);
        assert_eq!(batch_len(&tiles(9), frame(9), Some(1e12), 3, None), 9, "it is done before another is asked");
    }

    #[test]
    fn a_tile_that_vanished_twice_goes_alone() {
        let mut ready = tiles(4);
        ready[2].is_isolated = true;
        assert_eq!(batch_len(&ready, frame(4), None, 1, None), 2);
        assert_eq!(batch_len(&ready[2..], frame(4), None, 1, None), 1);
    }

    #[test]
    fn a_frame_too_large_to_hold_is_not_whole() {
        assert!(is_whole_frame(16, frame(16)));
        assert!(!is_whole_frame(15, frame(16)));
        assert!(!is_whole_frame(17, frame(17)));
    }
}
