//! Content store: pictures and tile blobs, each named by the BLAKE3 of its content, in a local folder, a bucket of an S3
//! store, or memory.
//!
//! A picture is durable before its row is written: a file is fsynced, and S3 promises it with its answer. A tile blob in
//! a folder is not, because losing one costs only a re-render. Bytes are compared with their name before they are
//! stored, and again before they are first served (`blobs/verified.rs`). This module does not interpret the bytes.

mod bounded_answers;
mod bucket;
mod claim;
mod content;
mod error;
mod folder;
mod incoming;
mod local_copies;
mod location;
mod objects;
mod sweep;
mod verified;

use std::future::ready;
use std::io;
use std::path::Path as FolderPath;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures_util::stream::{BoxStream, Stream, StreamExt, TryStreamExt};
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::signer::{SignedUrlOptions, Signer};
use object_store::{GetOptions, GetRange, GetResult, GetResultPayload, ObjectMeta, ObjectStore, ObjectStoreExt};
use proto::fail_point::{self, FailPoint};
use reqwest::Method;
use tokio::sync::RwLock;

pub use bucket::BucketError;
pub use claim::ClaimError;
pub(crate) use content::{ContentHash, ContentKind};
pub(crate) use error::{ContentError, OpenStoreError};
pub(crate) use local_copies::LocalCopies;
pub use location::{ParseStoreError, StoreLocation};
pub(crate) use objects::age;
pub(crate) use sweep::Swept;

use self::bucket::Settings;
use self::error::BucketFault;
use self::folder::Folder;
use self::incoming::Incoming;
use self::objects::{Bucket, Memory, Objects};
use self::verified::VerifiedContent;
use crate::delivery_check::FileEnds;

/// Number of bytes written at a time.
pub(crate) const WRITE_CHUNK_BYTES: usize = 256 << 10;
/// Number of bytes of a file read at a time: small enough for thousands of readers that take nothing.
const READ_CHUNK_BYTES: u64 = 32 << 10;
/// Files younger than this are never swept, because workers hold reports back for up to 200 ms.
const MIN_FILE_SWEEP_AGE: Duration = Duration::from_secs(1);
/// Minimum age at which files that no row ever referred to are swept.
const FILE_ORPHAN_AGE: Duration = Duration::from_mins(10);
/// Objects younger than this are never swept: the store's clock is another, and so may be the server that reports them.
const MIN_OBJECT_SWEEP_AGE: Duration = Duration::from_mins(15);
/// Time in which a bucket must answer that the server is ready.
const READY_TIMEOUT: Duration = Duration::from_secs(5);
/// Validity of a presigned address.
const PRESIGNED_VALIDITY: Duration = Duration::from_mins(5);

/// Condition of stored content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FileState {
    /// It has its size, and its bytes match their hash.
    Intact,
    /// It is missing.
    Missing,
    /// It has another size or other bytes.
    Damaged,
}

/// A kind of store. Memory is a kind of [`Objects`].
#[derive(Debug)]
enum Backend {
    Folder(Folder),
    Objects(Objects),
}

/// Minimum ages at which content is deleted.
#[derive(Clone, Copy, Debug)]
struct SweepAges {
    /// Content that a deleted row referred to.
    unused: Duration,
    /// Content found in the store that no row refers to.
    orphan: Duration,
}

/// Pictures and blobs, and the lock that protects content being reported from sweeps.
#[derive(Debug)]
pub(crate) struct BlobStore {
    location: StoreLocation,
    backend: Backend,
    ages: SweepAges,
    sweep_lock: RwLock<()>,
    verified: VerifiedContent,
}

impl BlobStore {
    /// Opens a farm's store and checks that it can be used. A folder's partial files of interrupted writes are removed.
    pub(crate) async fn open(
        location: &StoreLocation,
        data: &FolderPath,
        object_sweep_age: Option<Duration>,
    ) -> Result<Self, OpenStoreError> {
        let store = Self::open_unchecked(location, data, object_sweep_age)?;
        store.check().await?;
        Ok(store)
    }

    /// Checks that a bucket can be used as a store: what it refuses, and what it cannot do, is an error with its fix.
    pub(crate) async fn check(&self) -> Result<(), BucketError> {
        match &self.location {
            StoreLocation::S3 { bucket, .. } => Settings::from_env(&self.location, bucket).check().await,
            StoreLocation::Folder | StoreLocation::Memory => Ok(()),
        }
    }

