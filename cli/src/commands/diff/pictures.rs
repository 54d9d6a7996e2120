//! Compares the pictures of two jobs by their keys, without rendering them.

use scene::Job;
use serde::Serialize;

use crate::counted::counted_len;

/// Maximum number of frames of an animation whose pictures are compared.
const MAX_FRAMES: u32 = 1_000;

/// Frames with equal and with different pictures.
#[derive(Debug, Serialize)]
pub(super) struct Pictures {
    /// Number of frames before.
    before: u32,
    /// Number of frames after.
    after: u32,
    /// Number of compared frames: all, or a sample of a long animation.
    compared: usize,
    /// Frames whose pictures differ.
    different: Vec<u32>,
}

impl Pictures {
    /// Compares the frames that both jobs have.
    pub(super) fn compare(before: &Job, after: &Job) -> Self {
        let common = before.frames.count.min(after.frames.count);
        // Of a still scene, all frames differ or none does.
        let is_constant = !before.is_animated() && !after.is_animated();
        let step = if is_constant { common } else { common.div_ceil(MAX_FRAMES) };
        let frames: Vec<u32> = (0..common).step_by(step.max(1) as usize).collect();
        let differs = |frame: &u32| before.cache_key(*frame) != after.cache_key(*frame);
        let different: Vec<u32> = frames.iter().copied().filter(differs).collect();
        let (before, after) = (before.frames.count, after.frames.count);
        if is_constant {
            let different = if different.is_empty() { Vec::new() } else { (0..common).collect() };
            return Self { before, after, compared: common as usize, different };
        }
        Self { before, after, compared: frames.len(), different }
    }

    /// The result in words.
    pub(super) fn words(&self) -> String {
        let Self { before, after, compared, different } = self;
        let pictures = if *before == 1 && *after == 1 { "the picture" } else { "the pictures" };
        let result = match different.len() {
            0 if pictures == "the picture" => "the picture is the same".to_owned(),
            0 => "the pictures are the same".to_owned(),
            count if count == *compared && *compared == 1 => "the picture differs".to_owned(),
            count if count == *compared => "all pictures differ".to_owned(),
            count => {
                let first = different[0];
                format!("{count} of {} differ, frame {first} first", counted_len(*compared, "picture"))
            }
        };
        if before == after { result } else { format!("{result}, but there were {before} frames and are {after}") }
    }
}
