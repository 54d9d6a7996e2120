//! Moves the pictures of a stopped farm, and the blobs of its unfinished frames, to another store: from the data folder to a
//! bucket, back, or to another bucket or prefix. What was moved before an interruption is not moved again.

use std::collections::HashMap;
use std::io;
use std::path::Path;

use futures_util::stream::{self, StreamExt, TryStreamExt};

use super::DataFolderError;
use super::database::{self, PictureRef};
use crate::blobs::{BlobStore, ContentError, ContentHash, ContentKind, OpenStoreError, StoreLocation};
use crate::db::{Database, DatabaseLocation, FarmId, PostgresAddress, Sharing};
use crate::lock::FolderLock;

/// Number of files or objects copied at a time.
const MAX_CONCURRENT_COPIES: usize = 8;

/// Result of a move.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MovedPictures {
    /// Number of pictures and blobs that were copied.
    pub copied: u64,
    /// Number of their bytes.
    pub copied_bytes: u64,
    /// Number of those that were there already, as an interrupted move leaves them.
    pub there: u64,
    /// Names of those that are missing from the old store, or damaged in it: they are rendered again.
    pub missing: Vec<String>,
    /// The store that the farm had; it is kept.
    pub from: String,
    /// The store that it has now.
    pub to: String,
}

/// Names that rows refer to.
struct Contents {
    farm: FarmId,
    pictures: Vec<PictureRef>,
    blobs: Vec<String>,
}

/// Result of copying one name.
enum Copied {
    /// With this number of bytes.
    Now(u64),
    Missing,
}

/// Copies what the farm in `data` has stored to another store, and records that it has this one. The farm must be stopped.
/// `from` is the address of its database with a password, if it needs one.
pub async fn move_pictures(
    data: &Path,
    database: Option<PostgresAddress>,
    to: &StoreLocation,
) -> Result<MovedPictures, DataFolderError> {
    let lock = FolderLock::acquire(data).map_err(DataFolderError::lock(data))?;
    let recorded = StoreLocation::recorded(data).map_err(DataFolderError::file("read", data))?;
    if recorded == *to {
        return Err(DataFolderError::SameStore(to.to_string()));
    }
    let contents = contents(data, database).await?;
    let source = BlobStore::open_unchecked(&recorded, data, None).map_err(open_error(data))?;
    let target = BlobStore::open(to, data, None).await.map_err(open_error(data))?;
    source.check_owner(contents.farm).await.map_err(|error| DataFolderError::Store(error.into()))?;
    target.claim(contents.farm).await.map_err(|error| DataFolderError::Store(error.into()))?;
    let mut moved = MovedPictures { from: recorded.to_string(), to: to.to_string(), ..MovedPictures::default() };
    let pictures = contents.pictures.into_iter().map(|named| (named.hash, Some(named.size_bytes)));
    copy_all(&source, &target, ContentKind::Picture, pictures.collect(), &mut moved).await?;
    let blobs = contents.blobs.into_iter().map(|hash| (hash, None));
    copy_all(&source, &target, ContentKind::Blob, blobs.collect(), &mut moved).await?;
    to.replace_record(data).map_err(DataFolderError::file("write", data))?;
    drop(lock);
    Ok(moved)
}

fn open_error(data: &Path) -> impl Fn(OpenStoreError) -> DataFolderError {
    move |error| match error {
        OpenStoreError::Folder(error) => DataFolderError::file("use", data)(error),
        OpenStoreError::Bucket(error) => DataFolderError::Store(error.into()),
    }
}

/// Reads what the farm refers to; no other server may use its database meanwhile.
async fn contents(data: &Path, database: Option<PostgresAddress>) -> Result<Contents, DataFolderError> {
    let mut location = DatabaseLocation::of_folder(data).map_err(DataFolderError::file("read", data))?;
    if location.postgres.is_none() && !Database::file(data).is_file() {
        return Err(DataFolderError::NoDatabase(data.to_owned()));
    }
    if location.postgres.is_some() && database.is_some() {
        location.postgres = database;
    }
    let name = location.to_string();
    let failed =
        |source: Box<dyn std::error::Error + Send + Sync>| DataFolderError::Move { database: name.clone(), source };
    let open = Database::open_at(&location, Sharing::Alone).await.map_err(|error| failed(error.into()))?;
    let read = async {
        let farm = open.farm_id().await?;
        let pictures = database::pictures(open.readers()).await?;
        Ok(Contents { farm, pictures, blobs: database::blobs(open.readers()).await? })
    };
    let read: Result<Contents, crate::db::DatabaseError> = read.await;
    open.close().await;
    read.map_err(|error| failed(error.into()))
}

/// Copies the content of these names, with its size if that is known, unless it is there.
async fn copy_all(
    source: &BlobStore,
    target: &BlobStore,
    kind: ContentKind,
    names: Vec<(String, Option<u64>)>,
    moved: &mut MovedPictures,
) -> Result<(), DataFolderError> {
    let failed = |error: ContentError| DataFolderError::Store(error.into());
    // An object or a file has its name only when it is complete and its bytes match it.
    let listed = target.list(kind).try_fold(HashMap::new(), async |mut listed, (name, meta)| {
        listed.insert(name.as_str().to_owned(), meta.size);
        Ok(listed)
    });
    let listed: HashMap<String, u64> = listed.await.map_err(|error| failed(target.list_error(kind, error)))?;
    let is_there = |name: &str, size_bytes: &Option<u64>| {
        listed.get(name).is_some_and(|there| size_bytes.is_none_or(|size_bytes| size_bytes == *there))
    };
    let (there, rest): (Vec<_>, Vec<_>) = names.into_iter().partition(|(name, size)| is_there(name, size));
    moved.there += there.len() as u64;
    let mut copies = stream::iter(rest)
        .map(async |(name, _)| copy(source, target, kind, &name).await.map(|copied| (name, copied)))
        .buffer_unordered(MAX_CONCURRENT_COPIES);
    while let Some((name, copied)) = copies.try_next().await.map_err(failed)? {
        match copied {
            Copied::Now(size_bytes) => {
                moved.copied += 1;
                moved.copied_bytes += size_bytes;
            }
            Copied::Missing => moved.missing.push(name),
        }
    }
    Ok(())
}

async fn copy(source: &BlobStore, target: &BlobStore, kind: ContentKind, name: &str) -> Result<Copied, ContentError> {
    let Some(name) = ContentHash::parse(name) else { return Ok(Copied::Missing) };
    let Some((size_bytes, bytes)) = source.get(kind, &name, None).await? else { return Ok(Copied::Missing) };
    // The target compares the bytes with their name.
    match target.put(kind, &name, bytes.map_err(io::Error::other), u64::MAX).await {
        Ok(()) => Ok(Copied::Now(size_bytes)),
        Err(ContentError::Mismatch { .. } | ContentError::TooLarge { .. }) => Ok(Copied::Missing),
        Err(error) => Err(error),
    }
}
