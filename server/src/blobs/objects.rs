//! An object store: an S3 bucket, or memory in tests. Objects are written once and never changed.
//!
//! **Writing.** Content is received completely, into memory or an unnamed file, and compared with its hash before a
//! byte of it is sent on. It is created only if it is absent (`If-None-Match: *`; a request of S3 also carries the
//! SHA-256 of its payload, which the store compares). If an object of the name exists, it is read: one with the right
//! bytes is what was asked for, unless it is old enough to be swept before it is reported; any other is overwritten with
//! the right bytes. A large object is sent in parts, which S3 cannot complete conditionally through this client: it is
//! looked for first, and if two servers store it at once, the second replaces it with the same bytes.
//!
//! **Reports.** The ends of what this server stored are remembered until its object may be swept, so that a worker's
//! report, and with it the renewal of its leases, does not wait for the store.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path as FolderPath, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use futures_util::stream::{Stream, TryStreamExt};
use object_store::aws::AmazonS3;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    GetResult, ObjectMeta, ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload, WriteMultipart,
};
use tokio::sync::Semaphore;
use tokio::time::Instant;

use super::incoming::{Incoming, Piece};
use super::{ContentError, ContentHash, error, generic_error};
use crate::clock::monotonic_now;
use crate::delivery_check::{FileEnds, HEAD_BYTES, TAIL_BYTES};

/// Size above which an object is sent in parts of this size; all but the last part of an upload to S3 need 5 MiB.
const PART_BYTES: u64 = 8 << 20;
/// Parts of an upload that are in memory.
const MAX_PARTS_IN_MEMORY: usize = 4;
/// Maximum number of objects whose ends are remembered, up to 16 KiB each; then all are forgotten, and read again.
const MAX_REMEMBERED: usize = 1024;
/// Size from which an object that should have few bytes is not read further.
const MAX_SMALL_BYTES: usize = 4096;
/// Maximum number of uploads to the store at a time: with [`MAX_PARTS_IN_MEMORY`] they take 256 MiB at most.
const MAX_UPLOADS: usize = 8;

/// The two kinds of object stores.
#[derive(Clone, Debug)]
pub(super) enum Bucket {
    /// A bucket of an S3 store.
    S3(AmazonS3),
    /// Memory.
    Memory(Arc<InMemory>),
}

/// Ends of objects that this server has stored, and when.
#[derive(Debug, Default)]
struct Remembered {
    ends: HashMap<Path, (Instant, FileEnds)>,
    /// Number of deletions.
    deletions: u64,
}

/// Whether what is remembered of an object may answer for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Memory {
    /// It may, unless the object may have been swept since.
    Trusted,
    /// The store is asked.
    Unused,
}

/// Objects below a prefix.
#[derive(Debug)]
pub(super) struct Objects {
    bucket: Bucket,
    /// Folder in which content is received.
    spool: PathBuf,
    uploads: Semaphore,
    remembered: Mutex<Remembered>,
    /// Age from which an object that is stored again is written again, so that no sweep deletes it.
    refresh_age: Duration,
}

impl Objects {
    /// Objects that no sweep deletes before they have this age.
    pub(super) fn new(bucket: Bucket, spool: &FolderPath, min_sweep_age: Duration) -> Self {
        let uploads = Semaphore::new(MAX_UPLOADS);
        let remembered = Mutex::default();
        Self { bucket, spool: spool.to_owned(), uploads, remembered, refresh_age: min_sweep_age / 2 }
    }

    /// The object store.
    pub(super) fn store(&self) -> &dyn ObjectStore {
        match &self.bucket {
            Bucket::S3(bucket) => bucket,
            Bucket::Memory(memory) => memory.as_ref(),
        }
    }

    /// The bucket, if it is one of S3.
    pub(super) fn s3(&self) -> Option<&AmazonS3> {
        match &self.bucket {
            Bucket::S3(bucket) => Some(bucket),
            Bucket::Memory(_) => None,
        }
    }

