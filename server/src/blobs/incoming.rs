//! Content on its way into a store: taken in pieces, limited in size, and compared with its hash before it counts.

use std::io;

use bytes::{Bytes, BytesMut};
use futures_util::stream::{Stream, TryStreamExt};

use super::{ContentError, ContentHash, ContentKind, WRITE_CHUNK_BYTES};

/// A piece of content.
#[derive(Debug)]
pub(super) enum Piece {
    /// At least [`WRITE_CHUNK_BYTES`]; more may follow.
    Part(Bytes),
    /// The rest, perhaps empty: all bytes together match the name.
    Last(Bytes),
}

/// Content that a client sends.
pub(super) struct Incoming<'a, S> {
    bytes: S,
    max_bytes: u64,
    name: &'a ContentHash,
    hasher: blake3::Hasher,
    size_bytes: u64,
    part: BytesMut,
}

impl<'a, S: Stream<Item = io::Result<Bytes>> + Unpin> Incoming<'a, S> {
    /// Content that should have this name.
    pub(super) fn new(kind: ContentKind, name: &'a ContentHash, bytes: S, max_bytes: u64) -> Self {
        let max_bytes = max_bytes.min(kind.max_bytes());
        Self { bytes, max_bytes, name, hasher: blake3::Hasher::new(), size_bytes: 0, part: BytesMut::new() }
    }

    /// Next piece; an error if the content is too large or is not what its name says. There is none after the last.
    pub(super) async fn piece(&mut self) -> Result<Piece, ContentError> {
        while let Some(chunk) = self.bytes.try_next().await.map_err(ContentError::Broken)? {
            self.size_bytes += chunk.len() as u64;
            if self.size_bytes > self.max_bytes {
                return Err(ContentError::TooLarge { limit_bytes: self.max_bytes });
            }
            self.hasher.update(&chunk);
            self.part.extend_from_slice(&chunk);
            if self.part.len() >= WRITE_CHUNK_BYTES {
                return Ok(Piece::Part(self.part.split().freeze()));
            }
        }
        let actual = self.hasher.finalize().to_hex();
        if actual.as_str() != self.name.as_str() {
            return Err(ContentError::Mismatch { expected: self.name.as_str().to_owned(), actual: actual.to_string() });
        }
        Ok(Piece::Last(self.part.split().freeze()))
    }
}
