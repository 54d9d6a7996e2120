//! Batch size: the number of a frame's tiles that one worker gets. Arithmetic only.

use std::time::Duration;

/// A worker without a measured speed gets frames up to this many rays complete.
const SMALL_FRAME_RAYS: u64 = 1 << 22;
/// Target duration of a batch.
const TARGET_BATCH: Duration = Duration::from_secs(1);
/// Batches up to this long go to any worker, and frames up to this long are not split, because the delay is not
/// worth another claim.
const MIN_BATCH: Duration = Duration::from_millis(50);
/// Maximum pixel data for which one worker gets a complete frame.
const MAX_WHOLE_FRAME_BYTES: u64 = 256 << 20;

/// Ready tile, with the data that the batch size depends on.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReadyTile {
    /// Camera rays of the tile.
    pub(super) rays: u64,
    /// Whether the tile was lost with its worker before, so that it is leased alone.
    pub(super) is_isolated: bool,
}

/// Frame of the tiles.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrameLoad {
    /// Number of its tiles, ready or not.
    pub(super) tiles: u64,
    /// Number of their rays.
    pub(super) rays: u64,
    /// Bytes of its finished data.
    pub(super) size_bytes: u64,
    /// Camera rays of the job's frames that are not opened yet.
    pub(super) rays_unopened: u64,
}

/// Number of `ready` tiles, from the first, that a worker gets. The batch takes the worker no longer than the
/// fastest other worker would need for all remaining work of the job.
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
    fn a_worker_without_speed_gets_small_frames_or_one_tile() {
        assert_eq!(batch_len(&tiles(4), frame(4), None, 3, None), 4);
        assert_eq!(batch_len(&tiles(9), frame(9), None, 1, None), 1);
    }

    #[test]
    fn a_batch_takes_about_a_second() {
        assert_eq!(batch_len(&tiles(100), frame(100), Some(5.5 * MEGA as f64), 1, None), 5);
        assert_eq!(batch_len(&tiles(100), frame(100), Some(1.0), 1, None), 1);
        assert_eq!(batch_len(&tiles(100), frame(100), Some(1e12), 1, None), 100);
    }

    #[test]
    fn a_slow_worker_gets_less_than_a_fast_one() {
        let (slow, fast) = (20.0 * MEGA as f64, 400.0 * MEGA as f64);
        // The fast worker would take 0.25 s for all tiles.
        assert_eq!(batch_len(&tiles(100), frame(100), Some(slow), 1, Some(fast)), 5);
        assert_eq!(batch_len(&tiles(100), frame(100), Some(fast), 1, Some(slow)), 100);
        assert_eq!(batch_len(&tiles(100), frame(100), Some(fast), 1, Some(fast)), 100);
        // For an animation it gets as much as it would alone, until little is left.
        let animation = FrameLoad { rays_unopened: 1000 * MEGA, ..frame(100) };
        assert_eq!(batch_len(&tiles(100), animation, Some(slow), 1, Some(fast)), 20);
        // A short batch is always granted.
        assert_eq!(batch_len(&tiles(8), frame(100), Some(slow), 1, Some(fast)), 1);
    }

    #[test]
    fn idle_workers_share_a_frame() {
        assert_eq!(batch_len(&tiles(9), frame(9), Some(100.0 * MEGA as f64), 3, None), 3);
        assert_eq!(batch_len(&tiles(2), frame(9), Some(100.0 * MEGA as f64), 3, None), 1);
        assert_eq!(
            batch_len(&tiles(9), frame(9), Some(1e12), 3, None),
            9,
            "the frame is finished before another worker could start"
        );
    }

    #[test]
    fn a_tile_lost_twice_is_leased_alone() {
        let mut ready = tiles(4);
        ready[2].is_isolated = true;
        assert_eq!(batch_len(&ready, frame(4), None, 1, None), 2);
        assert_eq!(batch_len(&ready[2..], frame(4), None, 1, None), 1);
    }

    #[test]
    fn a_frame_too_large_for_memory_is_not_granted_whole() {
        assert!(is_whole_frame(16, frame(16)));
        assert!(!is_whole_frame(15, frame(16)));
        assert!(!is_whole_frame(17, frame(17)));
    }
}
