//! Where a farm keeps its pictures and blobs, as `--store` names it and as its data folder records it.
//!
//! The record lets commands that work on a data folder find the store, and keeps a server from starting on another
//! one, where all pictures would be missing. It opens no store.

use std::fmt;
use std::io::{self, Write};
use std::path::Path as FolderPath;
use std::str::FromStr;

use object_store::path::Path;

use crate::private_files;

/// File of the record in a data folder; there is none if the pictures are in the data folder.
const FILE: &str = "store";

/// Place of pictures and blobs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum StoreLocation {
    /// The data folder.
    #[default]
    Folder,
    /// A bucket of an S3 store; keys and endpoint come from the usual environment variables.
    S3 {
        /// Name of the bucket.
        bucket: String,
        /// Key prefix without slashes at its ends; may be empty.
        prefix: String,
    },
    /// Memory, for tests: everything is lost with the process.
    Memory,
}

/// Error returned when text names no store.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "write s3://BUCKET or s3://BUCKET/PREFIX, such as s3://renders/farm-1: a bucket has 3 to 63 lower-case letters, \
     digits, dots and hyphens, and a prefix letters, digits and -_. between slashes; without a store, pictures are in \
     the data folder"
)]
pub struct ParseStoreError;

impl FromStr for StoreLocation {
    type Err = ParseStoreError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let rest = text.strip_prefix("s3://").ok_or(ParseStoreError)?;
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        let is_edge = |byte: Option<&u8>| byte.is_some_and(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit());
        let is_bucket = (3..=63).contains(&bucket.len())
            && bucket.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b".-".contains(&byte))
            && is_edge(bucket.as_bytes().first())
            && is_edge(bucket.as_bytes().last());
        let prefix = prefix.strip_suffix('/').unwrap_or(prefix);
        let is_part = |part: &str| {
            !["", ".", ".."].contains(&part)
                && part.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte))
        };
        let is_prefix = prefix.len() <= 512 && (prefix.is_empty() || prefix.split('/').all(is_part));
        if is_bucket && is_prefix {
            Ok(Self::S3 { bucket: bucket.to_owned(), prefix: prefix.to_owned() })
        } else {
            Err(ParseStoreError)
        }
    }
}

impl fmt::Display for StoreLocation {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Folder => formatter.write_str("the data folder"),
            Self::S3 { bucket, prefix } if prefix.is_empty() => write!(formatter, "s3://{bucket}"),
            Self::S3 { bucket, prefix } => write!(formatter, "s3://{bucket}/{prefix}"),
            Self::Memory => formatter.write_str("memory"),
        }
    }
}

impl StoreLocation {
    /// Its kind, in one word.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::Folder => "folder",
            Self::S3 { .. } => "s3",
            Self::Memory => "memory",
        }
    }

    /// Prefix of all keys.
    pub(crate) fn prefix(&self) -> Path {
        match self {
            Self::S3 { prefix, .. } => Path::from(prefix.as_str()),
            Self::Folder | Self::Memory => Path::default(),
        }
    }

    /// Store that a data folder's farm uses.
    pub(crate) fn recorded(data: &FolderPath) -> io::Result<Self> {
        match std::fs::read_to_string(data.join(FILE)) {
            Ok(text) => text.trim().parse().map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Self::Folder),
            Err(error) => Err(error),
        }
    }

    /// Records in a data folder that its farm uses this store.
    pub(crate) fn record(&self, data: &FolderPath) -> io::Result<()> {
        if !matches!(self, Self::S3 { .. }) || data.join(FILE).exists() {
            return Ok(());
        }
        self.write_record(data)
    }

    /// Records in a data folder that its farm uses this store from now on.
    pub(crate) fn replace_record(&self, data: &FolderPath) -> io::Result<()> {
        if matches!(self, Self::S3 { .. }) {
            return self.write_record(data);
        }
        match std::fs::remove_file(data.join(FILE)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            Ok(()) | Err(_) => Ok(()),
        }
    }

    fn write_record(&self, data: &FolderPath) -> io::Result<()> {
        let part = data.join("store.part");
        let mut file = private_files::create_file(&part)?;
        writeln!(file, "{self}")?;
        file.sync_all()?;
        std::fs::rename(part, data.join(FILE))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stores_are_parsed_and_printed() {
        for (text, bucket, prefix) in [
            ("s3://renders", "renders", ""),
            ("s3://renders/", "renders", ""),
            ("s3://a.b-1/farm_1/x.y/", "a.b-1", "farm_1/x.y"),
        ] {
            let expected = StoreLocation::S3 { bucket: bucket.to_owned(), prefix: prefix.to_owned() };
            assert_eq!(text.parse(), Ok(expected.clone()), "{text}");
            assert_eq!(expected.to_string(), text.trim_end_matches('/'));
        }
        for text in [
            "",
            "renders",
            "s3:renders",
            "s3://",
            "s3://ab",
            "s3://Renders",
            "s3://a_b_c",
            "s3://-abc",
            "s3://abc.",
            "s3://abc//x",
            "s3://abc/../x",
            "s3://abc/x?y=1",
            "s3://key:secret@abc",
            "https://s3.example/abc",
            "s3://abc/a b",
            "/data",
            "gs://abc",
        ] {
            assert_eq!(text.parse::<StoreLocation>(), Err(ParseStoreError), "{text}");
        }
    }

    #[test]
    fn a_data_folder_remembers_its_store() {
        let data = tempfile::tempdir().expect("a temporary folder");
        let recorded = || StoreLocation::recorded(data.path()).expect("reads");
        StoreLocation::Folder.record(data.path()).expect("writes");
        assert_eq!(recorded(), StoreLocation::Folder);
        let store: StoreLocation = "s3://renders/farm".parse().expect("a store");
        store.record(data.path()).expect("writes");
        assert_eq!(recorded(), store);
        std::fs::write(data.path().join(FILE), "elsewhere").expect("writes");
        StoreLocation::recorded(data.path()).expect_err("no store is named");
    }
}
