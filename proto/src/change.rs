//! Changes of a job, the preview of a deletion, and a job's frames.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The body of `PATCH /v1/jobs/{id}`: what is left out stays as it is.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JobPatch {
    /// Jobs of higher priority are leased first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -100, max = 100))]
    pub priority: Option<i32>,
}

/// Response to `DELETE /v1/jobs/{id}?dry_run=true`: what would be deleted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DeletePreview {
    /// Pictures that no other job shows.
    pub pictures: u64,
    /// Blobs of finished tiles that no other frame needs.
    pub blobs: u64,
    /// Bytes of those pictures and blobs.
    pub size_bytes: u64,
    /// Rows of the database: the job, its file, frames, tiles and events.
    pub rows: u64,
}

/// Lifecycle of a frame: waiting, open, stitching, then stored or void.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrameState {
    /// Not reached yet.
    Waiting,
    /// Its tiles are rendered.
    Open,
    /// Its picture is being made from its tiles.
    Stitching,
    /// Its picture is stored.
    Stored,
    /// Its job finished before it was stored.
    Void,
}

impl FrameState {
    /// Reads a state as the database spells it.
    pub fn read(name: &str) -> Option<Self> {
        Some(match name {
            "open" => Self::Open,
            "stitching" => Self::Stitching,
            "stored" => Self::Stored,
            "void" => Self::Void,
            _ => return None,
        })
    }
}

/// Frame, as `GET /v1/jobs/{id}/frames` returns it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FrameView {
    /// Its number, from 0.
    pub number: u32,
    /// State.
    pub state: FrameState,
    /// BLAKE3 of its picture's bytes, in hex; null until it is stored.
    pub picture: Option<String>,
    /// Size of its picture; null until it is stored.
    pub size_bytes: Option<u64>,
    /// Its picture's address on this server; null until it is stored.
    pub image: Option<String>,
    /// Suggested file name of its picture; null until it is stored.
    pub file: Option<String>,
}

/// A page of a job's frames, by number.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FramePage {
    /// The frames.
    pub frames: Vec<FrameView>,
    /// `cursor` of the next page; null on the last.
    pub next_cursor: Option<String>,
}
