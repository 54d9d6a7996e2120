//! Model of the queue in memory: jobs, frames, tiles and leases by the rules, without a database. It predicts
//! responses to workers and users, and all events and webhook deliveries, and checks that grants are legal.

mod outbox;

use std::collections::BTreeMap;

use proto::event::TileEvent;
use proto::job::{JobState, JobView};
use proto::worker_protocol::{Batch, BatchWork, LeaseOutcome, LeaseReport};
use proto::{JobId, LeaseId, WorkerId};

use super::{LEASE_MS, new_job};
use crate::db::Readers;
use crate::queue::LeaseEnd;
use crate::queue::events::effects::{ChangedTile, FramePicture, JobCounters, NewEvent, Progress};
use outbox::Outbox;

/// Tiles of a frame of the jobs in these tests.
pub(super) const TILES: u32 = 12;
/// Pixels of a tile of the jobs in these tests.
const TILE_PIXELS: i64 = 32 * 32;
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
    /// Maximum of the rays that were done at one time.
    rays_peak: i64,
}

/// Complete state of the model.
#[derive(Clone, Debug, Default)]
pub(super) struct Model {
    pub(super) now_ms: i64,
    pub(super) farm_paused: bool,
    pub(super) jobs: BTreeMap<JobId, Job>,
    leases: BTreeMap<LeaseId, Lease>,
    outbox: Outbox,
}

