//! Cache of machine code on disk, keyed by the hash of source, options and compiler, so that each kernel is
//! compiled once. A file that is damaged, or that cannot be read or written, counts as missing.

use std::fs::{File, Metadata};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::device::BlockDim;

/// Maximum size of all files in the folder. Those used longest ago are deleted first.
const MAX_BYTES: u64 = 1 << 30;

/// Default folder of the kernel cache: the user's cache folder.
pub fn default_cache_folder() -> Option<PathBuf> {
    let absolute = |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let cache = absolute("XDG_CACHE_HOME").or_else(|| absolute("HOME").map(|home| home.join(".cache")))?;
    Some(cache.join("sdfarm").join("kernels"))
}

/// Cached kernels in a folder.
#[derive(Clone, Debug)]
pub(super) struct Cache {
    folder: Option<PathBuf>,
}

/// Cache entry of a kernel.
#[derive(Clone, Debug)]
pub(super) struct CachedKernel {
    pub(super) code: Vec<u8>,
    /// Fastest block dimensions found.
    pub(super) block: BlockDim,
}

/// Header size: the hash of the code, and the block's columns and rows.
const HEAD_BYTES: usize = 32 + 4 + 4;

impl Cache {
    /// Cache in this folder, which is created if missing; without storage if that fails.
    pub(super) fn new(folder: Option<&Path>) -> Self {
        let made = folder.filter(|folder| match std::fs::create_dir_all(folder) {
            Ok(()) => true,
            Err(error) => {
                tracing::warn!(%error, folder = %folder.display(), "could not create the kernel cache's folder; each start compiles kernels again");
                false
            }
        });
        Self { folder: made.map(Path::to_owned) }
    }

    /// Folder of the cache.
    pub(super) fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// Key of a kernel: the hash of all input of the compiler, and of its version.
    pub(super) fn entry_name(text: &str, options: &[String], compiler: &str) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        hasher.update(format!("nvrtc {compiler} {}\n", options.join(" ")).as_bytes()).update(text.as_bytes());
        hasher.finalize()
    }

    /// Entry with this key.
    pub(super) fn get(&self, key: blake3::Hash) -> Option<CachedKernel> {
        let path = self.path(key)?;
        let file = std::fs::read(&path).ok()?;
        let (head, code) = file.split_at_checked(HEAD_BYTES)?;
        if blake3::hash(&file[32..]).as_bytes() != &head[..32] {
            return None;
        }
        // The time of its last use; a file that cannot be changed is as old as it was.
        drop(File::options().append(true).open(&path).and_then(|file| file.set_modified(SystemTime::now())));
        let word = |at: usize| head[at..at + 4].try_into().map(u32::from_le_bytes).ok();
        Some(CachedKernel { code: code.to_vec(), block: BlockDim { columns: word(32)?, rows: word(36)? } })
    }

    /// Stores a kernel, atomically.
    pub(super) fn put(&self, key: blake3::Hash, kept: &CachedKernel) {
        let Some(path) = self.path(key) else { return };
        let put = || {
            let mut file = tempfile::NamedTempFile::new_in(path.parent().unwrap_or(&path))?;
            let dimensions = [kept.block.columns.to_le_bytes(), kept.block.rows.to_le_bytes()].concat();
            let hash = blake3::Hasher::new().update(&dimensions).update(&kept.code).finalize();
            file.write_all(hash.as_bytes())?;
            file.write_all(&dimensions)?;
            file.write_all(&kept.code)?;
            file.persist(&path).map_err(|error| error.error).map(drop)
        };
        if let Err(error) = put() {
            tracing::debug!(%error, path = %path.display(), "could not store a compiled kernel");
        }
        self.prune(MAX_BYTES);
    }

    /// Stores a rejected source with the compiler's log; returns its file.
    pub(super) fn put_rejected(&self, text: &str, log: &str) -> Option<PathBuf> {
        let name = format!("refused-{}.cu", &blake3::hash(text.as_bytes()).to_hex()[..16]);
        let path = self.folder.as_ref()?.join(name);
        let commented = log.lines().collect::<Vec<_>>().join("\n// ");
        std::fs::write(&path, format!("{text}\n// {commented}\n")).ok()?;
        self.prune(MAX_BYTES);
        Some(path)
    }

    /// Deletes the files used longest ago, until the others are within a size.
    fn prune(&self, limit: u64) {
        let Some(Ok(entries)) = self.folder.as_ref().map(std::fs::read_dir) else { return };
        let is_kept = |path: &Path| path.extension().is_some_and(|end| end == "kernel" || end == "cu");
        let used = |metadata: &Metadata| metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        let files = entries.flatten().filter(|entry| is_kept(&entry.path()));
        let mut files: Vec<_> = files
            .filter_map(|entry| {
                let metadata = entry.metadata().ok()?;
                Some((used(&metadata), metadata.len(), entry.path()))
            })
            .collect();
        files.sort_unstable_by(|a, b| b.cmp(a));
        let mut total = 0_u64;
        for (_, bytes, path) in files {
            total = total.saturating_add(bytes);
            if total > limit {
                // Another worker may have deleted it.
                drop(std::fs::remove_file(path));
            }
        }
    }

    fn path(&self, key: blake3::Hash) -> Option<PathBuf> {
        self.folder.as_ref().map(|folder| folder.join(format!("{}.kernel", &key.to_hex()[..32])))
    }
}