    /// Opens a farm's store.
    pub(crate) fn open_unchecked(
        location: &StoreLocation,
        data: &FolderPath,
        object_sweep_age: Option<Duration>,
    ) -> Result<Self, OpenStoreError> {
        let bucket = match location {
            StoreLocation::Folder => {
                let ages = SweepAges { unused: MIN_FILE_SWEEP_AGE, orphan: FILE_ORPHAN_AGE };
                return Ok(Self::new(location, Backend::Folder(Folder::open(data)?), ages));
            }
            StoreLocation::S3 { bucket, .. } => Bucket::S3(Settings::from_env(location, bucket).open()?),
            StoreLocation::Memory => Bucket::Memory(Arc::new(InMemory::new())),
        };
        Ok(Self::with_bucket(location, bucket, data, object_sweep_age.unwrap_or(MIN_OBJECT_SWEEP_AGE)))
    }

    fn with_bucket(location: &StoreLocation, bucket: Bucket, spool: &FolderPath, age: Duration) -> Self {
        let objects = Objects::new(bucket, spool, age);
        Self::new(location, Backend::Objects(objects), SweepAges { unused: age, orphan: age })
    }

    /// Servers' handles of one store in memory, which delete any content, however new it is, and yet rely on what they have
    /// stored, as if it were new.
    #[cfg(test)]
    pub(crate) fn in_memory(servers: usize, spool: &FolderPath) -> Vec<Self> {
        let bucket = Bucket::Memory(Arc::new(InMemory::new()));
        let open = |_| {
            let objects = Objects::new(bucket.clone(), spool, MIN_OBJECT_SWEEP_AGE);
            let ages = SweepAges { unused: Duration::ZERO, orphan: Duration::ZERO };
            Self::new(&StoreLocation::Memory, Backend::Objects(objects), ages)
        };
        (0..servers).map(open).collect()
    }

    fn new(location: &StoreLocation, backend: Backend, ages: SweepAges) -> Self {
        Self {
            location: location.clone(),
            backend,
            ages,
            sweep_lock: RwLock::default(),
            verified: VerifiedContent::default(),
        }
    }

    /// Where it is.
    pub(crate) fn location(&self) -> &StoreLocation {
        &self.location
    }

    /// The data folder whose folders pool workers write to directly; `None` if they send everything to the server.
    pub(crate) fn folder(&self) -> Option<&FolderPath> {
        match &self.backend {
            Backend::Folder(folder) => Some(folder.data()),
            Backend::Objects(_) => None,
        }
    }

    /// Delay after which content that was too recent to be swept should be tried again; `None` if that is too long to
    /// remember it.
    pub(crate) fn sweep_retry_delay(&self) -> Option<Duration> {
        self.folder().map(|_| self.ages.unused)
    }

    /// Whether servers of other machines may use it.
    pub(crate) fn is_shared(&self) -> bool {
        matches!(self.backend, Backend::Objects(_))
    }

    /// Time for which content that no row refers to is kept.
    pub(crate) fn grace(&self) -> Duration {
        self.ages.unused
    }

    /// Age from which content is swept that no row refers to.
    pub(crate) fn orphan_age(&self) -> Duration {
        self.ages.orphan
    }

    fn store(&self, kind: ContentKind) -> &dyn ObjectStore {
        match &self.backend {
            Backend::Folder(folder) => folder.store(kind),
            Backend::Objects(objects) => objects.store(),
        }
    }

    fn path(&self, kind: ContentKind, name: &ContentHash) -> Path {
        self.location.prefix().join(kind.folder()).join(name.as_str())
    }

    fn failed(&self, action: &'static str, key: &str) -> impl Fn(object_store::Error) -> ContentError + use<> {
        let (attempt, is_bucket) = match &self.backend {
            Backend::Folder(_) => (format!("the store could not {action} {key}"), false),
            Backend::Objects(_) => (format!("the store {} could not {action} {key}", self.location), true),
        };
        move |source| {
            let cure = is_bucket.then(|| BucketFault::of(&source).cure());
            ContentError::Store { attempt: attempt.clone(), cure, source: source.into() }
        }
    }

    fn failed_on(
        &self,
        action: &'static str,
        kind: ContentKind,
        name: &ContentHash,
    ) -> impl Fn(object_store::Error) -> ContentError + use<> {
        self.failed(action, &format!("{}/{}", kind.folder(), name.as_str()))
    }