impl Model {
    pub(super) fn submit(
        &mut self,
        id: JobId,
        frames_total: u32,
        large: bool,
        webhooks: Vec<(String, Vec<&'static str>)>,
    ) {
        let (state, frames) = (JobState::Queued, BTreeMap::new());
        let job = Job { state, paused: false, dead: false, large, frames_total, frames, rays_peak: 0 };
        self.jobs.insert(id, job);
        self.reach(id, JobState::Queued, None);
        self.outbox.register(id, webhooks);
    }

    /// Records that a job has reached a state.
    fn reach(&mut self, id: JobId, state: JobState, error: Option<String>) {
        self.jobs.get_mut(&id).expect("the job").state = state;
        self.outbox.add(id, NewEvent::state(state, error, self.now_ms));
    }

    /// Records that tiles are done, or done no more, and that a frame is stored; they have changed already.
    fn progress(&mut self, id: JobId, tiles: Vec<ChangedTile>, picture: Option<FramePicture>) {
        let job = self.jobs.get_mut(&id).expect("the job");
        let progress = Progress::of_tiles(tiles, Some(job.rays_peak));
        let progress = if let Some(picture) = picture { progress.with_picture(picture) } else { progress };
        let (tiles_done, plan) = (job.tiles_done(), new_job(job.frames_total).plan);
        job.rays_peak = job.rays_peak.max(tiles_done.cast_signed() * TILE_PIXELS);
        let after = JobCounters {
            tiles_done,
            tiles_total: plan.tiles_total(),
            rays_peak: job.rays_peak,
            rays_total: plan.rays_total().cast_signed(),
        };
        for event in progress.into_events(&id.to_string(), after) {
            self.outbox.add(id, event);
        }
    }

    /// Compares all events and deliveries with those in the database.
    pub(super) async fn compare_outbox(&self, readers: &Readers) {
        self.outbox.compare(readers).await;
    }

    pub(super) fn delete(&mut self, id: JobId) {
        self.jobs.remove(&id);
        self.outbox.forget(id);
    }

    /// Records a granted batch, after checking that the grant was legal.
    pub(super) fn grant(&mut self, worker: WorkerId, takes_large: bool, run: &Batch) {
        assert!(!self.farm_paused, "the farm is paused: {run:?}");
        let job = self.jobs.get_mut(&run.job).expect("the job is there");
        assert!(!job.state.is_final() && !job.paused, "{:?}, paused: {}: {run:?}", job.state, job.paused);
        let (large, is_first) = (job.large, job.state == JobState::Queued);
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
        if is_first {
            self.reach(run.job, JobState::Running, None);
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
        for (hash, leases) in pictures {
            let (live, dead): (Vec<_>, Vec<_>) = leases.iter().partition(|lease| self.is_held(worker, **lease));
            lost.extend(dead);
            self.picture(&live, hash);
        }
        for blobs in [true, false] {
            let mut frames: BTreeMap<(JobId, u32), Vec<TileKey>> = BTreeMap::new();
            for LeaseReport { lease, outcome } in results {
                let is_blob = matches!(outcome, LeaseOutcome::Blob { .. });
                if matches!(outcome, LeaseOutcome::Picture { .. }) || is_blob != blobs {
                } else if self.is_held(worker, *lease) {
                    if let Some(tile) = self.result(*lease, outcome) {
                        frames.entry((tile.0, tile.1)).or_default().push(tile);
                    }
                } else {
                    lost.push(*lease);
                }
            }
            // All results of a frame count together.
            for ((job, _), mut tiles) in frames {
                tiles.sort_by_key(|tile| tile.2);
                self.progress(job, tiles.into_iter().map(|tile| changed(tile, true)).collect(), None);
            }
        }
        for lease in holding {
            match self.leases.get_mut(lease).filter(|lease| lease.live && lease.worker == worker) {
                Some(lease) => lease.expires_ms = self.now_ms + LEASE_MS,
                None => lost.push(*lease),
            }
        }
        let heard_ms = self.now_ms - UNHEARD_LEASE_MS;
        let mut unheard = self.live_where(|lease| lease.worker == worker && lease.granted_ms <= heard_ms);
        unheard.retain(|lease| !holding.contains(lease));
        self.give_up_all(&unheard, LeaseEnd::Released, "its worker never received the lease");
        lost
    }

    fn is_held(&self, worker: WorkerId, lease: LeaseId) -> bool {
        self.leases.get(&lease).is_some_and(|lease| lease.live && lease.worker == worker)
    }

    fn picture(&mut self, leases: &[LeaseId], hash: &str) {
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
                    let message = "its worker delivered a picture without leases for all tiles of the frame";
                    self.give_up(lease, LeaseEnd::Released, message);
                }
                continue;
            }
            frame.state = FrameState::Stored;
            let open = frame.tiles.iter_mut().filter(|(_, tile)| !tile.done);
            let done: Vec<ChangedTile> = open
                .map(|(position, tile)| {
                    tile.done = true;
                    changed((job, number, *position), true)
                })
                .collect();
            self.end_where(|lease| (lease.tile.0, lease.tile.1) == (job, number));
            let picture = FramePicture { frame: number, hash: hash.to_owned(), size_bytes: 1 };
            self.progress(job, done, Some(picture));
            let stored = &self.jobs[&job];
            if stored.frames_stored() == u64::from(stored.frames_total) {
                self.reach(job, JobState::Succeeded, None);
            }
        }
    }

    /// Records a result; returns its tile if that is done.
    fn result(&mut self, lease: LeaseId, outcome: &LeaseOutcome) -> Option<TileKey> {
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
                return Some(tile);
            }
            LeaseOutcome::BadBlobs { tiles } if tile.2 == STITCH => {
                self.give_up(lease, LeaseEnd::Lost, "its blobs were damaged repeatedly");
                self.redo(tile, tiles);
            }
            LeaseOutcome::Released => self.give_up(lease, LeaseEnd::Released, "its worker released it"),
            LeaseOutcome::Failed { message } => self.give_up(lease, LeaseEnd::Failed, message),
            LeaseOutcome::Blob { .. } | LeaseOutcome::BadBlobs { .. } | LeaseOutcome::Picture { .. } => {
                self.give_up(lease, LeaseEnd::Failed, "its worker sent a result that was not requested");
            }
        }
        None
    }

    /// Opens a frame again whose stitch found damaged blobs.
    fn redo(&mut self, stitch: TileKey, damaged: &[u32]) {
        let frame = self.frame(stitch);
        if frame.state != FrameState::Stitching {
            return;
        }
        let damaged: Vec<i64> = damaged.iter().map(|index| i64::from(*index)).collect();
        let mut undone = Vec::new();
        for (position, tile) in frame.tiles.iter_mut().filter(|(position, _)| damaged.contains(position)) {
            (tile.done, tile.blob) = (false, None);
            undone.push(changed((stitch.0, stitch.1, *position), false));
        }
        if !undone.is_empty() {
            frame.state = FrameState::Open;
            self.end_where(|other| other.tile == stitch);
            self.progress(stitch.0, undone, None);
        }
    }

    fn give_up(&mut self, id: LeaseId, cause: LeaseEnd, message: &str) {
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
            let place = if key.2 == STITCH { "could not be stitched" } else { "could not be rendered" };
            self.end_job(key.0, JobState::Failed, Some(format!("frame {} {place}: {message}", key.1)));
        }
    }

    fn end_job(&mut self, id: JobId, state: JobState, error: Option<String>) {
        self.end_where(|lease| lease.tile.0 == id);
        self.reach(id, state, error);
        let job = self.jobs.get_mut(&id).expect("the job");
        for frame in job.frames.values_mut().filter(|frame| frame.state != FrameState::Stored) {
            frame.state = FrameState::Void;
        }
    }

    pub(super) fn cancel(&mut self, id: JobId) {
        if !self.jobs[&id].state.is_final() {
            self.end_job(id, JobState::Cancelled, None);
        }
    }

    pub(super) fn retry(&mut self, id: JobId) {
        let job = self.jobs.get_mut(&id).expect("the job");
        if job.state != JobState::Failed || !job.dead {
            return;
        }
        job.dead = false;
        for frame in job.frames.values_mut().filter(|frame| frame.state == FrameState::Void) {
            let complete = frame.tiles.iter().all(|(_, tile)| tile.done);
            frame.state = if complete { FrameState::Stitching } else { FrameState::Open };
            for (position, tile) in &mut frame.tiles {
                if !tile.done || (complete && *position == STITCH) {
                    *tile = Tile { done: tile.done, ..Tile::default() };
                }
            }
        }
        self.reach(id, JobState::Running, None);
    }

    /// Advances the clock and expires overdue leases.
    pub(super) fn pass(&mut self, ms: i64) {
        self.now_ms += ms;
        let mut overdue = self.live_where(|lease| lease.expires_ms <= self.now_ms);
        overdue.sort_by_key(|id| self.leases[id].expires_ms);
        self.give_up_all(&overdue, LeaseEnd::Lost, "its workers vanished repeatedly");
    }

    /// Records the exit of a worker's process.
    pub(super) fn reap(&mut self, worker: WorkerId, cause: LeaseEnd, message: &str) {
        self.give_up_all(&self.live_where(|lease| lease.worker == worker), cause, message);
    }

    /// Live leases, in the order of their grants.
    fn live_where(&self, which: impl Fn(&Lease) -> bool) -> Vec<LeaseId> {
        self.leases.iter().filter(|(_, lease)| lease.live && which(lease)).map(|(id, _)| *id).collect()
    }

    /// Ends leases without a result, but for those that the failure of a job has ended in the meantime.
    fn give_up_all(&mut self, leases: &[LeaseId], cause: LeaseEnd, message: &str) {
        for id in leases {
            if self.leases[id].live {
                self.give_up(*id, cause, message);
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

/// A tile that became done, or is done no more.
fn changed((_, frame, position): TileKey, done: bool) -> ChangedTile {
    let index = usize::try_from(position).expect("no stitch");
    let rect = new_job(1).plan.tiles()[index];
    let event = TileEvent { frame, x: rect.x, y: rect.y, width: rect.width, height: rect.height, done };
    ChangedTile { event, rays: TILE_PIXELS }
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