    /// Stores content at `path`. Returns the version of the object, whose bytes are known to be right.
    pub(super) async fn put<S: Stream<Item = io::Result<Bytes>> + Unpin>(
        &self,
        name: &ContentHash,
        path: &Path,
        incoming: Incoming<'_, S>,
        failed: impl Fn(object_store::Error) -> ContentError,
    ) -> Result<Option<String>, ContentError> {
        let received = self.receive(incoming, &failed).await?;
        let ends = received.ends().await.map_err(&failed)?;
        // Only uploads are counted, not clients that are still sending: a slow one keeps no other waiting.
        let _upload = self.uploads.acquire().await.expect("never closed");
        let deletions_before = self.remembered().deletions;
        let sent = if received.size_bytes() <= PART_BYTES {
            self.put_whole(name, path, received).await
        } else {
            self.put_parts(name, path, received).await
        };
        let version = sent.map_err(failed)?;
        let mut remembered = self.remembered();
        if remembered.ends.len() >= MAX_REMEMBERED {
            remembered.ends.clear();
        }
        // A deletion in the meantime may have been that of this object.
        if remembered.deletions == deletions_before {
            remembered.ends.insert(path.clone(), (monotonic_now(), ends));
        }
        Ok(version)
    }

    /// Deletes an object, whether or not there is one.
    pub(super) async fn delete(&self, path: &Path) -> object_store::Result<()> {
        let deleted = self.store().delete(path).await;
        // Also if it failed, because the store may have deleted it.
        let mut remembered = self.remembered();
        remembered.deletions += 1;
        remembered.ends.remove(path);
        deleted
    }

    fn remembered(&self) -> MutexGuard<'_, Remembered> {
        self.remembered.lock().expect("no holder panics")
    }

    async fn receive<S: Stream<Item = io::Result<Bytes>> + Unpin>(
        &self,
        mut incoming: Incoming<'_, S>,
        failed: impl Fn(object_store::Error) -> ContentError,
    ) -> Result<Received, ContentError> {
        let mut part = match incoming.piece().await? {
            Piece::Last(all) => return Ok(Received::Memory(all)),
            Piece::Part(part) => part,
        };
        let unwritable = |error| failed(generic_error(error));
        let spool = self.spool.clone();
        let mut file = blocking(move || tempfile::tempfile_in(spool)).await.map_err(unwritable)?;
        let mut size_bytes = 0;
        loop {
            size_bytes += part.len() as u64;
            let written = blocking(move || file.write_all(&part).map(|()| file));
            file = written.await.map_err(unwritable)?;
            part = match incoming.piece().await? {
                Piece::Part(next) => next,
                Piece::Last(rest) if rest.is_empty() => break,
                Piece::Last(rest) => {
                    size_bytes += rest.len() as u64;
                    let written = blocking(move || file.write_all(&rest).map(|()| file));
                    file = written.await.map_err(unwritable)?;
                    break;
                }
            };
        }
        Ok(Received::File(Arc::new(file), size_bytes))
    }

    async fn put_whole(
        &self,
        name: &ContentHash,
        path: &Path,
        received: Received,
    ) -> object_store::Result<Option<String>> {
        let size_bytes = received.size_bytes();
        let payload = PutPayload::from(received.read(0, size_bytes).await?);
        match self.store().put_opts(path, payload.clone(), PutOptions::from(PutMode::Create)).await {
            Ok(done) => Ok(done.e_tag),
            Err(object_store::Error::AlreadyExists { .. }) => match self.existing(name, path, size_bytes).await? {
                Some(version) => Ok(version),
                None => Ok(self.store().put(path, payload).await?.e_tag),
            },
            Err(error) => Err(error),
        }
    }

    async fn put_parts(
        &self,
        name: &ContentHash,
        path: &Path,
        received: Received,
    ) -> object_store::Result<Option<String>> {
        let size_bytes = received.size_bytes();
        if let Some(version) = self.existing(name, path, size_bytes).await? {
            return Ok(version);
        }
        let mut upload =
            WriteMultipart::new_with_chunk_size(self.store().put_multipart(path).await?, PART_BYTES as usize);
        let mut sent_bytes = 0;
        while sent_bytes < size_bytes {
            let part_bytes = PART_BYTES.min(size_bytes - sent_bytes);
            let ready = async {
                upload.wait_for_capacity(MAX_PARTS_IN_MEMORY - 1).await?;
                received.read(sent_bytes, part_bytes).await
            };
            match ready.await {
                Ok(part) => upload.put(part),
                Err(error) => {
                    if let Err(error) = upload.abort().await {
                        tracing::warn!(%error, %path, "could not remove the parts of an upload");
                    }
                    return Err(error);
                }
            }
            sent_bytes += part_bytes;
        }
        Ok(upload.finish().await?.e_tag)
    }

    /// Version of the object of this name if it need not be written again.
    async fn existing(
        &self,
        name: &ContentHash,
        path: &Path,
        size_bytes: u64,
    ) -> object_store::Result<Option<Option<String>>> {
        let found = match self.store().get(path).await {
            Ok(found) => found,
            Err(error) if error::is_missing(&error) => return Ok(None),
            Err(error) => return Err(error),
        };
        if found.meta.size != size_bytes || age(&found.meta) >= self.refresh_age {
            return Ok(None);
        }
        let version = found.meta.e_tag.clone();
        Ok((hash(found).await? == name.as_str()).then_some(version))
    }

    /// Size, first and last bytes of an object.
    pub(super) async fn ends(&self, path: &Path, memory: Memory) -> object_store::Result<FileEnds> {
        let remembered = match memory {
            Memory::Trusted => self.remembered().ends.get(path).cloned(),
            Memory::Unused => None,
        };
        if let Some((_, ends)) = remembered.filter(|(stored, _)| stored.elapsed() < self.refresh_age) {
            return Ok(ends);
        }
        let size_bytes = self.store().head(path).await?.size;
        if size_bytes == 0 {
            return Ok(FileEnds { size_bytes, head: Bytes::new(), tail: Bytes::new() });
        }
        if size_bytes <= HEAD_BYTES {
            let head = self.store().get_range(path, 0..size_bytes).await?;
            let tail = head.slice(head.len().saturating_sub(TAIL_BYTES as usize)..);
            return Ok(FileEnds { size_bytes, head, tail });
        }
        let tail_bytes = size_bytes.saturating_sub(TAIL_BYTES)..size_bytes;
        let (head, tail) =
            tokio::try_join!(self.store().get_range(path, 0..HEAD_BYTES), self.store().get_range(path, tail_bytes))?;
        Ok(FileEnds { size_bytes, head, tail })
    }
}

