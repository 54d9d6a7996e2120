//! Content encodings of request bodies: which there are, and what they unpack to. It reads nothing from the network.

use std::io::{self, Read};

use axum::http::{HeaderMap, header};
use flate2::bufread::MultiGzDecoder;
use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};

use crate::http::error::ApiError;

/// Encodings that the routes of job files take, as they are named in `Accept-Encoding`.
const ACCEPTED: &str = "gzip, zstd";
/// The same, of all other routes.
const NONE_ACCEPTED: &str = "identity";
/// Bytes that are unpacked at a time.
const CHUNK_BYTES: usize = 64 << 10;
/// Maximum window of a zstd frame, which is all that decoding it keeps in memory. It is that of HTTP (RFC 9659).
const MAX_ZSTD_WINDOW_BYTES: u64 = 8 << 20;

/// The cure for an encoding that a route does not take.
pub(in crate::http) fn encoding_cure(accepted: &str) -> &'static str {
    match accepted {
        NONE_ACCEPTED => "this route takes none, so send the body as it is, without Content-Encoding",
        _ => "compress the body with either gzip or zstd, or send it as it is, without Content-Encoding",
    }
}

/// A content encoding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::http) enum ContentEncoding {
    /// Members of gzip (RFC 1952).
    Gzip,
    /// Frames of Zstandard (RFC 8878).
    Zstd,
}

impl ContentEncoding {
    /// The encoding of a request's body; `None` if it is not encoded.
    pub(in crate::http) fn of(headers: &HeaderMap) -> Result<Option<Self>, ApiError> {
        let values = headers.get_all(header::CONTENT_ENCODING).iter().map(|value| value.to_str().unwrap_or("?"));
        let found = values.collect::<Vec<_>>().join(", ");
        let names = found.split(',').map(|name| name.trim().to_ascii_lowercase());
        let mut applied = names.filter(|name| !matches!(name.as_str(), "" | "identity"));
        match (applied.next().as_deref(), applied.next()) {
            (None, _) => Ok(None),
            (Some("gzip" | "x-gzip"), None) => Ok(Some(Self::Gzip)),
            (Some("zstd"), None) => Ok(Some(Self::Zstd)),
            (Some(_), _) => Err(ApiError::WrongEncoding { found, accepted: ACCEPTED }),
        }
    }

    /// Rejects every encoding, for routes whose bodies are small.
    pub(in crate::http) fn expect_none(headers: &HeaderMap) -> Result<(), ApiError> {
        let found = match Self::of(headers) {
            Ok(None) => return Ok(()),
            Ok(Some(encoding)) => encoding.name().to_owned(),
            Err(ApiError::WrongEncoding { found, .. }) => found,
            Err(error) => return Err(error),
        };
        Err(ApiError::WrongEncoding { found, accepted: NONE_ACCEPTED })
    }

    /// Its name in `Content-Encoding`.
    pub(in crate::http) fn name(self) -> &'static str {
        match self {
            Self::Gzip => "gzip",
            Self::Zstd => "zstd",
        }
    }

    /// Unpacks a body to at most `limit_bytes`; `grow` is called before each piece is kept, and may end it.
    pub(in crate::http) fn unpack(
        self,
        packed: &[u8],
        limit_bytes: usize,
        mut grow: impl FnMut(usize) -> Result<(), ApiError>,
    ) -> Result<Vec<u8>, ApiError> {
        let mut reader: Box<dyn Read + '_> = match self {
            Self::Gzip => Box::new(MultiGzDecoder::new(packed)),
            Self::Zstd => Box::new(ZstdReader::new(packed)),
        };
        let (mut unpacked, mut chunk) = (Vec::new(), vec![0; CHUNK_BYTES]);
        loop {
            let size_bytes = match reader.read(&mut chunk) {
                Ok(0) => return Ok(unpacked),
                Ok(size_bytes) => size_bytes,
                Err(error) => return Err(self.damaged(&error, unpacked.len())),
            };
            if unpacked.len() + size_bytes > limit_bytes {
                return Err(ApiError::UnpacksTooLarge { encoding: self.name(), limit_bytes: limit_bytes as u64 });
            }
            grow(size_bytes)?;
            unpacked.extend_from_slice(&chunk[..size_bytes]);
        }
    }

    fn damaged(self, error: &io::Error, unpacked_bytes: usize) -> ApiError {
        let encoding = self.name();
        let cause = match error.kind() {
            io::ErrorKind::UnexpectedEof if unpacked_bytes == 0 => format!("ends too early, or is not {encoding}"),
            io::ErrorKind::UnexpectedEof => "ends too early".to_owned(),
            io::ErrorKind::Unsupported => error.to_string(),
            _ => format!("is damaged, or is not {encoding}"),
        };
        ApiError::DamagedEncoding { encoding, unpacked_bytes, cause }
    }
}

