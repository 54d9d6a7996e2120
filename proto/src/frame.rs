//! A job's frames, as the HTTP API returns them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Lifecycle of a frame: waiting, open, stitching, then stored or void.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrameState {
    /// Its tiles have not been created.
    Waiting,
    /// Its tiles have been created and are being rendered.
    Open,
    /// Its picture is being stitched.
    Stitching,
    /// Its picture is stored.
    Stored,
    /// Its job finished before it was stored.
    Void,
}

impl FrameState {
    /// Reads a state as the database spells it.
    pub fn parse(name: &str) -> Option<Self> {
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
    /// Number of the frame, from 0.
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

/// A picture that was forgotten, as `DELETE /v1/pictures/{hash}` returns it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ForgottenPicture {
    /// BLAKE3 of its bytes, in hex.
    pub picture: String,
    /// Number of frames that showed it and are rendered again.
    pub frames_rendered_again: u64,
    /// Number of frames of failed or cancelled jobs that showed it and have no picture now.
    pub frames_without_picture: u64,
}
