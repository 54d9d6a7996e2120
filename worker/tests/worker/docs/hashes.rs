//! The text of what the documented pictures are exactly: `docs/pictures/hashes.txt`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Hashes of a documented picture, in hex.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Exact {
    /// Of the pixels.
    pub(crate) pixels: String,
    /// Of the job, the frame and the size that it shows.
    pub(crate) shown: String,
    /// Of the file, which looks as the pixels do.
    pub(crate) file: String,
}

/// The hashes of each picture, by its path in docs/.
pub(crate) type Hashes = BTreeMap<String, Exact>;

fn path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/pictures/hashes.txt")
}

pub(crate) fn read() -> Hashes {
    let text = std::fs::read_to_string(path()).unwrap_or_default();
    let entry = |line: &str| {
        let words = line.split(' ').map(str::to_owned).collect::<Vec<_>>();
        let [pixels, shown, file, path] = words.try_into().expect("a line has four words");
        (path, Exact { pixels, shown, file })
    };
    text.lines().map(entry).collect()
}

/// Changes the text: a line for each picture, sorted by the paths.
pub(crate) fn change(change: impl FnOnce(&mut Hashes)) {
    static WRITING: Mutex<()> = Mutex::new(());
    let _writing = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
    let mut hashes = read();
    change(&mut hashes);
    let line = |(path, Exact { pixels, shown, file }): (&String, &Exact)| format!("{pixels} {shown} {file} {path}\n");
    std::fs::write(path(), hashes.iter().map(line).collect::<String>()).expect("docs can be written");
}
