//! Kinds and names of stored content. It knows no store.

use std::path::{Path, PathBuf};

use proto::worker_protocol::{MAX_BLOB_BYTES, MAX_PICTURE_BYTES};

/// Kind of content, each in its own folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum ContentKind {
    /// A frame's picture.
    Picture,
    /// A tile's pixels.
    Blob,
}

impl ContentKind {
    /// Both kinds.
    pub(crate) const ALL: [Self; 2] = [Self::Picture, Self::Blob];

    /// Name in the database.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Picture => "picture",
            Self::Blob => "blob",
        }
    }

    /// Name of its folder, and first part of its objects' keys below the store's prefix.
    pub(crate) fn folder(self) -> &'static str {
        match self {
            Self::Picture => "pictures",
            Self::Blob => "tiles",
        }
    }

    /// Folder of this kind in a data folder.
    pub(crate) fn path(self, data: &Path) -> PathBuf {
        data.join(self.folder())
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
