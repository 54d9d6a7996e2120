//! Saves all pictures of a job: as files in a folder, or as one archive.

use std::path::Path;

use anyhow::Context;
use proto::frame::{FramePage, FrameView};
use proto::{Client, JobId};

use crate::counted::counted_len;
use crate::error::UsageError;
use crate::follow;
use crate::output_file::{OutputFile, check_writable};
use crate::terminal::print_note;

/// Saves each picture in a folder, which is created if missing.
pub(crate) async fn save(client: &Client, id: JobId, folder: &str, partial: bool) -> anyhow::Result<()> {
    if folder == "-" {
        return Err(UsageError("standard output is no folder: give one, or a file that ends in .zip".to_owned()).into());
    }
    let frames = frames(client, id).await?;
    let missing = frames.iter().filter(|frame| frame.image.is_none()).count();
    if missing > 0 && !partial {
        anyhow::bail!(
            "{missing} of the {} of job {id} {} not stored: wait with `sdfarm watch {id}`, \
             or save the others with --partial",
            counted_len(frames.len(), "picture"),
            if missing == 1 { "is" } else { "are" }
        );
    }
    check_writable(&format!("{}/", folder.trim_end_matches('/')))?;
    let mut size_bytes = 0;
    for frame in frames.iter().filter(|frame| frame.image.is_some()) {
        size_bytes += follow::save(client, id, frame.number, &path_in(folder, frame)).await?;
    }
    let stored: Vec<String> = frames.iter().filter(|frame| frame.image.is_some()).map(file_name).collect();
    let names = match &stored[..] {
        [] => String::new(),
        [one] => format!(" ({one})"),
        [first, .., last] => format!(" ({first} to {last})"),
    };
    print_note(&format!("wrote {} to {folder}{names}: {size_bytes} bytes", counted_len(stored.len(), "picture")));
    Ok(())
}

/// Saves one frame's picture in a folder, under the name that it has when all are saved.
pub(crate) async fn save_one(client: &Client, id: JobId, frame: u32, folder: &str) -> anyhow::Result<()> {
    check_writable(&format!("{}/", folder.trim_end_matches('/')))?;
    match frames(client, id).await?.into_iter().find(|view| view.number == frame) {
        Some(view) => follow::fetch(client, id, frame, &path_in(folder, &view)).await,
        // The server's error names the frames that exist.
        None => follow::fetch(client, id, frame, "-").await,
    }
}

fn path_in(folder: &str, frame: &FrameView) -> String {
    Path::new(folder).join(file_name(frame)).to_string_lossy().into_owned()
}

/// Saves all pictures as one archive.
pub(crate) async fn archive(client: &Client, id: JobId, path: &str, partial: bool) -> anyhow::Result<()> {
    let mut output = OutputFile::create(path)?;
    let size_bytes = client
        .archive(id, partial, output.file())
        .await
        .with_context(|| format!("could not fetch the pictures of job {id}"))?;
    output.commit()?;
    print_note(&format!("wrote {path}: {size_bytes} bytes"));
    Ok(())
}

async fn frames(client: &Client, id: JobId) -> anyhow::Result<Vec<FrameView>> {
    let mut frames = Vec::new();
    let mut cursor: Option<String> = None;
    loop {
        let FramePage { frames: page, next_cursor } = client.frames(id, cursor.as_deref()).await?;
        frames.extend(page);
        if next_cursor.is_none() {
            return Ok(frames);
        }
        cursor = next_cursor;
    }
}

/// The server's file name, unless it would leave the folder.
fn file_name(frame: &FrameView) -> String {
    let is_plain = |name: &&String| !name.starts_with('.') && !name.contains(['/', '\\', '\0']);
    frame.file.as_ref().filter(is_plain).cloned().unwrap_or_else(|| format!("frame.{:04}", frame.number))
}
