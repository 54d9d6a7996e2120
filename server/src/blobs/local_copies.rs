//! Stored content as local files, for the helper processes that draw previews.
//!
//! In a folder the files are the store's own. Objects are copied into a temporary folder, which is deleted with this
//! value; only copies with the right bytes are kept.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use futures_util::future::try_join_all;
use futures_util::stream::StreamExt;
use tempfile::TempDir;
use tokio::io::AsyncWriteExt;

use super::{BlobStore, ContentError, ContentHash, ContentKind, generic_error};

/// Maximum size of all copies for one preview; files beyond it are missing, as if they were not stored.
const MAX_COPIED_BYTES: u64 = 2 << 30;
/// Number of objects copied at a time.
const MAX_CONCURRENT_COPIES: usize = 8;

/// Files of content, or paths where there is none because the content is missing.
#[derive(Debug)]
pub(crate) struct LocalCopies {
    files: Vec<PathBuf>,
    _folder: Option<TempDir>,
}

impl LocalCopies {
    /// Files with the content of these names, in their order; copies are made below `folder`.
    pub(crate) async fn fetch(
        store: &BlobStore,
        folder: &Path,
        kind: ContentKind,
        names: &[String],
    ) -> Result<Self, ContentError> {
        if let Some(data) = store.folder() {
            let files = names.iter().map(|name| kind.path(data).join(name)).collect();
            return Ok(Self { files, _folder: None });
        }
        let made = tempfile::tempdir_in(folder).map_err(generic_error).map_err(store.failed("copy", kind.folder()))?;
        let files = names.iter().map(|name| made.path().join(name)).collect();
        let copied_bytes = AtomicU64::new(0);
        let names: Vec<_> = names.iter().filter_map(|name| ContentHash::parse(name)).collect();
        for names in names.chunks(MAX_CONCURRENT_COPIES) {
            try_join_all(names.iter().map(|name| copy(store, kind, name, made.path(), &copied_bytes))).await?;
        }
        Ok(Self { files, _folder: Some(made) })
    }

    /// The files.
    pub(crate) fn files(&self) -> &[PathBuf] {
        &self.files
    }
}

async fn copy(
    store: &BlobStore,
    kind: ContentKind,
    name: &ContentHash,
    folder: &Path,
    copied_bytes: &AtomicU64,
) -> Result<(), ContentError> {
    let failed = store.failed_on("copy", kind, name);
    let Some((size_bytes, mut bytes)) = store.get(kind, name, None).await? else { return Ok(()) };
    if copied_bytes.fetch_add(size_bytes, Ordering::Relaxed) + size_bytes > MAX_COPIED_BYTES {
        return Ok(());
    }
    let path = folder.join(name.as_str());
    let unwritable = |error| failed(generic_error(error));
    let mut file = tokio::fs::File::create_new(&path).await.map_err(unwritable)?;
    let mut hasher = blake3::Hasher::new();
    while let Some(chunk) = bytes.next().await {
        let chunk = chunk.map_err(&failed)?;
        hasher.update(&chunk);
        file.write_all(&chunk).await.map_err(unwritable)?;
    }
    file.flush().await.map_err(unwritable)?;
    if hasher.finalize().to_hex().as_str() != name.as_str() {
        tokio::fs::remove_file(&path).await.map_err(unwritable)?;
    }
    Ok(())
}
