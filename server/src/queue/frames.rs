//! Frames of a job: the state and picture of each.

pub(super) mod makers;
pub(super) mod open;
pub(super) mod picture;
pub(super) mod previews;
pub(super) mod stitch;

use crate::db;
use db::Row;
use proto::JobId;
use proto::frame::{FrameState, FrameView};

use crate::queue::{Queue, Result, parse_column};

/// All frames of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct FrameSet {
    /// The job's number.
    pub(crate) job: i64,
    /// The job's name.
    pub(crate) name: String,
    /// Media type of the pictures.
    pub(crate) media_type: String,
    /// Number of frames.
    pub(crate) total: u32,
    /// Number of stored pictures.
    pub(crate) stored: u32,
}

impl FrameSet {
    /// File name of a frame's picture, valid on every file system.
    pub(crate) fn file_name(&self, frame: u32) -> String {
        let extension = if self.media_type == "image/x-exr" { "exr" } else { "png" };
        format!("{}.{frame:04}.{extension}", self.file_stem())
    }

    /// The job's name, reduced to characters for a file name.
    pub(crate) fn file_stem(&self) -> String {
        const MAX_CHARACTERS: usize = 100;
        let is_plain = |character: char| character.is_ascii_alphanumeric() || "-_.".contains(character);
        let plain: String = self
            .name
            .trim_start_matches('.')
            .chars()
            .take(MAX_CHARACTERS)
            .map(|character| if is_plain(character) { character } else { '_' })
            .collect();
        if plain.is_empty() { "untitled".to_owned() } else { plain }
    }
}

/// A frame whose picture is stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct StoredFrame {
    /// Number of the frame.
    pub(crate) number: u32,
    /// BLAKE3 of its picture's bytes, in hex.
    pub(crate) picture: String,
    /// Size of its picture.
    pub(crate) size_bytes: u64,
}

impl Queue {
    /// Lists all frames of a job.
    pub(crate) async fn frames(&self, id: JobId) -> Result<Option<FrameSet>> {
        let row = db::query("SELECT number, name, media_type, frames_total, frames_stored FROM job WHERE id = ?")
            .bind(id.to_string())
            .fetch_optional(self.readers())
            .await?;
        row.map(|row| {
            Ok(FrameSet {
                job: row.get("number")?,
                name: row.get("name")?,
                media_type: row.get("media_type")?,
                total: row.get("frames_total")?,
                stored: row.get("frames_stored")?,
            })
        })
        .transpose()
    }

    /// Frames of a job from the given number on; frames that have not been opened have no row.
    pub(crate) async fn frame_page(
        &self,
        id: JobId,
        frames: &FrameSet,
        from: u32,
        limit: u32,
    ) -> Result<Vec<FrameView>> {
        let end = from.saturating_add(limit).min(frames.total);
        let rows = db::query(
            "SELECT number, state, picture, size_bytes FROM frame
             WHERE job = ? AND number >= ? AND number < ? ORDER BY number",
        )
        .bind(frames.job)
        .bind(from)
        .bind(end)
        .fetch_all(self.readers())
        .await?;
        let mut views = Vec::with_capacity((end.saturating_sub(from)) as usize);
        let mut rows = rows.iter().peekable();
        for number in from..end {
            let row = match rows.peek() {
                Some(row) if row.get::<u32>("number")? == number => rows.next(),
                Some(_) | None => None,
            };
            views.push(view(id, frames, number, row)?);
        }
        Ok(views)
    }

    /// Next stored frames of a job.
    pub(crate) async fn stored_frames(&self, job: i64, from: u32, limit: u32) -> Result<Vec<StoredFrame>> {
        let rows = db::query(
            "SELECT number, picture, size_bytes FROM frame
             WHERE job = ? AND number >= ? AND state = 'stored' ORDER BY number LIMIT ?",
        )
        .bind(job)
        .bind(from)
        .bind(limit)
        .fetch_all(self.readers())
        .await?;
        rows.iter()
            .map(|row| {
                Ok(StoredFrame {
                    number: row.get("number")?,
                    picture: row.get("picture")?,
                    size_bytes: row.get("size_bytes")?,
                })
            })
            .collect()
    }
}

fn view(id: JobId, frames: &FrameSet, number: u32, row: Option<&Row>) -> Result<FrameView> {
    let Some(row) = row else {
        let state = FrameState::Waiting;
        return Ok(FrameView { number, state, picture: None, size_bytes: None, image: None, file: None });
    };
    let name: String = row.get("state")?;
    let state = parse_column("frame.state", &name, FrameState::parse)?;
    let is_stored = state == FrameState::Stored;
    Ok(FrameView {
        number,
        state,
        picture: row.get("picture")?,
        size_bytes: row.get("size_bytes")?,
        image: is_stored.then(|| format!("/v1/jobs/{id}/frames/{number}/image")),
        file: is_stored.then(|| frames.file_name(number)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_are_valid_on_every_file_system() {
        let named = |name: &str| {
            let frames =
                FrameSet { job: 1, name: name.to_owned(), media_type: "image/png".to_owned(), total: 1, stored: 1 };
            frames.file_name(7)
        };
        assert_eq!(named("csg"), "csg.0007.png");
        assert_eq!(named("../../etc/passwd"), "_.._etc_passwd.0007.png");
        assert_eq!(named("Fjörd & co"), "Fj_rd___co.0007.png");
        assert_eq!(named(".."), "untitled.0007.png");
        assert_eq!(named(&"x".repeat(500)).len(), 100 + ".0007.png".len());
    }
}
