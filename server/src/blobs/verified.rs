//! Content whose bytes were found to match their hash since the server started.
//!
//! A file is hashed again when its time of modification changes, an object when its entity tag does: an object that this
//! server stored is known already, any other is read once more before its first use. Bytes that rot in the store without
//! that are found by `sdfarm doctor --deep`.

use std::collections::HashMap;
use std::io;
use std::sync::{Arc, Mutex};

use bytes::Bytes;
use futures_util::stream::{BoxStream, StreamExt, TryStreamExt};
use object_store::{GetResult, GetResultPayload};

use super::{ContentHash, FileState, generic_error, objects};

/// Content up to this size is hashed before it is used, which takes at most 0.1 s from a disk; larger content meanwhile.
const MAX_HASHED_FIRST_BYTES: u64 = 64 << 20;
/// Maximum number of remembered names; then all are forgotten, and hashed again.
const MAX_FILES: usize = 65_536;

/// Condition of one version of content.
#[derive(Clone, Debug)]
struct Known {
    version: Option<String>,
    state: FileState,
}

/// Results of hashing content.
#[derive(Clone, Debug, Default)]
pub(super) struct VerifiedContent(Arc<Mutex<HashMap<String, Known>>>);

impl VerifiedContent {
    /// Condition of content of the right size.
    pub(super) async fn check(&self, name: &ContentHash, found: GetResult) -> object_store::Result<FileState> {
        let version = version(&found);
        if let Some(known) = self.find(name).filter(|known| known.version == version) {
            return Ok(known.state);
        }
        let size_bytes = found.meta.size;
        let (this, expected, of_version) = (self.clone(), name.clone(), version.clone());
        let hashing = tokio::spawn(async move {
            let actual = match found.payload {
                GetResultPayload::File(file, _) => {
                    let hashing = tokio::task::spawn_blocking(move || hash(file));
                    hashing.await.map_err(io::Error::other).flatten().map_err(generic_error)?
                }
                GetResultPayload::Stream(_) => objects::hash(found).await?,
            };
            let state = if actual == expected.as_str() { FileState::Intact } else { FileState::Damaged };
            this.remember(&expected, Known { version: of_version, state });
            Ok(state)
        });
        if size_bytes > MAX_HASHED_FIRST_BYTES {
            // Until the result is known, the content is used as if it were intact, and not hashed twice.
            self.remember(name, Known { version, state: FileState::Intact });
            return Ok(FileState::Intact);
        }
        hashing.await?
    }

    /// The same bytes. The last of them come only if all match the name; otherwise an error does, so that no reader takes
    /// them for complete, and the version is known to be damaged.
    pub(super) fn while_read(
        &self,
        name: ContentHash,
        version: Option<String>,
        bytes: BoxStream<'static, object_store::Result<Bytes>>,
    ) -> BoxStream<'static, object_store::Result<Bytes>> {
        let reading = Reading { known: self.clone(), name, version, bytes, hasher: blake3::Hasher::new(), held: None };
        futures_util::stream::try_unfold(Some(reading), async |reading| match reading {
            Some(reading) => reading.next().await,
            None => Ok(None),
        })
        .boxed()
    }

    /// Notes that a version has the right bytes, because they were compared before they were stored.
    pub(super) fn insert(&self, name: &ContentHash, version: Option<String>) {
        if version.is_some() {
            self.remember(name, Known { version, state: FileState::Intact });
        }
    }

    fn find(&self, name: &ContentHash) -> Option<Known> {
        self.0.lock().expect("no holder panics").get(name.as_str()).cloned()
    }

    fn remember(&self, name: &ContentHash, known: Known) {
        let mut files = self.0.lock().expect("no holder panics");
        if files.len() >= MAX_FILES {
            files.clear();
        }
        files.insert(name.as_str().to_owned(), known);
    }
}

/// Content that is hashed while it is read.
struct Reading {
    known: VerifiedContent,
    name: ContentHash,
    version: Option<String>,
    bytes: BoxStream<'static, object_store::Result<Bytes>>,
    hasher: blake3::Hasher,
    held: Option<Bytes>,
}

impl Reading {
    /// The next bytes, and what reads on, if anything is left.
    async fn next(mut self) -> object_store::Result<Option<(Bytes, Option<Self>)>> {
        while let Some(chunk) = self.bytes.try_next().await? {
            self.hasher.update(&chunk);
            if let Some(before) = self.held.replace(chunk) {
                return Ok(Some((before, Some(self))));
            }
        }
        if self.hasher.finalize().to_hex().as_str() == self.name.as_str() {
            return Ok(self.held.take().map(|last| (last, None)));
        }
        tracing::error!(name = self.name.as_str(), "the store sent other bytes than it was given");
        self.known.remember(&self.name, Known { version: self.version, state: FileState::Damaged });
        Err(generic_error(io::Error::new(io::ErrorKind::InvalidData, "the bytes are not those of the name")))
    }
}

/// A value that changes with the bytes: a file's time of modification in nanoseconds, an object's entity tag.
pub(super) fn version(found: &GetResult) -> Option<String> {
    let modified = || found.meta.last_modified.timestamp_nanos_opt().map(|modified_ns| modified_ns.to_string());
    match &found.payload {
        GetResultPayload::File(..) => modified(),
        GetResultPayload::Stream(_) => found.meta.e_tag.clone().or_else(modified),
    }
}

fn hash(mut file: std::fs::File) -> io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    io::copy(&mut file, &mut hasher)?;
    Ok(hasher.finalize().to_hex().to_string())
}
