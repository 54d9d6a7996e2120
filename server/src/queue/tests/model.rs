//! Model of the queue in memory: jobs, frames, tiles and leases by the rules, without a database. It predicts
//! responses to workers and users, and checks that grants are legal.

use std::collections::BTreeMap;

use proto::job::{JobState, JobView};
use proto::worker_protocol::{Batch, BatchWork, LeaseOutcome, LeaseReport};
use proto::{JobId, LeaseId, WorkerId};

use super::LEASE_MS;
use crate::queue::LeaseEnd;

/// Tiles of a frame of the jobs in these tests.
pub(super) const TILES: u32 = 12;
/// Index of the stitch of a frame.
const STITCH: i64 = -1;
/// Minimum age of a straggler's lease.
const MIN_STRAGGLER_MS: i64 = 500;
/// Age from which a lease that its worker does not list counts as never received.
const UNHEARD_LEASE_MS: i64 = 2000;

type TileKey = (JobId, u32, i64);

#[derive(Clone, Debug)]
struct Lease {
    worker: WorkerId,
    tile: TileKey,
    granted_ms: i64,
    expires_ms: i64,
    live: bool,
}

#[derive(Clone, Debug, Default)]
struct Tile {
    blob: Option<String>,
    done: bool,
    errors: u32,
    crashes: u32,
    lost: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FrameState {
    Open,
    Stitching,
    Stored,
    Void,
}

#[derive(Clone, Debug)]
struct Frame {
    state: FrameState,
    tiles: BTreeMap<i64, Tile>,
}

#[derive(Clone, Debug)]
pub(super) struct Job {
    pub(super) state: JobState,
    pub(super) paused: bool,
    dead: bool,
    large: bool,
    frames_total: u32,
    frames: BTreeMap<u32, Frame>,
}

/// Complete state of the model.
#[derive(Clone, Debug, Default)]
pub(super) struct Model {
    pub(super) now_ms: i64,
    pub(super) farm_paused: bool,
    pub(super) jobs: BTreeMap<JobId, Job>,
    leases: BTreeMap<LeaseId, Lease>,
}

impl Model {
    pub(super) fn submit(&mut self, id: JobId, frames_total: u32, large: bool) {
        let job =
            Job { state: JobState::Queued, paused: false, dead: false, large, frames_total, frames: BTreeMap::new() };
        self.jobs.insert(id, job);
    }

    /// Records a granted batch, after checking that the grant was legal.
    pub(super) fn grant(&mut self, worker: WorkerId, takes_large: bool, run: &Batch) {
        assert!(!self.farm_paused, "the farm is paused: {run:?}");
        let job = self.jobs.get_mut(&run.job).expect("the job is there");
        assert!(!job.state.is_final() && !job.paused, "{:?}, paused: {}: {run:?}", job.state, job.paused);
        job.state = JobState::Running;
        let large = job.large;
        assert!(run.frame < job.frames_total);
        let frame = job.frames.entry(run.frame).or_insert_with(|| Frame {
            state: FrameState::Open,
            tiles: (0..i64::from(TILES)).map(|position| (position, Tile::default())).collect(),
        });
        let granted: Vec<(i64, LeaseId)> = match &run.work {
            BatchWork::Stitch { lease, inputs: parts } => {
                assert_eq!(frame.state, FrameState::Stitching);
                assert_eq!(parts.len() as u32, TILES);
                for part in parts {
                    assert_eq!(frame.tiles[&i64::from(part.index)].blob.as_deref(), Some(part.hash.as_str()));
                }
                vec![(STITCH, *lease)]
            }
            BatchWork::Render { tiles, whole_frame } => {
                assert!(takes_large || !large, "the scene is too large: {run:?}");
                assert_eq!(*whole_frame, tiles.len() as u32 == TILES);
                assert_eq!(frame.state, FrameState::Open);
                assert!(tiles.iter().all(|tile| !frame.tiles[&i64::from(tile.index)].done), "done before: {run:?}");
                tiles.iter().map(|tile| (i64::from(tile.index), tile.lease)).collect()
            }
        };
        for (position, lease) in granted {
            let tile = (run.job, run.frame, position);
            let live: Vec<&Lease> = self.live(tile).map(|id| &self.leases[&id]).collect();
            assert!(live.len() < 2, "a third lease: {run:?}");
            for other in live {
                assert!(other.worker != worker, "both leases belong to one worker: {run:?}");
                assert!(self.now_ms - other.granted_ms >= MIN_STRAGGLER_MS, "the tile is not a straggler: {run:?}");
            }
            let (granted_ms, expires_ms) = (self.now_ms, self.now_ms + LEASE_MS);
            self.leases.insert(lease, Lease { worker, tile, granted_ms, expires_ms, live: true });
        }
    }

    fn live(&self, tile: TileKey) -> impl Iterator<Item = LeaseId> {
        self.leases.iter().filter(move |(_, lease)| lease.live && lease.tile == tile).map(|(id, _)| *id)
    }

