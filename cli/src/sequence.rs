//! All pictures of a job: as files of a folder, or as one archive.

use std::path::Path;

use anyhow::Context;
use proto::change::{FramePage, FrameView};
use proto::{Client, JobId};

use crate::failure::Misuse;
use crate::follow;
use crate::output_file::OutputFile;
use crate::terminal::note;

/// Saves each picture in a folder, which is created if missing.
pub(crate) async fn save(client: &Client, id: JobId, folder: &str, partial: bool) -> anyhow::Result<()> {
    if folder == "-" {
        return Err(Misuse("standard output is no folder: name one, or a file that ends in .zip".to_owned()).into());
    }
    let frames = frames(client, id).await?;
    let missing = frames.iter().filter(|frame| frame.image.is_none()).count();
    if missing > 0 && !partial {
        anyhow::bail!(
            "{missing} of the {} pictures of job {id} are not stored: wait for them with `sdfarm watch {id}`, \
             or take those that are with --partial",
            frames.len()
        );
    }
    std::fs::create_dir_all(folder).with_context(|| format!("could not make the folder {folder}"))?;
    for frame in frames.iter().filter(|frame| frame.image.is_some()) {
        let path = Path::new(folder).join(file_name(frame));
        follow::fetch(client, id, frame.number, &path.to_string_lossy()).await?;
    }
    Ok(())
}

/// Saves all pictures as one archive.
pub(crate) async fn archive(client: &Client, id: JobId, path: &str, partial: bool) -> anyhow::Result<()> {
    let mut output = OutputFile::create(path)?;
    let size_bytes = client
        .archive(id, partial, output.file())
        .await
        .with_context(|| format!("could not fetch the pictures of job {id}"))?;
    output.commit()?;
    note(&format!("wrote {path}: {size_bytes} bytes"));
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