/// Content that was received and matches its name.
#[derive(Debug)]
enum Received {
    Memory(Bytes),
    /// An unnamed file and its size.
    File(Arc<File>, u64),
}

impl Received {
    fn size_bytes(&self) -> u64 {
        match self {
            Self::Memory(bytes) => bytes.len() as u64,
            Self::File(_, size_bytes) => *size_bytes,
        }
    }

    async fn ends(&self) -> object_store::Result<FileEnds> {
        let size_bytes = self.size_bytes();
        let tail_bytes = size_bytes.min(TAIL_BYTES);
        let head = self.read(0, size_bytes.min(HEAD_BYTES)).await?;
        let tail = self.read(size_bytes - tail_bytes, tail_bytes).await?;
        // Copied, so that the content itself is not kept.
        Ok(FileEnds { size_bytes, head: Bytes::copy_from_slice(&head), tail: Bytes::copy_from_slice(&tail) })
    }

    async fn read(&self, offset: u64, size_bytes: u64) -> object_store::Result<Bytes> {
        match self {
            Self::Memory(bytes) => Ok(bytes.slice(offset as usize..(offset + size_bytes) as usize)),
            Self::File(file, _) => {
                let file = Arc::clone(file);
                let read = blocking(move || {
                    let mut part = vec![0; size_bytes as usize];
                    file.read_exact_at(&mut part, offset).map(|()| part.into())
                });
                read.await.map_err(generic_error)
            }
        }
    }
}

/// BLAKE3 of an object's bytes, in hex.
pub(super) async fn hash(found: GetResult) -> object_store::Result<String> {
    let mut hasher = blake3::Hasher::new();
    let mut bytes = found.into_stream();
    while let Some(chunk) = bytes.try_next().await? {
        hasher.update(&chunk);
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// The first bytes of an object that has few; all that is claimed to be there is not made room for.
pub(super) async fn small(found: GetResult) -> object_store::Result<Vec<u8>> {
    let (mut all, mut bytes) = (Vec::new(), found.into_stream());
    while let Some(chunk) = bytes.try_next().await? {
        all.extend_from_slice(&chunk);
        if all.len() > MAX_SMALL_BYTES {
            break;
        }
    }
    Ok(all)
}

/// Time since an object was written, by this machine's clock; none if that is in the future.
pub(crate) fn age(meta: &ObjectMeta) -> Duration {
    let modified: SystemTime = meta.last_modified.into();
    modified.elapsed().unwrap_or_default()
}

async fn blocking<T: Send + 'static>(work: impl FnOnce() -> io::Result<T> + Send + 'static) -> io::Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(io::Error::other).flatten()
}
