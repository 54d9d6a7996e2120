//! Content store: pictures and tile blobs, each named by the BLAKE3 of its content.
//!
//! A picture is fsynced before its row is written; a tile blob is not, because losing one costs only a
//! re-render. This module does not interpret the bytes.

use std::io::{self, Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt;
use std::path::{Path as FolderPath, PathBuf};
use std::time::Duration;

mod verified;

use bytes::{Bytes, BytesMut};
use futures_util::stream::{BoxStream, Stream, StreamExt, TryStreamExt};
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{
    GetOptions, GetRange, GetResult, GetResultPayload, ObjectMeta, ObjectStore, ObjectStoreExt, PutPayload,
};
use proto::fail_point::{self, FailPoint};
use proto::worker_protocol::{MAX_BLOB_BYTES, MAX_PICTURE_BYTES, PARTIAL_MARKER};
use tokio::sync::RwLock;

use self::verified::VerifiedFiles;
use crate::delivery_check::{FileEnds, HEAD_BYTES, TAIL_BYTES};

/// Number of bytes written at a time.
pub(crate) const WRITE_CHUNK_BYTES: usize = 256 << 10;
/// Number of bytes read at a time: small enough for thousands of readers that take nothing.
const READ_CHUNK_BYTES: u64 = 32 << 10;
/// Content younger than this is never swept, because workers hold reports back for up to 200 ms.
pub(crate) const MIN_SWEEP_AGE: Duration = Duration::from_secs(1);

/// Kind of content, each in its own folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ContentKind {
    /// A frame's picture.
    Picture,
    /// A tile's pixels.
    Blob,
}

impl ContentKind {
    fn folder(self) -> &'static str {
        match self {
            Self::Picture => "pictures",
            Self::Blob => "tiles",
        }
    }

    /// Folder of this kind in a data folder.
    pub(crate) fn path(self, data: &FolderPath) -> PathBuf {
        data.join(self.folder())
    }

    /// File of this name in a data folder.
    pub(crate) fn file(self, data: &FolderPath, name: &str) -> PathBuf {
        self.path(data).join(name)
    }

    /// Maximum size of a file of this kind.
    pub(crate) fn max_bytes(self) -> u64 {
        match self {
            Self::Picture => MAX_PICTURE_BYTES,
            Self::Blob => MAX_BLOB_BYTES,
        }
    }
}

/// Name of stored content: its BLAKE3, in lower-case hex.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ContentHash(String);

impl ContentHash {
    /// Parses a name; `None` if it is invalid.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let is_digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
        (text.len() == 64 && text.bytes().all(is_digit)).then(|| Self(text.to_owned()))
    }

    /// Name as text.
    pub(crate) fn as_str(&self) -> &str {
        &self.0
    }
}

/// Error when storing or reading bytes.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ContentError {
    /// The disk or the object store failed.
    #[error("the store could not {action} {kind}/{name}")]
    Store {
        /// Attempted action.
        action: &'static str,
        /// Kind of the content.
        kind: &'static str,
        /// Name of the content.
        name: String,
        /// Error of the object store.
        #[source]
        source: object_store::Error,
    },
    /// The bytes do not match the hash in their name.
    #[error("the bytes do not match {expected}: their BLAKE3 is {actual}")]
    Mismatch {
        /// Hash in the given name.
        expected: String,
        /// Hash of the bytes.
        actual: String,
    },
    /// The content is too large.
    #[error("there are more than {limit_bytes} bytes")]
    TooLarge {
        /// Maximum size.
        limit_bytes: u64,
    },
    /// The stream was interrupted.
    #[error("the stream of bytes was interrupted")]
    Broken(#[source] io::Error),
}

impl ContentError {
    /// Whether the disk, or the quota, is full.
    pub(crate) fn is_full(&self) -> bool {
        let Self::Store { source, .. } = self else { return false };
        let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(source);
        while let Some(error) = cause {
            if let Some(error) = error.downcast_ref::<io::Error>() {
                return matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded);
            }
            cause = error.source();
        }
        false
    }
}

/// Condition of a stored file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FileState {
    /// It has its size, and its bytes match their hash.
    Intact,
    /// It is missing.
    Missing,
    /// It has another size or other bytes.
    Damaged,
}

