//! The events of a job's changes: their bodies, and which ones a change has. Pure, so that the model of the tests
//! shares it.

use proto::event::{FrameEvent, ProgressEvent, StateEvent, TileEvent};
use proto::job::{DoneOfTotal, JobState};
use serde::Serialize;

use crate::clock::rfc3339;

/// An event that is not written yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::queue) struct NewEvent {
    /// Event type.
    pub(in crate::queue) kind: &'static str,
    /// State of the job, if it is a `state` event.
    pub(in crate::queue) state: Option<JobState>,
    /// Payload, as JSON.
    pub(in crate::queue) body: String,
}

/// Picture that a frame shows from now on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::queue) struct FramePicture {
    /// The frame.
    pub(in crate::queue) frame: u32,
    /// Hash of the picture.
    pub(in crate::queue) hash: String,
    /// Size of the picture.
    pub(in crate::queue) size_bytes: u64,
}

/// A tile that became done, or is done no more.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::queue) struct ChangedTile {
    /// Its event.
    pub(in crate::queue) event: TileEvent,
    /// Its rays.
    pub(in crate::queue) rays: i64,
}

/// Change of a job's counters. Its events and its counters come from the same values.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::queue) struct Progress {
    /// Tiles done.
    pub(in crate::queue) tiles: i64,
    /// Rays done.
    pub(in crate::queue) rays: i64,
    tile_events: Vec<TileEvent>,
    picture: Option<FramePicture>,
    /// The job's `rays_peak` before it; `None` if its rays cannot exceed that.
    peak_before: Option<i64>,
}

/// Counters of a job after a change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::queue) struct JobCounters {
    /// Tiles done.
    pub(in crate::queue) tiles_done: u64,
    /// Tiles of all frames.
    pub(in crate::queue) tiles_total: u64,
    /// Maximum of the rays that were done at one time.
    pub(in crate::queue) rays_peak: i64,
    /// Rays of all frames.
    pub(in crate::queue) rays_total: i64,
}

impl Progress {
    /// Of tiles that became done, or are done no more, and the job's `rays_peak` before.
    pub(in crate::queue) fn of_tiles(changed: Vec<ChangedTile>, peak_before: Option<i64>) -> Self {
        let sign = |tile: &ChangedTile| if tile.event.done { 1 } else { -1 };
        Self {
            tiles: changed.iter().map(sign).sum(),
            rays: changed.iter().map(|tile| sign(tile) * tile.rays).sum(),
            tile_events: changed.into_iter().map(|tile| tile.event).collect(),
            picture: None,
            peak_before,
        }
    }

    /// Of a frame whose picture was in the cache, with this number of tiles and rays, and the job's `rays_peak` before.
    pub(in crate::queue) fn of_cached_frame(picture: FramePicture, tiles: i64, rays: i64, peak_before: i64) -> Self {
        Self { tiles, rays, tile_events: Vec::new(), picture: Some(picture), peak_before: Some(peak_before) }
    }

    /// The same, after which the picture of a frame is stored.
    pub(in crate::queue) fn with_picture(self, picture: FramePicture) -> Self {
        Self { picture: Some(picture), ..self }
    }

    /// Frames stored.
    pub(in crate::queue) fn frames(&self) -> i64 {
        i64::from(self.picture.is_some())
    }

    /// Its events: of tiles, of the frame, and of another hundredth of the rays.
    pub(in crate::queue) fn into_events(self, job: &str, after: JobCounters) -> Vec<NewEvent> {
        let mut events: Vec<NewEvent> = self.tile_events.iter().map(NewEvent::tile).collect();
        events.extend(self.picture.map(|picture| NewEvent::frame(job, picture)));
        events.extend(self.peak_before.and_then(|before| NewEvent::progress(before, after)));
        events
    }
}

impl NewEvent {
    /// A job has reached a state at this time of the wall clock.
    pub(in crate::queue) fn state(state: JobState, error: Option<String>, at_ms: i64) -> Self {
        let event = StateEvent { state, errors: error.into_iter().collect(), at: rfc3339(at_ms) };
        Self { kind: "state", state: Some(state), body: json(&event) }
    }

    /// More rays are done, if that is another hundredth of them.
    ///
    /// The body has the shortest digits that give the same number; readers round it.
    fn progress(peak_before: i64, after: JobCounters) -> Option<Self> {
        let hundredth = |rays: i64| (rays as f64 * 100.0 / after.rays_total as f64) as i64;
        if hundredth(peak_before) == hundredth(after.rays_peak) {
            return None;
        }
        let event = ProgressEvent {
            progress: after.rays_peak as f64 / after.rays_total as f64,
            tiles: DoneOfTotal { done: after.tiles_done, total: after.tiles_total },
        };
        Some(Self { kind: "progress", state: None, body: json(&event) })
    }

    fn tile(event: &TileEvent) -> Self {
        Self { kind: "tile", state: None, body: json(event) }
    }

    fn frame(job: &str, picture: FramePicture) -> Self {
        let FramePicture { frame, hash, size_bytes } = picture;
        let image = format!("/v1/jobs/{job}/frames/{frame}/image");
        Self { kind: "frame", state: None, body: json(&FrameEvent { frame, picture: hash, size_bytes, image }) }
    }

    /// The name by which webhooks ask for it; `None` if none can.
    pub(in crate::queue) fn webhook_event(&self) -> Option<String> {
        match (self.kind, self.state) {
            ("frame", _) => Some("frame.stored".to_owned()),
            (_, state) => state.map(|state| format!("job.{}", state.name())),
        }
    }
}

fn json(event: &impl Serialize) -> String {
    serde_json::to_string(event).expect("events have text as keys")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counters(rays_peak: i64, rays_total: i64) -> JobCounters {
        JobCounters { tiles_done: 1, tiles_total: 3, rays_peak, rays_total }
    }

    #[test]
    fn progress_is_told_by_hundredths() {
        assert_eq!(NewEvent::progress(0, counters(9, 1000)), None);
        assert_eq!(NewEvent::progress(500, counters(500, 1000)), None);
        for (peak, total, received) in [(1, 3, "0.3333333333333333"), (1, 2, "0.5"), (7, 7, "1.0")] {
            let event = NewEvent::progress(0, counters(peak, total)).expect("a hundredth");
            assert_eq!(event.body, format!(r#"{{"progress":{received},"tiles":{{"done":1,"total":3}}}}"#));
        }
    }

    #[test]
    fn bodies_are_those_of_earlier_releases() {
        let picture = FramePicture { frame: 2, hash: "ab".to_owned(), size_bytes: 5 };
        assert_eq!(
            NewEvent::frame("x", picture).body,
            r#"{"frame":2,"picture":"ab","size_bytes":5,"image":"/v1/jobs/x/frames/2/image"}"#
        );
        assert_eq!(
            NewEvent::state(JobState::Failed, Some("a \"b\"\n".to_owned()), 1).body,
            r#"{"state":"failed","errors":["a \"b\"\n"],"at":"1970-01-01T00:00:00.001Z"}"#
        );
        let event = TileEvent { frame: 0, x: 1, y: 2, width: 3, height: 4, done: false };
        let undone = Progress::of_tiles(vec![ChangedTile { event, rays: 12 }], Some(12));
        assert_eq!((undone.tiles, undone.rays, undone.frames()), (-1, -12, 0));
        let events = undone.into_events("x", counters(12, 36));
        assert_eq!(events.len(), 1);
        assert_eq!(events[0].body, r#"{"frame":0,"x":1,"y":2,"width":3,"height":4,"done":false}"#);
    }
}