/// Content of all frames, one after another.
struct ZstdReader<'a> {
    packed: &'a [u8],
    decoder: FrameDecoder,
}

impl<'a> ZstdReader<'a> {
    fn new(packed: &'a [u8]) -> Self {
        let mut decoder = FrameDecoder::new();
        decoder.set_max_window_size(MAX_ZSTD_WINDOW_BYTES);
        Self { packed, decoder }
    }

    /// Begins the next frame of content; false after the last.
    fn begin_frame(&mut self) -> io::Result<bool> {
        while !self.packed.is_empty() {
            match self.decoder.init(&mut self.packed) {
                Ok(()) => return Ok(true),
                Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame { length, .. })) => {
                    let rest = self.packed.get(length as usize..);
                    self.packed = rest.ok_or(io::ErrorKind::UnexpectedEof)?;
                }
                Err(error) => return Err(zstd_error(&error)),
            }
        }
        Ok(false)
    }

    fn check_sum(&self) -> io::Result<()> {
        match self.decoder.get_checksum_from_data() {
            Some(sum) if self.decoder.get_calculated_checksum() != Some(sum) => Err(io::ErrorKind::InvalidData.into()),
            Some(_) | None => Ok(()),
        }
    }
}

impl Read for ZstdReader<'_> {
    fn read(&mut self, chunk: &mut [u8]) -> io::Result<usize> {
        while self.decoder.can_collect() == 0 {
            if self.decoder.is_finished() {
                self.check_sum()?;
                if !self.begin_frame()? {
                    return Ok(0);
                }
            } else {
                let one = BlockDecodingStrategy::UptoBlocks(1);
                self.decoder.decode_blocks(&mut self.packed, one).map_err(|error| zstd_error(&error))?;
            }
        }
        self.decoder.read(chunk)
    }
}

