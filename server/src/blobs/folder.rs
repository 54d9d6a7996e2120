//! A local folder as a store: pictures are fsynced with their folder's entry, blobs are not.
//!
//! Pool workers write into the same folders themselves, by the same rules: a file has its name only when it is complete.

use std::io::{self, Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt;
use std::path::{Path as FolderPath, PathBuf};
use std::time::Duration;

use bytes::Bytes;
use futures_util::stream::{BoxStream, Stream, StreamExt, TryStreamExt};
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{MultipartUpload, ObjectStoreExt, PutPayload};
use proto::worker_protocol::PARTIAL_MARKER;

use super::incoming::{Incoming, Piece};
use super::{ContentError, ContentKind, READ_CHUNK_BYTES, generic_error};
use crate::delivery_check::{FileEnds, HEAD_BYTES, TAIL_BYTES};

/// The folders of pictures and blobs in a data folder.
#[derive(Debug)]
pub(super) struct Folder {
    data: PathBuf,
    durable: LocalFileSystem,
    volatile: LocalFileSystem,
}

impl Folder {
    /// Opens the folders, and removes the partial files of interrupted writes.
    pub(super) fn open(data: &FolderPath) -> io::Result<Self> {
        for kind in ContentKind::ALL {
            std::fs::create_dir_all(kind.path(data))?;
        }
        remove_partial_writes(data, Duration::ZERO)?;
        let open = || LocalFileSystem::new_with_prefix(data).map_err(io::Error::other);
        Ok(Self { data: data.to_owned(), durable: open()?.with_fsync(true), volatile: open()? })
    }

    /// The data folder.
    pub(super) fn data(&self) -> &FolderPath {
        &self.data
    }

    /// Files of a kind.
    pub(super) fn store(&self, kind: ContentKind) -> &LocalFileSystem {
        match kind {
            ContentKind::Picture => &self.durable,
            ContentKind::Blob => &self.volatile,
        }
    }

    /// Stores content at `path`; a file of this name is replaced.
    pub(super) async fn put<S: Stream<Item = io::Result<Bytes>> + Unpin>(
        &self,
        kind: ContentKind,
        path: &Path,
        mut incoming: Incoming<'_, S>,
        failed: impl Fn(object_store::Error) -> ContentError,
    ) -> Result<(), ContentError> {
        let mut upload: Option<Box<dyn MultipartUpload>> = None;
        let written = async {
            loop {
                match (incoming.piece().await?, &mut upload) {
                    (Piece::Part(part), Some(upload)) => upload.put_part(part.into()).await.map_err(&failed)?,
                    (Piece::Part(part), None) => {
                        let begun = self.store(kind).put_multipart(path).await.map_err(&failed)?;
                        upload.insert(begun).put_part(part.into()).await.map_err(&failed)?;
                    }
                    (Piece::Last(rest), None) => {
                        self.store(kind).put(path, PutPayload::from(rest)).await.map_err(&failed)?;
                        return Ok(());
                    }
                    (Piece::Last(rest), Some(upload)) => {
                        if !rest.is_empty() {
                            upload.put_part(rest.into()).await.map_err(&failed)?;
                        }
                        upload.complete().await.map_err(&failed)?;
                        return Ok(());
                    }
                }
            }
        }
        .await;
        if let (Err(_), Some(mut upload)) = (&written, upload)
            && let Err(error) = upload.abort().await
        {
            tracing::warn!(%error, "could not remove a partial file");
        }
        written
    }

    /// Writes and deletes a few bytes, to verify that the folder is writable.
    pub(super) async fn check_writable(&self, probe: &Path) -> object_store::Result<()> {
        self.volatile.put(probe, PutPayload::from_static(b"a probe")).await?;
        self.volatile.delete(probe).await
    }
}

/// Deletes the files of writes that were interrupted at least `age` ago.
pub(super) fn remove_partial_writes(data: &FolderPath, age: Duration) -> io::Result<()> {
    for kind in ContentKind::ALL {
        for entry in std::fs::read_dir(kind.path(data))? {
            let entry = entry?;
            // The writer may finish this file, or another sweep may delete it, at any time.
            let is_old = || Ok::<_, io::Error>(entry.metadata()?.modified()?.elapsed().unwrap_or_default() >= age);
            if entry.file_name().to_string_lossy().contains(PARTIAL_MARKER) && is_old().unwrap_or(false) {
                match std::fs::remove_file(entry.path()) {
                    Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                    _ => {}
                }
            }
        }
    }
    Ok(())
}

/// A file's bytes in chunks of [`READ_CHUNK_BYTES`], each read when the one before was taken: one chunk is in memory.
pub(super) fn chunks(
    file: std::fs::File,
    range: std::ops::Range<u64>,
) -> BoxStream<'static, object_store::Result<Bytes>> {
    futures_util::stream::try_unfold((file, range), async |(file, rest)| {
        let size_bytes = (rest.end - rest.start).min(READ_CHUNK_BYTES);
        if size_bytes == 0 {
            return Ok(None);
        }
        let next = rest.start + size_bytes;
        let read = tokio::task::spawn_blocking(move || {
            let mut chunk = vec![0; size_bytes as usize];
            file.read_exact_at(&mut chunk, rest.start).map(|()| (Bytes::from(chunk), file))
        });
        let (chunk, file) = read.await.map_err(io::Error::other).flatten()?;
        Ok(Some((chunk, (file, next..rest.end))))
    })
    .map_err(generic_error)
    .boxed()
}

/// Size, first and last bytes of a file.
pub(super) async fn ends(file: std::fs::File) -> object_store::Result<FileEnds> {
    let read = tokio::task::spawn_blocking(move || read_ends(file));
    read.await.map_err(io::Error::other).flatten().map_err(generic_error)
}

fn read_ends(mut file: std::fs::File) -> io::Result<FileEnds> {
    let size_bytes = file.metadata()?.len();
    let mut head = Vec::new();
    Read::by_ref(&mut file).take(HEAD_BYTES).read_to_end(&mut head)?;
    file.seek(SeekFrom::Start(size_bytes.saturating_sub(TAIL_BYTES)))?;
    let mut tail = Vec::new();
    Read::by_ref(&mut file).take(TAIL_BYTES).read_to_end(&mut tail)?;
    Ok(FileEnds { size_bytes, head: head.into(), tail: tail.into() })
}
