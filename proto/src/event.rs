//! Events of a job, as `GET /v1/jobs/{id}/events` sends them, and of the farm, as `GET /v1/events` does, and their parser.
//!
//! It only names and parses; subscriptions are managed elsewhere.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::farm::FarmCounts;
use crate::job::{DoneOfTotal, JobState, JobView};

/// A job has reached a state.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct StateEvent {
    /// The state.
    pub state: JobState,
    /// Error messages.
    pub errors: Vec<String>,
    /// Time: RFC 3339, UTC.
    pub at: String,
}

/// Sent each time another hundredth of a job's rays has been rendered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProgressEvent {
    /// Fraction of its rays that are rendered, 0 to 1; never decreases.
    pub progress: f64,
    /// Tiles of all frames.
    pub tiles: DoneOfTotal,
}

/// A tile was rendered, or has to be rendered again.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TileEvent {
    /// The frame, from 0.
    pub frame: u32,
    /// Left edge, in pixels.
    pub x: u32,
    /// Upper edge, in pixels.
    pub y: u32,
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
    /// False if the tile's pixels were lost, so that it will be rendered again.
    pub done: bool,
}

/// A frame's picture is stored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FrameEvent {
    /// The frame, from 0.
    pub frame: u32,
    /// BLAKE3 of the picture's bytes, in hex.
    pub picture: String,
    /// Size of the picture.
    pub size_bytes: u64,
    /// The picture's address on this server.
    pub image: String,
}

/// State of a job; sent first if missed events have been pruned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Snapshot {
    /// The job's state.
    pub state: JobState,
    /// Error messages.
    pub errors: Vec<String>,
    /// Fraction of its rays that are rendered, 0 to 1.
    pub progress: f64,
    /// Tiles of all frames.
    pub tiles: DoneOfTotal,
    /// Frames; one is done when its picture is stored.
    pub frames: DoneOfTotal,
    /// The frames whose pictures are stored: first and last of each run.
    pub stored: Vec<[u32; 2]>,
    /// The rendered tiles of frames that are not stored.
    pub rectangles: Vec<TileEvent>,
}

/// Event of any type.
#[derive(Clone, Debug, PartialEq)]
pub enum JobEvent {
    /// The job has reached a state.
    State(StateEvent),
    /// Another hundredth of the rays has been rendered.
    Progress(ProgressEvent),
    /// A tile is rendered.
    Tile(TileEvent),
    /// A frame is stored.
    Frame(FrameEvent),
    /// State of the job.
    Snapshot(Snapshot),
}

impl JobEvent {
    /// Reads an event; `None` if this version does not know it.
    pub fn parse(name: &str, data: &str) -> Option<Self> {
        match name {
            "state" => serde_json::from_str(data).map(Self::State).ok(),
            "progress" => serde_json::from_str(data).map(Self::Progress).ok(),
            "tile" => serde_json::from_str(data).map(Self::Tile).ok(),
            "frame" => serde_json::from_str(data).map(Self::Frame).ok(),
            "snapshot" => serde_json::from_str(data).map(Self::Snapshot).ok(),
            _ => None,
        }
    }
}

/// First event of the farm's.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HelloEvent {
    /// The server's time: RFC 3339, UTC.
    pub server_time: String,
}

/// A job was deleted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DeletedEvent {
    /// The id that it had.
    pub id: String,
}

/// Event of the farm.
#[derive(Clone, Debug)]
pub enum FarmEvent {
    /// The stream has begun: it has every later change.
    Hello(HelloEvent),
    /// A job has changed, or is new.
    Job(Box<JobView>),
    /// A job was deleted.
    Deleted(DeletedEvent),
    /// The farm's numbers have changed.
    Farm(FarmCounts),
    /// The stream has not all changes of jobs: read their list again.
    Resync,
}

impl FarmEvent {
    /// Reads an event; `None` if this version does not know it.
    pub fn parse(name: &str, data: &str) -> Option<Self> {
        match name {
            "hello" => serde_json::from_str(data).map(Self::Hello).ok(),
            "job" => serde_json::from_str(data).map(Self::Job).ok(),
            "deleted" => serde_json::from_str(data).map(Self::Deleted).ok(),
            "farm" => serde_json::from_str(data).map(Self::Farm).ok(),
            "resync" => Some(Self::Resync),
            _ => None,
        }
    }
}

/// Event as received.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SseMessage {
    /// Event id, from which the stream can be resumed.
    pub id: Option<String>,
    /// Its name.
    pub event: String,
    /// Data.
    pub data: String,
}

/// Incremental parser of server-sent events, as the HTML standard defines them.
#[derive(Debug, Default)]
pub struct SseParser {
    rest: Vec<u8>,
    current: SseMessage,
}

impl SseParser {
    /// Adds bytes; returns the events completed by them.
    pub fn push(&mut self, bytes: &[u8]) -> Vec<SseMessage> {
        self.rest.extend_from_slice(bytes);
        let mut whole = Vec::new();
        let mut start = 0;
        while let Some(length) = self.rest[start..].iter().position(|byte| *byte == b'\n') {
            let line = String::from_utf8_lossy(&self.rest[start..start + length]).into_owned();
            start += length + 1;
            if let Some(message) = self.line(line.trim_end_matches('\r')) {
                whole.push(message);
            }
        }
        self.rest.drain(..start);
        whole
    }

    fn line(&mut self, line: &str) -> Option<SseMessage> {
        if line.is_empty() {
            let message = std::mem::take(&mut self.current);
            return (!message.data.is_empty()).then_some(message);
        }
        let (field, value) = line.split_once(':').unwrap_or((line, ""));
        let value = value.strip_prefix(' ').unwrap_or(value);
        match field {
            "id" => self.current.id = Some(value.to_owned()),
            "event" => value.clone_into(&mut self.current.event),
            "data" => {
                if !self.current.data.is_empty() {
                    self.current.data.push('\n');
                }
                self.current.data.push_str(value);
            }
            _ => {}
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_split_at_any_byte_are_parsed() {
        let text = ": a comment\n\nid: 7\nevent: tile\ndata: {\"frame\":0,\ndata: \"x\":1}\n\nretry: 5\n\nid: 8\r\ndata:x\r\n\r\n";
        let wanted = vec![
            SseMessage { id: Some("7".into()), event: "tile".into(), data: "{\"frame\":0,\n\"x\":1}".into() },
            SseMessage { id: Some("8".into()), event: String::new(), data: "x".into() },
        ];
        for size in 1..text.len() {
            let mut lines = SseParser::default();
            let read: Vec<SseMessage> = text.as_bytes().chunks(size).flat_map(|piece| lines.push(piece)).collect();
            assert_eq!(read, wanted, "in pieces of {size}");
        }
    }

    #[test]
    fn unknown_event_types_are_skipped() {
        assert_eq!(JobEvent::parse("weather", "{}"), None);
        let data = r#"{"state":"failed","errors":["no"],"at":"2026-01-01T00:00:00Z","more":1}"#;
        assert!(
            matches!(JobEvent::parse("state", data), Some(JobEvent::State(event)) if event.state == JobState::Failed)
        );
    }
}