    fn end_where(&mut self, mut which: impl FnMut(&Lease) -> bool) {
        for lease in self.leases.values_mut().filter(|lease| lease.live) {
            lease.live = !which(lease);
        }
    }

    fn frame(&mut self, tile: TileKey) -> &mut Frame {
        self.jobs.get_mut(&tile.0).expect("the job").frames.get_mut(&tile.1).expect("the frame")
    }

    /// Records a worker's results and its remaining leases; returns the leases that the response must revoke.
    pub(super) fn report(&mut self, worker: WorkerId, results: &[LeaseReport], holding: &[LeaseId]) -> Vec<LeaseId> {
        let mut lost = Vec::new();
        let mut pictures: BTreeMap<&str, Vec<LeaseId>> = BTreeMap::new();
        for report in results {
            if let LeaseOutcome::Picture { hash, .. } = &report.outcome {
                pictures.entry(hash).or_default().push(report.lease);
            }
        }
        for leases in pictures.values() {
            let (live, dead): (Vec<_>, Vec<_>) = leases.iter().partition(|lease| self.is_held(worker, **lease));
            lost.extend(dead);
            self.picture(&live);
        }
        for blobs in [true, false] {
            for LeaseReport { lease, outcome } in results {
                let is_blob = matches!(outcome, LeaseOutcome::Blob { .. });
                if matches!(outcome, LeaseOutcome::Picture { .. }) || is_blob != blobs {
                } else if self.is_held(worker, *lease) {
                    self.result(*lease, outcome);
                } else {
                    lost.push(*lease);
                }
            }
        }
        for lease in holding {
            match self.leases.get_mut(lease).filter(|lease| lease.live && lease.worker == worker) {
                Some(lease) => lease.expires_ms = self.now_ms + LEASE_MS,
                None => lost.push(*lease),
            }
        }
        let heard_ms = self.now_ms - UNHEARD_LEASE_MS;
        self.give_up_where(LeaseEnd::Released, |lease| lease.worker == worker && lease.granted_ms <= heard_ms, holding);
        lost
    }

    fn is_held(&self, worker: WorkerId, lease: LeaseId) -> bool {
        self.leases.get(&lease).is_some_and(|lease| lease.live && lease.worker == worker)
    }

    fn picture(&mut self, leases: &[LeaseId]) {
        let mut frames: BTreeMap<(JobId, u32), Vec<LeaseId>> = BTreeMap::new();
        for lease in leases {
            let (job, frame, _) = self.leases[lease].tile;
            frames.entry((job, frame)).or_default().push(*lease);
        }
        for ((job, number), leases) in frames {
            let stitched = leases.len() == 1 && self.leases[&leases[0]].tile.2 == STITCH;
            let frame = self.frame((job, number, STITCH));
            if !stitched && (frame.state != FrameState::Open || leases.len() as u32 != TILES) {
                for lease in leases {
                    self.give_up(lease, LeaseEnd::Released);
                }
                continue;
            }
            frame.state = FrameState::Stored;
            frame.tiles.values_mut().for_each(|tile| tile.done = true);
            self.end_where(|lease| (lease.tile.0, lease.tile.1) == (job, number));
            let job = self.jobs.get_mut(&job).expect("the job");
            if job.frames_stored() == u64::from(job.frames_total) {
                job.state = JobState::Succeeded;
            }
        }
    }

    fn result(&mut self, lease: LeaseId, outcome: &LeaseOutcome) {
        let tile = self.leases[&lease].tile;
        match outcome {
            LeaseOutcome::Blob { hash, .. } if tile.2 != STITCH => {
                self.end_where(|other| other.tile == tile);
                let frame = self.frame(tile);
                let done = frame.tiles.get_mut(&tile.2).expect("the tile");
                assert!(!done.done, "done twice");
                (done.done, done.blob) = (true, Some(hash.clone()));
                if frame.tiles.values().all(|tile| tile.done) {
                    frame.state = FrameState::Stitching;
                    frame.tiles.entry(STITCH).or_default();
                    // The stitch does not count toward the frame's pixels.
                    frame.tiles.get_mut(&STITCH).expect("the stitch").done = true;
                }
            }
            LeaseOutcome::BadBlobs { tiles } if tile.2 == STITCH => {
                self.give_up(lease, LeaseEnd::Lost);
                let frame = self.frame(tile);
                if frame.state != FrameState::Stitching {
                    return;
                }
                let bad: Vec<i64> = tiles.iter().map(|index| i64::from(*index)).collect();
                for (_, tile) in frame.tiles.iter_mut().filter(|(position, _)| bad.contains(position)) {
                    (tile.done, tile.blob) = (false, None);
                }
                if frame.tiles.values().any(|tile| !tile.done) {
                    frame.state = FrameState::Open;
                    self.end_where(|other| other.tile == tile);
                }
            }
            LeaseOutcome::Released => self.give_up(lease, LeaseEnd::Released),
            LeaseOutcome::Failed { .. }
            | LeaseOutcome::Blob { .. }
            | LeaseOutcome::BadBlobs { .. }
            | LeaseOutcome::Picture { .. } => {
                self.give_up(lease, LeaseEnd::Failed);
            }
        }
    }

