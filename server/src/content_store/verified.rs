//! Files whose bytes were found to match their hash since the server started.
//!
//! A file is hashed again when its time of modification changes; bytes that rot on the disk without that are found by
//! `sdfarm doctor --deep`.

use std::collections::HashMap;
use std::io;
use std::sync::{Arc, Mutex};

use object_store::{GetResult, GetResultPayload};

use super::{ContentHash, FileState};

/// Files up to this size are hashed before they are used, which takes at most 0.1 s; larger ones meanwhile.
const MAX_HASHED_FIRST_BYTES: u64 = 64 << 20;
/// Maximum number of remembered files; then all are forgotten, and hashed again.
const MAX_FILES: usize = 65_536;

/// Condition of a file as last modified at this time, in nanoseconds since 1970.
#[derive(Clone, Copy, Debug)]
struct Known {
    modified_ns: Option<i64>,
    state: FileState,
}

/// Results of hashing files.
#[derive(Clone, Debug, Default)]
pub(super) struct VerifiedFiles(Arc<Mutex<HashMap<String, Known>>>);

impl VerifiedFiles {
    /// Condition of a file of the right size.
    pub(super) async fn check(&self, name: &ContentHash, found: GetResult) -> object_store::Result<FileState> {
        let modified_ns = found.meta.last_modified.timestamp_nanos_opt();
        if let Some(known) = self.find(name).filter(|known| known.modified_ns == modified_ns) {
            return Ok(known.state);
        }
        let size_bytes = found.meta.size;
        let GetResultPayload::File(file, _) = found.payload else { unreachable!("both stores are folders") };
        let (this, expected) = (self.clone(), name.clone());
        let hashing = tokio::task::spawn_blocking(move || {
            let state = if hash(file)? == expected.as_str() { FileState::Intact } else { FileState::Damaged };
            this.remember(&expected, Known { modified_ns, state });
            Ok(state)
        });
        if size_bytes > MAX_HASHED_FIRST_BYTES {
            // Until the result is known, the file is used as if it were intact, and not hashed twice.
            self.remember(name, Known { modified_ns, state: FileState::Intact });
            return Ok(FileState::Intact);
        }
        hashing
            .await
            .map_err(io::Error::other)
            .flatten()
            .map_err(|error| object_store::Error::Generic { store: "file", source: error.into() })
    }

    fn find(&self, name: &ContentHash) -> Option<Known> {
        self.0.lock().expect("no holder panics").get(name.as_str()).copied()
    }

    fn remember(&self, name: &ContentHash, known: Known) {
        let mut files = self.0.lock().expect("no holder panics");
        if files.len() >= MAX_FILES {
            files.clear();
        }
        files.insert(name.as_str().to_owned(), known);
    }
}

fn hash(mut file: std::fs::File) -> io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    io::copy(&mut file, &mut hasher)?;
    Ok(hasher.finalize().to_hex().to_string())
}