#[cfg(test)]
mod tests {
    use super::super::compiler::options;
    use super::*;

    #[test]
    fn each_compiler_input_changes_the_key() {
        let key = Cache::entry_name("a", &options(90), "13.0");
        assert_ne!(key, Cache::entry_name("b", &options(90), "13.0"));
        assert_ne!(key, Cache::entry_name("a", &options(90), "13.1"));
        assert_ne!(key, Cache::entry_name("a", &options(75), "13.0"));
        for index in 0..options(90).len() {
            let mut fewer = options(90);
            fewer.remove(index);
            assert_ne!(key, Cache::entry_name("a", &fewer, "13.0"));
        }
    }

    #[test]
    fn stored_entries_are_found_and_damaged_ones_are_not() {
        let folder = tempfile::tempdir().expect("a scratch folder");
        let cache = Cache::new(Some(&folder.path().join("new")));
        let options = options(90);
        let key = Cache::entry_name("a", &options, "13.0");
        assert!(cache.get(key).is_none());
        let block = BlockDim { columns: 16, rows: 8 };
        cache.put(key, &CachedKernel { code: vec![1, 2, 3], block });
        let kept = cache.get(key).expect("it was stored");
        assert_eq!((kept.code, kept.block), (vec![1, 2, 3], block));
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
    fn files_used_longest_ago_are_deleted_beyond_a_size() {
        let folder = tempfile::tempdir().expect("a scratch folder");
        let cache = Cache::new(Some(folder.path()));
        let key = |name| Cache::entry_name(name, &options(90), "13.0");
        let block = BlockDim { columns: 16, rows: 8 };
        cache.put(key("first"), &CachedKernel { code: vec![0; 1000], block });
        cache.put(key("second"), &CachedKernel { code: vec![0; 1000], block });
        let rejected = cache.put_rejected("wrong", "no").expect("it is written");
        let age = |path: &Path, seconds| {
            let file = File::options().append(true).open(path).expect("it exists");
            file.set_modified(SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(seconds)).expect("it is set");
        };
        age(&cache.path(key("first")).expect("there is a folder"), 10);
        age(&cache.path(key("second")).expect("there is a folder"), 20);
        age(&rejected, 5);
        std::fs::write(folder.path().join("other"), "not of the cache").expect("it is written");
        assert!(cache.get(key("first")).is_some(), "now it was used last");
        cache.prune(1500);
        assert!(cache.get(key("first")).is_some() && cache.get(key("second")).is_none() && !rejected.exists());
        assert!(folder.path().join("other").exists());
    }

    #[test]
    fn without_a_folder_nothing_is_stored() {
        let folder = tempfile::NamedTempFile::new().expect("a scratch file");
        let cache = Cache::new(Some(&folder.path().join("below-a-file")));
        assert!(cache.folder().is_none());
        let key = Cache::entry_name("a", &options(90), "13.0");
        cache.put(key, &CachedKernel { code: vec![1], block: BlockDim { columns: 8, rows: 8 } });
        assert!(cache.get(key).is_none());
    }
}