    /// Prevents sweeps while the guard is held.
    pub(crate) async fn block_sweep(&self) -> impl Drop + '_ {
        self.sweep_lock.read().await
    }

    /// Stores a stream of at most `max_bytes` if they match the hash `name`; otherwise stores nothing. To store what is stored
    /// already is a success.
    pub(crate) async fn put(
        &self,
        kind: ContentKind,
        name: &ContentHash,
        bytes: impl Stream<Item = io::Result<Bytes>> + Unpin,
        max_bytes: u64,
    ) -> Result<(), ContentError> {
        let failed = self.failed_on("write", kind, name);
        fail_point::trigger(FailPoint::StorePut).map_err(fail_point_error).map_err(&failed)?;
        let (incoming, path) = (Incoming::new(kind, name, bytes, max_bytes), self.path(kind, name));
        match &self.backend {
            Backend::Folder(folder) => folder.put(kind, &path, incoming, failed).await,
            Backend::Objects(objects) => {
                let version = objects.put(name, &path, incoming, failed).await?;
                self.verified.insert(name, version);
                Ok(())
            }
        }
    }

    /// Size, first and last bytes of stored content; `None` if it is missing.
    pub(crate) async fn ends(&self, kind: ContentKind, name: &ContentHash) -> Result<Option<FileEnds>, ContentError> {
        self.ends_of(kind, name, Memory::Trusted).await
    }

    /// Like [`BlobStore::ends`], and nothing is remembered.
    pub(crate) async fn ends_now(
        &self,
        kind: ContentKind,
        name: &ContentHash,
    ) -> Result<Option<FileEnds>, ContentError> {
        self.ends_of(kind, name, Memory::Unused).await
    }

    async fn ends_of(
        &self,
        kind: ContentKind,
        name: &ContentHash,
        memory: Memory,
    ) -> Result<Option<FileEnds>, ContentError> {
        let path = self.path(kind, name);
        let read = match &self.backend {
            Backend::Folder(folder) => match folder.store(kind).get(&path).await {
                Ok(GetResult { payload: GetResultPayload::File(file, _), .. }) => folder::ends(file).await,
                Ok(_) => unreachable!("a folder has files"),
                Err(error) => Err(error),
            },
            Backend::Objects(objects) => objects.ends(&path, memory).await,
        };
        unless_missing(read).map_err(self.failed_on("read", kind, name))
    }

    /// Stored content, or a range of it, and the number of its bytes; `None` if it is missing. If all of it turns out to be
    /// other bytes than its name says, an error comes in place of the last of them.
    pub(crate) async fn get(
        &self,
        kind: ContentKind,
        name: &ContentHash,
        range: Option<std::ops::Range<u64>>,
    ) -> Result<Option<(u64, BoxStream<'static, object_store::Result<Bytes>>)>, ContentError> {
        let failed = self.failed_on("read", kind, name);
        fail_point::trigger(FailPoint::StoreGet).map_err(fail_point_error).map_err(&failed)?;
        let is_all = range.is_none();
        let options = GetOptions { range: range.map(GetRange::Bounded), ..GetOptions::default() };
        let found = unless_missing(self.store(kind).get_opts(&self.path(kind, name), options).await).map_err(failed)?;
        let read = |found: GetResult| {
            let (size_bytes, version) = (found.range.end - found.range.start, verified::version(&found));
            let bytes = stream(found);
            (size_bytes, if is_all { self.verified.while_read(name.clone(), version, bytes) } else { bytes })
        };
        Ok(found.map(read))
    }

    /// Address from which any client can read content for five minutes; `None` unless the store is a bucket of S3.
    pub(crate) async fn presigned(
        &self,
        kind: ContentKind,
        name: &ContentHash,
        media_type: &str,
    ) -> Result<Option<String>, ContentError> {
        let Backend::Objects(objects) = &self.backend else { return Ok(None) };
        let Some(bucket) = objects.s3() else { return Ok(None) };
        let options = SignedUrlOptions::default().with_query([("response-content-type", media_type)]);
        let signed = bucket.signed_url_opts(Method::GET, &self.path(kind, name), PRESIGNED_VALIDITY, &options).await;
        Ok(Some(signed.map_err(self.failed_on("sign", kind, name))?.into()))
    }

    /// Condition of content of this recorded size. Its bytes are hashed before its first use, and again when it was
    /// modified; large content's while it is used.
    pub(crate) async fn file_state(
        &self,
        kind: ContentKind,
        name: &ContentHash,
        size_bytes: u64,
    ) -> Result<FileState, ContentError> {
        let failed = self.failed_on("read", kind, name);
        let found = self.store(kind).get(&self.path(kind, name)).await;
        match unless_missing(found).map_err(&failed)? {
            None => Ok(FileState::Missing),
            Some(found) if found.meta.size != size_bytes => Ok(FileState::Damaged),
            Some(found) => self.verified.check(name, found).await.map_err(failed),
        }
    }

    /// Lists the content of a kind. Whatever has another name, or a size that no content has, is not the farm's.
    pub(crate) fn list(
        &self,
        kind: ContentKind,
    ) -> BoxStream<'static, object_store::Result<(ContentHash, ObjectMeta)>> {
        let listed = self.store(kind).list(Some(&self.location.prefix().join(kind.folder())));
        let ours = listed.try_filter_map(move |meta| {
            let name = meta.location.filename().and_then(ContentHash::parse);
            ready(Ok(name.filter(|_| meta.size <= kind.max_bytes()).map(|name| (name, meta))))
        });
        ours.boxed()
    }

    /// Error of [`BlobStore::list`], with its fix.
    pub(crate) fn list_error(&self, kind: ContentKind, error: object_store::Error) -> ContentError {
        self.failed("list", &format!("{}/", kind.folder()))(error)
    }

    /// BLAKE3 of stored content, in hex; `None` if it is missing.
    pub(crate) async fn hash(&self, kind: ContentKind, name: &ContentHash) -> Result<Option<String>, ContentError> {
        let failed = self.failed_on("read", kind, name);
        let found = self.store(kind).get(&self.path(kind, name)).await;
        match unless_missing(found).map_err(&failed)? {
            Some(found) => Ok(Some(objects::hash(found).await.map_err(failed)?)),
            None => Ok(None),
        }
    }

    /// Total size of the content of a kind.
    pub(crate) async fn size_bytes(&self, kind: ContentKind) -> Result<u64, ContentError> {
        let mut content = self.list(kind);
        let mut sum_bytes = 0_u64;
        while let Some(listed) = content.next().await {
            let (_, meta) = listed.map_err(|error| self.list_error(kind, error))?;
            sum_bytes = sum_bytes.saturating_add(meta.size);
        }
        Ok(sum_bytes)
    }

    /// Deletes the partial files of writes that were interrupted long ago. A bucket's own rules have to delete the files of
    /// uploads: they are not listed with the objects.
    pub(crate) fn remove_partial_writes(&self) -> io::Result<()> {
        match &self.backend {
            Backend::Folder(folder) => folder::remove_partial_writes(folder.data(), FILE_ORPHAN_AGE),
            Backend::Objects(_) => Ok(()),
        }
    }

    /// Verifies that the store can be used: a folder by writing and deleting a few bytes, a bucket by asking for an
    /// object that is not there, because this is called often and a write costs money.
    pub(crate) async fn check_usable(&self) -> Result<(), ContentError> {
        let name = blake3::hash(b"a probe").to_hex();
        let probe = self.location.prefix().join("probe").join(name.as_str());
        let (action, answer) = match &self.backend {
            Backend::Folder(folder) => ("write", folder.check_writable(&probe).await),
            Backend::Objects(objects) => {
                let read = tokio::time::timeout(READY_TIMEOUT, objects.store().get(&probe)).await;
                let late = |_| generic_error(io::ErrorKind::TimedOut.into());
                ("read", unless_missing(read.map_err(late).flatten()).map(drop))
            }
        };
        answer.map_err(self.failed(action, &format!("probe/{name}")))
    }
}

/// The found content; `None` if it is missing.
fn unless_missing<T>(found: object_store::Result<T>) -> object_store::Result<Option<T>> {
    match found {
        Ok(found) => Ok(Some(found)),
        Err(error) if error::is_missing(&error) => Ok(None),
        Err(error) => Err(error),
    }
}

fn stream(found: GetResult) -> BoxStream<'static, object_store::Result<Bytes>> {
    match found.payload {
        GetResultPayload::File(file, _) => folder::chunks(file, found.range),
        GetResultPayload::Stream(bytes) => bytes,
    }
}

/// Error of the disk, as one of an object store.
fn generic_error(error: io::Error) -> object_store::Error {
    object_store::Error::Generic { store: "file", source: error.into() }
}

/// Store error caused by a triggered fail point.
fn fail_point_error(struck: fail_point::FailPointError) -> object_store::Error {
    object_store::Error::Generic { store: "file", source: struck.into() }
}

#[cfg(test)]
mod tests;
