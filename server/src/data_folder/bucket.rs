//! The pictures of a farm whose store is a bucket: compared with the database for the doctor, and listed for backups.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use futures_util::stream::TryStreamExt;

use super::DataFolderError;
use super::database::PictureRef;
use super::store_check::{Orphan, StoreComparison};
use crate::blobs::{BlobStore, ContentHash, ContentKind, StoreLocation};

/// Content found in a bucket.
#[derive(Clone, Debug)]
struct Found {
    size_bytes: u64,
    age_seconds: u64,
}

/// The bucket that a data folder's farm uses; `None` if it uses the folder itself.
pub(super) fn open(data: &Path) -> Result<Option<BlobStore>, DataFolderError> {
    let location = StoreLocation::recorded(data).map_err(DataFolderError::file("read", data))?;
    if location == StoreLocation::Folder {
        return Ok(None);
    }
    let opened = BlobStore::open_unchecked(&location, data, None);
    opened.map(Some).map_err(|error| DataFolderError::Store(error.into()))
}

/// Splits the pictures of a database into those that are in a bucket and the hashes of the others.
pub(super) async fn find_pictures(
    store: &BlobStore,
    pictures: &[PictureRef],
) -> Result<(u64, Vec<String>), DataFolderError> {
    let found = list(store, ContentKind::Picture).await?;
    let is_there =
        |named: &&PictureRef| found.get(&named.hash).is_some_and(|found| found.size_bytes == named.size_bytes);
    let missing: Vec<_> = pictures.iter().filter(|named| !is_there(named)).map(|named| named.hash.clone()).collect();
    Ok(((pictures.len() - missing.len()) as u64, missing))
}

/// Compares a bucket with the database; `deep` reads every byte. Content that may not have been reported yet is no
/// orphan.
pub(super) async fn compare(
    store: &BlobStore,
    pictures: &[PictureRef],
    blobs: &[String],
    deep: bool,
) -> Result<StoreComparison, DataFolderError> {
    let mut comparison = StoreComparison::default();
    let found = list(store, ContentKind::Picture).await?;
    for named in pictures {
        let hash = || named.hash.clone();
        match found.get(&named.hash) {
            None => comparison.missing.push(hash()),
            Some(found) if found.size_bytes != named.size_bytes => comparison.damaged.push(hash()),
            Some(_) if deep && !is_intact(store, &named.hash).await? => comparison.damaged.push(hash()),
            Some(_) => comparison.intact += 1,
        }
    }
    let named = pictures.iter().map(|named| named.hash.as_str()).collect();
    find_orphans(store, ContentKind::Picture, &found, &named, &mut comparison);
    let named = blobs.iter().map(String::as_str).collect();
    let found = list(store, ContentKind::Blob).await?;
    find_orphans(store, ContentKind::Blob, &found, &named, &mut comparison);
    Ok(comparison)
}

fn find_orphans(
    store: &BlobStore,
    kind: ContentKind,
    found: &HashMap<String, Found>,
    named: &HashSet<&str>,
    comparison: &mut StoreComparison,
) {
    let is_orphan = |(name, found): &(&String, &Found)| {
        !named.contains(name.as_str()) && found.age_seconds >= store.orphan_age().as_secs()
    };
    for (name, found) in found.iter().filter(is_orphan) {
        // Objects of other names are not the farm's.
        let Some(name) = ContentHash::parse(name) else { continue };
        comparison.orphan_bytes += found.size_bytes;
        comparison.orphans.push(Orphan::Object(kind, name));
    }
}

async fn list(store: &BlobStore, kind: ContentKind) -> Result<HashMap<String, Found>, DataFolderError> {
    let listed = store.list(kind).try_fold(HashMap::new(), async |mut listed, (name, meta)| {
        let age_seconds = crate::blobs::age(&meta).as_secs();
        listed.insert(name.as_str().to_owned(), Found { size_bytes: meta.size, age_seconds });
        Ok(listed)
    });
    listed.await.map_err(|error| store.list_error(kind, error)).map_err(|error| DataFolderError::Store(error.into()))
}

async fn is_intact(store: &BlobStore, hash: &str) -> Result<bool, DataFolderError> {
    let Some(name) = ContentHash::parse(hash) else { return Ok(false) };
    let actual = store.hash(ContentKind::Picture, &name).await;
    Ok(actual.map_err(|error| DataFolderError::Store(error.into()))?.as_deref() == Some(hash))
}