    fn give_up(&mut self, id: LeaseId, cause: LeaseEnd) {
        let lease = self.leases.get_mut(&id).expect("the lease");
        lease.live = false;
        let key = lease.tile;
        let is_leased = self.live(key).next().is_some();
        let tile = self.frame(key).tiles.get_mut(&key.2).expect("the tile");
        match cause {
            LeaseEnd::Failed => tile.errors += 1,
            LeaseEnd::Crashed => tile.crashes += 1,
            LeaseEnd::Lost => tile.lost += 1,
            LeaseEnd::Released | LeaseEnd::Rejected => {}
        }
        if !is_leased && (tile.errors >= 3 || tile.crashes >= 3 || tile.lost >= 50) {
            self.jobs.get_mut(&key.0).expect("the job").dead = true;
            self.end_job(key.0, JobState::Failed);
        }
    }

    fn end_job(&mut self, id: JobId, state: JobState) {
        self.end_where(|lease| lease.tile.0 == id);
        let job = self.jobs.get_mut(&id).expect("the job");
        job.state = state;
        for frame in job.frames.values_mut().filter(|frame| frame.state != FrameState::Stored) {
            frame.state = FrameState::Void;
        }
    }

    pub(super) fn cancel(&mut self, id: JobId) {
        if !self.jobs[&id].state.is_final() {
            self.end_job(id, JobState::Cancelled);
        }
    }

    pub(super) fn retry(&mut self, id: JobId) {
        let job = self.jobs.get_mut(&id).expect("the job");
        if job.state != JobState::Failed || !job.dead {
            return;
        }
        (job.state, job.dead) = (JobState::Running, false);
        for frame in job.frames.values_mut().filter(|frame| frame.state == FrameState::Void) {
            let complete = frame.tiles.iter().all(|(_, tile)| tile.done);
            frame.state = if complete { FrameState::Stitching } else { FrameState::Open };
            for (position, tile) in &mut frame.tiles {
                if !tile.done || (complete && *position == STITCH) {
                    *tile = Tile { done: tile.done, ..Tile::default() };
                }
            }
        }
    }

    /// Advances the clock and expires overdue leases.
    pub(super) fn pass(&mut self, ms: i64) {
        self.now_ms += ms;
        let now_ms = self.now_ms;
        self.give_up_where(LeaseEnd::Lost, |lease| lease.expires_ms <= now_ms, &[]);
    }

    /// Records the exit of a worker's process.
    pub(super) fn reap(&mut self, worker: WorkerId, cause: LeaseEnd) {
        self.give_up_where(cause, |lease| lease.worker == worker, &[]);
    }

    /// Ends leases, but for some.
    fn give_up_where(&mut self, cause: LeaseEnd, which: impl Fn(&Lease) -> bool, kept: &[LeaseId]) {
        let ends = |(id, lease): &(&LeaseId, &Lease)| lease.live && which(lease) && !kept.contains(id);
        let mut ending: Vec<LeaseId> = self.leases.iter().filter(ends).map(|(id, _)| *id).collect();
        ending.sort_by_key(|id| (self.leases[id].expires_ms, *id));
        for id in ending {
            if self.leases[&id].live {
                self.give_up(id, cause);
            }
        }
    }

    /// Restarts the server: leases of its old pool end, the others last for one more lease length.
    pub(super) fn restart(&mut self, pool: &[WorkerId]) {
        self.now_ms = 0;
        self.end_where(|lease| pool.contains(&lease.worker));
        for lease in self.leases.values_mut() {
            (lease.granted_ms, lease.expires_ms) = (0, LEASE_MS);
        }
    }

    /// Checks that a user's view matches the model.
    pub(super) fn compare(&self, id: JobId, view: Option<&JobView>) {
        let (Some(view), Some(job)) = (view, self.jobs.get(&id)) else {
            assert!(view.is_none() && !self.jobs.contains_key(&id), "{view:?}");
            return;
        };
        let seen = (view.state, view.paused, view.tiles.done, view.frames.done);
        assert_eq!(seen, (job.state, job.paused, job.tiles_done(), job.frames_stored()), "{view:?} {job:?}");
    }
}

impl Job {
    fn tiles_done(&self) -> u64 {
        let pixels = self.frames.values().flat_map(|frame| &frame.tiles).filter(|(position, _)| **position != STITCH);
        pixels.filter(|(_, tile)| tile.done).count() as u64
    }

    fn frames_stored(&self) -> u64 {
        self.frames.values().filter(|frame| frame.state == FrameState::Stored).count() as u64
    }
}