/// The error as one of input: only its kind is shown, except for a window that is too large.
fn zstd_error(error: &FrameDecoderError) -> io::Error {
    if let FrameDecoderError::WindowSizeTooBig { requested, max } = error {
        let message =
            format!("has a window of {requested} bytes, and {max} are allowed, as with level 19 and without --long");
        return io::Error::new(io::ErrorKind::Unsupported, message);
    }
    let mut cause: Option<&dyn std::error::Error> = Some(error);
    while let Some(error) = cause {
        if let Some(error) = error.downcast_ref::<io::Error>() {
            return error.kind().into();
        }
        cause = error.source();
    }
    io::ErrorKind::InvalidData.into()
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use axum::http::HeaderValue;
    use flate2::Compression;
    use flate2::write::GzEncoder;
    use ruzstd::encoding::{CompressionLevel, compress_to_vec};

    use super::*;

    const LIMIT: usize = 1 << 20;

    fn gzip(content: &[u8]) -> Vec<u8> {
        let mut writer = GzEncoder::new(Vec::new(), Compression::default());
        writer.write_all(content).and_then(|()| writer.finish()).expect("written to memory")
    }

    fn zstd(content: &[u8]) -> Vec<u8> {
        compress_to_vec(content, CompressionLevel::Fastest)
    }

    fn pack(encoding: ContentEncoding, content: &[u8]) -> Vec<u8> {
        match encoding {
            ContentEncoding::Gzip => gzip(content),
            ContentEncoding::Zstd => zstd(content),
        }
    }

    fn unpack(encoding: ContentEncoding, packed: &[u8]) -> Result<Vec<u8>, ApiError> {
        encoding.unpack(packed, LIMIT, |_| Ok(()))
    }

    fn of(values: &[&'static str]) -> Result<Option<ContentEncoding>, ApiError> {
        let mut headers = HeaderMap::new();
        for value in values {
            headers.append(header::CONTENT_ENCODING, HeaderValue::from_static(value));
        }
        ContentEncoding::of(&headers)
    }

    #[test]
    fn one_known_encoding_is_taken() {
        for (values, encoding) in [
            (&[][..], None),
            (&["identity"], None),
            (&["gzip"], Some(ContentEncoding::Gzip)),
            (&[" X-GZIP "], Some(ContentEncoding::Gzip)),
            (&["identity, zstd"], Some(ContentEncoding::Zstd)),
        ] {
            assert_eq!(of(values).expect("a known encoding"), encoding, "{values:?}");
        }
        for values in [&["br"][..], &["deflate"], &["gzip, gzip"], &["gzip", "zstd"], &["gzip;q=1"]] {
            assert!(matches!(of(values), Err(ApiError::WrongEncoding { .. })), "{values:?}");
        }
    }

    #[test]
    fn bodies_unpack_to_their_content_up_to_the_limit() {
        for encoding in [ContentEncoding::Gzip, ContentEncoding::Zstd] {
            let content: Vec<u8> = (0..LIMIT as u32).map(|at| (at % 251) as u8).collect();
            let packed = pack(encoding, &content);
            assert_eq!(unpack(encoding, &packed).expect("within the limit"), content);
            let parts = [pack(encoding, b"{ "), pack(encoding, b""), pack(encoding, b"}")].concat();
            assert_eq!(unpack(encoding, &parts).expect("several parts"), b"{ }");
            let more = [packed, pack(encoding, b"x")].concat();
            assert!(matches!(unpack(encoding, &more), Err(ApiError::UnpacksTooLarge { .. })), "{encoding:?}");
        }
    }

    #[test]
    fn a_body_that_unpacks_to_gigabytes_is_kept_up_to_the_limit_only() {
        let megabyte = vec![0; 1 << 20];
        for encoding in [ContentEncoding::Gzip, ContentEncoding::Zstd] {
            let bomb = pack(encoding, &megabyte).repeat(1 << 12);
            let mut kept_bytes = 0;
            let unpacked = encoding.unpack(&bomb, LIMIT, |size_bytes| {
                kept_bytes += size_bytes;
                Ok(())
            });
            assert!(matches!(unpacked, Err(ApiError::UnpacksTooLarge { .. })), "{encoding:?}");
            assert!(kept_bytes <= LIMIT, "{encoding:?}: {kept_bytes} bytes");
        }
    }

    #[test]
    fn unpacking_ends_when_there_is_no_room() {
        let full = |_| Err(ApiError::Busy { what: "bytes", limit: 0 });
        for encoding in [ContentEncoding::Gzip, ContentEncoding::Zstd] {
            let unpacked = encoding.unpack(&pack(encoding, b"{}"), LIMIT, full);
            assert!(matches!(unpacked, Err(ApiError::Busy { .. })), "{encoding:?}");
        }
    }

    #[test]
    fn every_cut_or_changed_body_is_damaged_or_unpacks() {
        let content: Vec<u8> = (0..600_u32).flat_map(|at| (at * at % 97).to_string().into_bytes()).collect();
        for encoding in [ContentEncoding::Gzip, ContentEncoding::Zstd] {
            let packed = pack(encoding, &content);
            for length in 1..packed.len() {
                let cut = unpack(encoding, &packed[..length]);
                let is_damaged =
                    matches!(&cut, Err(ApiError::DamagedEncoding { cause, .. }) if cause.starts_with("ends too early"));
                assert!(is_damaged, "{encoding:?} cut to {length} bytes: {cut:?}");
            }
            let mut damaged = 0;
            for (at, bit) in (0..packed.len()).flat_map(|at| (0..8).map(move |bit| (at, bit))) {
                let mut changed = packed.clone();
                changed[at] ^= 1 << bit;
                match unpack(encoding, &changed) {
                    Err(ApiError::DamagedEncoding { .. }) => damaged += 1,
                    // Some bits change nothing that is unpacked, such as the time in a header of gzip.
                    Ok(_) | Err(ApiError::UnpacksTooLarge { .. }) => {}
                    Err(error) => panic!("{encoding:?}: byte {at}, bit {bit}: {error}"),
                }
            }
            assert!(damaged > packed.len() * 7, "{encoding:?}: only {damaged} of {} bits", packed.len() * 8);
            assert!(unpack(encoding, &[&packed[..], b"{}"].concat()).is_err(), "{encoding:?} with more after it");
        }
    }

    #[test]
    fn a_window_above_the_limit_is_rejected_with_its_cure() {
        // A frame's magic number, no flags, and a window of 2^24 bytes.
        let frame = [0x28, 0xb5, 0x2f, 0xfd, 0, 14 << 3, 1, 0, 0];
        let error = unpack(ContentEncoding::Zstd, &frame).expect_err("a large window");
        assert!(error.to_string().contains("8388608 are allowed, as with level 19"), "{error}");
        let frame = [0x28, 0xb5, 0x2f, 0xfd, 0, 13 << 3, 1, 0, 0];
        assert_eq!(unpack(ContentEncoding::Zstd, &frame).expect("an allowed window"), b"");
    }

    #[test]
    fn skippable_frames_are_skipped() {
        let skipped = [0x50, 0x2a, 0x4d, 0x18, 3, 0, 0, 0, 1, 2, 3];
        let body = [&skipped[..], &zstd(b"{}"), &skipped].concat();
        assert_eq!(unpack(ContentEncoding::Zstd, &body).expect("one frame of content"), b"{}");
        assert!(unpack(ContentEncoding::Zstd, &skipped[..10]).is_err(), "it ends too early");
    }
}