/// The two folders, and the lock that protects content being reported from sweeps.
#[derive(Debug)]
pub(crate) struct ContentStore {
    durable: LocalFileSystem,
    volatile: LocalFileSystem,
    sweep_lock: RwLock<()>,
    verified: VerifiedFiles,
}

impl ContentStore {
    /// Opens the folders in a data folder, and removes the partial files of interrupted writes.
    pub(crate) fn open(data: &FolderPath) -> io::Result<Self> {
        for kind in [ContentKind::Picture, ContentKind::Blob] {
            std::fs::create_dir_all(kind.path(data))?;
        }
        remove_partial_writes(data, Duration::ZERO)?;
        let open = || LocalFileSystem::new_with_prefix(data).map_err(io::Error::other);
        Ok(Self {
            durable: open()?.with_fsync(true),
            volatile: open()?,
            sweep_lock: RwLock::default(),
            verified: VerifiedFiles::default(),
        })
    }

    fn store(&self, kind: ContentKind) -> &LocalFileSystem {
        match kind {
            ContentKind::Picture => &self.durable,
            ContentKind::Blob => &self.volatile,
        }
    }

    /// Prevents sweeps while the guard is held.
    pub(crate) async fn block_sweep(&self) -> impl Drop + '_ {
        self.sweep_lock.read().await
    }

    /// Stores a stream of bytes if they match the hash `name`; otherwise stores nothing.
    pub(crate) async fn put(
        &self,
        kind: ContentKind,
        name: &ContentHash,
        mut bytes: impl Stream<Item = io::Result<Bytes>> + Unpin,
    ) -> Result<(), ContentError> {
        let mut hasher = blake3::Hasher::new();
        let mut part = BytesMut::new();
        let mut size_bytes = 0;
        let mut upload: Option<Box<dyn object_store::MultipartUpload>> = None;
        let taken = async {
            fail_point::trigger(FailPoint::StorePut).map_err(fail_point_error).map_err(failed("write", kind, name))?;
            while let Some(chunk) = bytes.try_next().await.map_err(ContentError::Broken)? {
                size_bytes += chunk.len() as u64;
                if size_bytes > kind.max_bytes() {
                    return Err(ContentError::TooLarge { limit_bytes: kind.max_bytes() });
                }
                hasher.update(&chunk);
                part.extend_from_slice(&chunk);
                if part.len() >= WRITE_CHUNK_BYTES {
                    let full = part.split().freeze();
                    self.write_part(kind, name, &mut upload, full).await?;
                }
            }
            let actual = hasher.finalize().to_hex();
            if actual.as_str() != name.as_str() {
                return Err(ContentError::Mismatch { expected: name.0.clone(), actual: actual.to_string() });
            }
            Ok(())
        }
        .await;
        match (taken, upload) {
            (Ok(()), None) => {
                let payload = PutPayload::from(part.freeze());
                self.store(kind).put(&path(kind, name), payload).await.map_err(failed("write", kind, name))?;
                Ok(())
            }
            (Ok(()), Some(upload)) => finish(kind, name, upload, part.freeze()).await,
            (Err(error), None) => Err(error),
            (Err(error), Some(mut upload)) => {
                if let Err(error) = upload.abort().await {
                    tracing::warn!(%error, "could not remove a partial file");
                }
                Err(error)
            }
        }
    }

    async fn write_part(
        &self,
        kind: ContentKind,
        name: &ContentHash,
        upload: &mut Option<Box<dyn object_store::MultipartUpload>>,
        part: Bytes,
    ) -> Result<(), ContentError> {
        let started = if let Some(started) = upload {
            started
        } else {
            let begun = self.store(kind).put_multipart(&path(kind, name)).await;
            upload.insert(begun.map_err(failed("write", kind, name))?)
        };
        started.put_part(part.into()).await.map_err(failed("write", kind, name))
    }

    /// Size, first and last bytes of stored content; `None` if it is missing.
    pub(crate) async fn ends(&self, kind: ContentKind, name: &ContentHash) -> Result<Option<FileEnds>, ContentError> {
        let found = match self.store(kind).get(&path(kind, name)).await {
            Ok(found) => found,
            Err(object_store::Error::NotFound { .. }) => return Ok(None),
            Err(error) => return Err(failed("read", kind, name)(error)),
        };
        let GetResultPayload::File(file, _) = found.payload else { unreachable!("both stores are folders") };
        let read = tokio::task::spawn_blocking(move || read_ends(file)).await.map_err(io::Error::other).flatten();
        let unreadable = |error: io::Error| object_store::Error::Generic { store: "file", source: error.into() };
        read.map(Some).map_err(unreadable).map_err(failed("read", kind, name))
    }

    /// Stored content, or a range of it, and its total size; `None` if it is missing.
    pub(crate) async fn get(
        &self,
        kind: ContentKind,
        name: &ContentHash,
        range: Option<std::ops::Range<u64>>,
    ) -> Result<Option<(u64, BoxStream<'static, object_store::Result<Bytes>>)>, ContentError> {
        fail_point::trigger(FailPoint::StoreGet).map_err(fail_point_error).map_err(failed("read", kind, name))?;
        let options = GetOptions { range: range.map(GetRange::Bounded), ..GetOptions::default() };
        match self.store(kind).get_opts(&path(kind, name), options).await {
            Ok(found) => Ok(Some((found.range.end - found.range.start, stream(found)))),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(failed("read", kind, name)(error)),
        }
    }

    /// Condition of a file of this recorded size. Its bytes are hashed before its first use, and again when it was
    /// modified; those of a large file while it is used.
    pub(crate) async fn file_state(
        &self,
        kind: ContentKind,
        name: &ContentHash,
        size_bytes: u64,
    ) -> Result<FileState, ContentError> {
        let found = match self.store(kind).get(&path(kind, name)).await {
            Ok(found) => found,
            Err(object_store::Error::NotFound { .. }) => return Ok(FileState::Missing),
            Err(error) => return Err(failed("read", kind, name)(error)),
        };
        if found.meta.size != size_bytes {
            return Ok(FileState::Damaged);
        }
        self.verified.check(name, found).await.map_err(failed("read", kind, name))
    }

    /// Deletes a file if it is not used, however new it is: a result that was about to be reported for the same bytes
    /// is found missing, and rendered again. Returns whether there was one.
    pub(crate) async fn delete_if<E: From<ContentError>, F: Future<Output = Result<bool, E>>>(
        &self,
        kind: ContentKind,
        name: &ContentHash,
        is_unused: impl FnOnce(String) -> F,
    ) -> Result<bool, E> {
        let shut = self.sweep_lock.write().await;
        if !is_unused(name.0.clone()).await? {
            return Ok(false);
        }
        let deleted = self.store(kind).delete(&path(kind, name)).await;
        drop(shut);
        match deleted {
            Ok(()) => Ok(true),
            Err(object_store::Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(failed("remove", kind, name)(error).into()),
        }
    }

    /// Lists the files of a folder.
    pub(crate) fn list(&self, kind: ContentKind) -> BoxStream<'static, object_store::Result<ObjectMeta>> {
        self.store(kind).list(Some(&Path::from(kind.folder()))).boxed()
    }

    /// Deletes those of `names` that `unneeded` still lists while no report can arrive. Returns the number
    /// deleted, and the names that are too recent to delete: the same bytes may have been stored again without
    /// a report yet.
    pub(crate) async fn sweep<E, F>(
        &self,
        kind: ContentKind,
        names: &[String],
        unneeded: impl FnOnce(Vec<String>) -> F,
    ) -> Result<(u64, Vec<String>), E>
    where
        F: Future<Output = Result<Vec<String>, E>>,
    {
        let shut = self.sweep_lock.write().await;
        let (mut count, mut young) = (0, Vec::new());
        for name in unneeded(names.to_vec()).await? {
            let Some(name) = ContentHash::parse(&name) else { continue };
            if self.is_too_new(kind, &name).await {
                young.push(name.0);
                continue;
            }
            fail_point::trigger_infallible(FailPoint::Sweeping);
            match self.store(kind).delete(&path(kind, &name)).await {
                Ok(()) => count += 1,
                Err(object_store::Error::NotFound { .. }) => {}
                Err(error) => tracing::warn!(%error, name = name.as_str(), "could not remove orphaned content"),
            }
        }
        drop(shut);
        Ok((count, young))
    }

    async fn is_too_new(&self, kind: ContentKind, name: &ContentHash) -> bool {
        let Ok(meta) = self.store(kind).head(&path(kind, name)).await else { return false };
        let modified: std::time::SystemTime = meta.last_modified.into();
        modified.elapsed().is_ok_and(|age| age < MIN_SWEEP_AGE)
    }

    /// Writes and deletes a few bytes in the pictures' folder, to verify that it is writable.
    pub(crate) async fn check_writable(&self) -> Result<(), ContentError> {
        let name = ContentHash(blake3::hash(b"a probe").to_hex().to_string());
        let probe = Path::from(format!("probe/{}", name.as_str()));
        let failed = |source| ContentError::Store { action: "write", kind: "probe", name: name.0.clone(), source };
        self.volatile.put(&probe, PutPayload::from_static(b"a probe")).await.map_err(failed)?;
        self.volatile.delete(&probe).await.map_err(failed)
    }
}

