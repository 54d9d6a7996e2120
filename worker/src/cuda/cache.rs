//! Cache of machine code on disk, by hash of source, architecture and compiler: a scene's structure is
//! compiled once. A file that is damaged, or cannot be read or written, counts as missing.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::device::Shape;

/// Cached kernels in a folder.
#[derive(Clone, Debug)]
pub(super) struct Cache {
    folder: Option<PathBuf>,
}

/// Cache entry of a kernel.
#[derive(Clone, Debug)]
pub(super) struct Kept {
    pub(super) code: Vec<u8>,
    /// Fastest block shape found.
    pub(super) shape: Shape,
}

/// Bytes before the code: its hash, and the shape's columns and rows.
const HEAD_BYTES: usize = 32 + 4 + 4;

impl Cache {
    /// Cache in this folder, which is created; a cache without storage if that fails.
    pub(super) fn new(folder: Option<&Path>) -> Self {
        let made = folder.filter(|folder| match std::fs::create_dir_all(folder) {
            Ok(()) => true,
            Err(error) => {
                tracing::warn!(%error, folder = %folder.display(), "could not make the folder for compiled scenes; each start compiles them again");
                false
            }
        });
        Self { folder: made.map(Path::to_owned) }
    }

    /// The folder.
    pub(super) fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// The name of a program.
    pub(super) fn key(text: &str, architecture: u32, compiler: &str) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        hasher.update(format!("sm_{architecture} nvrtc {compiler}\n").as_bytes()).update(text.as_bytes());
        hasher.finalize()
    }

    /// Entry under this name.
    pub(super) fn get(&self, key: blake3::Hash) -> Option<Kept> {
        let file = std::fs::read(self.path(key)?).ok()?;
        let (head, code) = file.split_at_checked(HEAD_BYTES)?;
        if blake3::hash(&file[32..]).as_bytes() != &head[..32] {
            return None;
        }
        let word = |at: usize| head[at..at + 4].try_into().map(u32::from_le_bytes).ok();
        Some(Kept { code: code.to_vec(), shape: Shape { columns: word(32)?, rows: word(36)? } })
    }

    /// Keeps a program, whole or not at all.
    pub(super) fn put(&self, key: blake3::Hash, kept: &Kept) {
        let Some(path) = self.path(key) else { return };
        let put = || {
            let mut file = tempfile::NamedTempFile::new_in(path.parent().unwrap_or(&path))?;
            let shape = [kept.shape.columns.to_le_bytes(), kept.shape.rows.to_le_bytes()].concat();
            let hash = blake3::Hasher::new().update(&shape).update(&kept.code).finalize();
            file.write_all(hash.as_bytes())?;
            file.write_all(&shape)?;
            file.write_all(&kept.code)?;
            file.persist(&path).map_err(|error| error.error).map(drop)
        };
        if let Err(error) = put() {
            tracing::debug!(%error, path = %path.display(), "could not keep a compiled scene");
        }
    }

    fn path(&self, key: blake3::Hash) -> Option<PathBuf> {
        self.folder.as_ref().map(|folder| folder.join(format!("{}.kernel", &key.to_hex()[..32])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_kept_comes_back_and_what_was_damaged_does_not() {
        let folder = tempfile::tempdir().expect("a scratch folder");
        let cache = Cache::new(Some(&folder.path().join("new")));
        let (key, other) = (Cache::key("a", 90, "13.0"), Cache::key("a", 75, "13.0"));
        assert_ne!(key, other);
        assert!(cache.get(key).is_none());
        let shape = Shape { columns: 16, rows: 8 };
        cache.put(key, &Kept { code: vec![1, 2, 3], shape });
        let kept = cache.get(key).expect("it was kept");
        assert_eq!((kept.code, kept.shape), (vec![1, 2, 3], shape));
        let path = cache.path(key).expect("there is a folder");
        let mut bytes = std::fs::read(&path).expect("it can be read");
        for damaged in [bytes[..20].to_vec(), {
            bytes[41] ^= 1;
            bytes.clone()
        }] {
            std::fs::write(&path, damaged).expect("it can be written");
            assert!(cache.get(key).is_none());
        }
    }

    #[test]
    fn without_a_folder_nothing_is_kept() {
        let folder = tempfile::NamedTempFile::new().expect("a scratch file");
        let cache = Cache::new(Some(&folder.path().join("below-a-file")));
        assert!(cache.folder().is_none());
        let key = Cache::key("a", 90, "13.0");
        cache.put(key, &Kept { code: vec![1], shape: Shape { columns: 8, rows: 8 } });
        assert!(cache.get(key).is_none());
    }
}