/// Deletes the files of writes that were interrupted at least `age` ago.
pub(crate) fn remove_partial_writes(data: &FolderPath, age: Duration) -> io::Result<()> {
    for kind in [ContentKind::Picture, ContentKind::Blob] {
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

async fn finish(
    kind: ContentKind,
    name: &ContentHash,
    mut upload: Box<dyn object_store::MultipartUpload>,
    rest: Bytes,
) -> Result<(), ContentError> {
    if !rest.is_empty() {
        upload.put_part(rest.into()).await.map_err(failed("write", kind, name))?;
    }
    upload.complete().await.map_err(failed("write", kind, name))?;
    Ok(())
}

fn path(kind: ContentKind, name: &ContentHash) -> Path {
    Path::from(format!("{}/{}", kind.folder(), name.as_str()))
}

/// Content in chunks of [`READ_CHUNK_BYTES`], each read when the one before was taken: one chunk is in memory.
fn stream(found: GetResult) -> BoxStream<'static, object_store::Result<Bytes>> {
    let unreadable = |error: io::Error| object_store::Error::Generic { store: "file", source: error.into() };
    match found.payload {
        GetResultPayload::File(file, _) => {
            futures_util::stream::try_unfold((file, found.range), async |(file, rest)| {
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
            .map_err(unreadable)
            .boxed()
        }
        GetResultPayload::Stream(bytes) => bytes,
    }
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

/// Store error caused by a triggered fail point.
fn fail_point_error(struck: fail_point::FailPointError) -> object_store::Error {
    object_store::Error::Generic { store: "file", source: struck.into() }
}

fn failed(
    action: &'static str,
    kind: ContentKind,
    name: &ContentHash,
) -> impl FnOnce(object_store::Error) -> ContentError {
    let name = name.0.clone();
    move |source| ContentError::Store { action, kind: kind.folder(), name, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl ContentStore {
        async fn size_bytes(&self, kind: ContentKind, name: &ContentHash) -> Result<Option<u64>, ContentError> {
            Ok(self.ends(kind, name).await?.map(|ends| ends.size_bytes))
        }
    }

    fn stream(bytes: &'static [u8]) -> impl Stream<Item = io::Result<Bytes>> + Unpin {
        futures_util::stream::iter(bytes.chunks(100_000).map(|chunk| Ok(Bytes::from_static(chunk))))
    }

    fn name(bytes: &[u8]) -> ContentHash {
        ContentHash::parse(blake3::hash(bytes).to_hex().as_str()).expect("a hash is a name")
    }

    #[tokio::test]
    async fn bytes_that_do_not_match_their_name_are_rejected() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let pictures = ContentStore::open(folder.path()).expect("opens");
        for bytes in [b"small".as_slice(), vec![7; 3 * WRITE_CHUNK_BYTES + 5].leak()] {
            let wrong = pictures.put(ContentKind::Picture, &name(b"other"), stream(bytes)).await;
            assert!(matches!(wrong, Err(ContentError::Mismatch { .. })), "{wrong:?}");
            assert_eq!(pictures.size_bytes(ContentKind::Picture, &name(b"other")).await.expect("looks"), None);
            pictures.put(ContentKind::Picture, &name(bytes), stream(bytes)).await.expect("stores");
            let size = pictures.size_bytes(ContentKind::Picture, &name(bytes)).await.expect("looks");
            assert_eq!(size, Some(bytes.len() as u64));
        }
        let files = std::fs::read_dir(folder.path().join("pictures")).expect("lists").count();
        assert_eq!(files, 2, "a rejected write leaves no file");
    }
}
