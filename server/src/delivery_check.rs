//! Checks what a worker delivers before it counts: the file's kind, size and dimensions, and the provenance in a
//! picture's header, against the job that asked for it.
//!
//! It reads headers only, and never a pixel: that a picture shows the right thing is found by rendering a share of
//! it again (see `queue/verification.rs`). The hash of what a remote worker uploads is checked when its bytes
//! arrive; that of a pool worker's file is not, because a pool worker is this program, under this user, and could
//! as well write to the database.

mod exr;
mod png;

use bytes::Bytes;
use proto::Rect;
use scene::{Bits, Format, JobAtFrame, Precision, Provenance};
use serde::{Deserialize, Serialize};

/// Number of bytes at a file's start that a check reads; the headers of this program's pictures are smaller.
pub(crate) const HEAD_BYTES: u64 = 160 << 10;
/// Number of bytes at a file's end that a check reads.
pub(crate) const TAIL_BYTES: u64 = 12;
/// Size of a blob's header, in bytes.
pub(crate) const BLOB_HEADER_BYTES: usize = 28;
/// Bytes that a picture may have in addition to twice its uncompressed pixels, and to [`ROW_BYTES`] for each row.
const PICTURE_OVERHEAD_BYTES: u64 = 256 << 10;
/// Bytes that a picture may have for each row in addition to its pixels: filters, and tables of blocks.
const ROW_BYTES: u64 = 64;

/// First and last bytes of a stored file, and its size.
#[derive(Clone, Debug)]
pub(crate) struct FileEnds {
    /// Size of the file.
    pub(crate) size_bytes: u64,
    /// Its first bytes, up to [`HEAD_BYTES`].
    pub(crate) head: Bytes,
    /// Its last bytes, up to [`TAIL_BYTES`].
    pub(crate) tail: Bytes,
}

/// Expected picture of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ExpectedPicture {
    width_px: u32,
    height_px: u32,
    format: PictureFormat,
    /// Provenance, as JSON.
    provenance: String,
}

/// Format of a picture, with what its header says about a pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum PictureFormat {
    Png {
        opaque: bool,
        bits: u8,
    },
    /// Channels, in the order of the file.
    Exr(Vec<ExrChannel>),
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
struct ExrChannel {
    name: String,
    sample: ExrSample,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
enum ExrSample {
    Half,
    Float,
}

impl ExrSample {
    fn bytes(self) -> u64 {
        match self {
            Self::Half => 2,
            Self::Float => 4,
        }
    }
}

impl ExpectedPicture {
    /// Picture of a job at a frame.
    pub(crate) fn new(at_frame: &JobAtFrame<'_>) -> Self {
        let image = at_frame.image();
        let film = image.film();
        let format = match image.format {
            Format::Png => PictureFormat::Png {
                opaque: !at_frame.scene().is_transparent(),
                bits: match image.bits {
                    Bits::Eight => 8,
                    Bits::Sixteen => 16,
                },
            },
            Format::Exr => {
                let color = match image.precision {
                    Precision::Half => ExrSample::Half,
                    Precision::Float => ExrSample::Float,
                };
                let channels = film.channels().into_iter().enumerate();
                let mut channels: Vec<_> = channels
                    .map(|(index, name)| ExrChannel {
                        name: name.into_owned(),
                        sample: if index < film.light_channels() { color } else { ExrSample::Float },
                    })
                    .collect();
                channels.sort();
                PictureFormat::Exr(channels)
            }
        };
        let provenance = Provenance::new(at_frame).json();
        Self { width_px: film.width, height_px: film.height, format, provenance }
    }

    /// Size in memory, in bytes, about.
    pub(crate) fn bytes(&self) -> usize {
        let channels = match &self.format {
            PictureFormat::Png { .. } => 0,
            PictureFormat::Exr(channels) => {
                channels.iter().map(|channel| size_of::<ExrChannel>() + channel.name.len()).sum()
            }
        };
        self.provenance.len() + channels
    }

    /// Checks the ends of a file. The error says what is wrong with it.
    pub(crate) fn check(&self, file: &FileEnds) -> Result<(), String> {
        let max_bytes = self.max_bytes();
        if file.size_bytes > max_bytes {
            return Err(format!("the picture has {} bytes, but may have at most {max_bytes}", file.size_bytes));
        }
        match &self.format {
            PictureFormat::Png { opaque, bits } => png::check(file, self, *opaque, *bits),
            PictureFormat::Exr(channels) => exr::check(file, self, channels),
        }
    }

    /// Maximum plausible size.
    fn max_bytes(&self) -> u64 {
        let pixel_bytes = match &self.format {
            PictureFormat::Png { opaque, bits } => (if *opaque { 3 } else { 4 }) * u64::from(bits / 8),
            PictureFormat::Exr(channels) => channels.iter().map(|channel| channel.sample.bytes()).sum(),
        };
        max_picture_bytes(pixel_bytes, self.width_px, self.height_px)
    }

    fn expect_size(&self, width_px: u32, height_px: u32) -> Result<(), String> {
        if (width_px, height_px) == (self.width_px, self.height_px) {
            return Ok(());
        }
        Err(format!("the picture has {width_px}×{height_px} pixels instead of {}×{}", self.width_px, self.height_px))
    }

    fn expect_provenance(&self, found: Option<&[u8]>) -> Result<(), String> {
        match found {
            Some(found) if found == self.provenance.as_bytes() => Ok(()),
            Some(_) => Err("the picture's provenance is that of another scene, frame or release".to_owned()),
            None => Err("the picture has no provenance".to_owned()),
        }
    }
}

/// Maximum plausible size of a picture: twice that of its pixels, because compression makes noise a little larger.
pub(crate) fn max_picture_bytes(pixel_bytes: u64, width_px: u32, height_px: u32) -> u64 {
    2 * pixel_bytes * Rect::full(width_px, height_px).pixels()
        + ROW_BYTES * u64::from(height_px)
        + PICTURE_OVERHEAD_BYTES
}

/// Checks the ends of a tile's blob: see `worker::blob` for its format.
pub(crate) fn check_blob(file: &FileEnds, rect: Rect, pixel_bytes: u32) -> Result<(), String> {
    let expected_bytes = BLOB_HEADER_BYTES as u64 + rect.pixels() * u64::from(pixel_bytes);
    if file.size_bytes != expected_bytes {
        return Err(format!("the tile's blob has {} bytes instead of {expected_bytes}", file.size_bytes));
    }
    let fields = [1, rect.x, rect.y, rect.width, rect.height, pixel_bytes / 4];
    let mut header = b"sdfb".to_vec();
    header.extend(fields.iter().flat_map(|field| field.to_le_bytes()));
    if file.head.starts_with(&header) { Ok(()) } else { Err("the blob is not one of this tile".to_owned()) }
}

/// Splits off the first `count` bytes.
fn take<'a>(bytes: &mut &'a [u8], count: usize) -> Option<&'a [u8]> {
    let (taken, rest) = bytes.split_at_checked(count)?;
    *bytes = rest;
    Some(taken)
}

/// Splits off the bytes before the next zero, and the zero.
fn take_until_zero<'a>(bytes: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = bytes.iter().position(|byte| *byte == 0)?;
    let taken = take(bytes, length)?;
    take(bytes, 1)?;
    Some(taken)
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn ends(bytes: &[u8]) -> FileEnds {
        let tail = bytes.len().saturating_sub(TAIL_BYTES as usize);
        FileEnds {
            size_bytes: bytes.len() as u64,
            head: Bytes::copy_from_slice(&bytes[..bytes.len().min(HEAD_BYTES as usize)]),
            tail: Bytes::copy_from_slice(&bytes[tail..]),
        }
    }

    /// Expected picture of a job of 8×6 pixels; as EXR it has the layer `depth`.
    pub(super) fn expected(format: &str) -> ExpectedPicture {
        let layers = if format == "exr" { r#", "layers": ["depth"]"# } else { "" };
        let text = format!(
            r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 3], "look_at": [0, 0, 0] }},
                "objects": [{{ "shape": {{ "sphere": {{ "radius": 1 }} }} }}] }},
                "image": {{ "width": 8, "height": 6, "format": "{format}"{layers} }} }}"#
        );
        let job = scene::parse(text.as_bytes()).expect("a valid job");
        ExpectedPicture::new(&job.at(0).expect("a valid frame"))
    }

    #[test]
    fn a_blob_is_that_of_its_tile() {
        let rect = Rect { x: 32, y: 0, width: 2, height: 1 };
        let mut blob = b"sdfb".to_vec();
        blob.extend([1_u32, 32, 0, 2, 1, 4].iter().flat_map(|field| field.to_le_bytes()));
        blob.resize(28 + 2 * 16, 0);
        assert_eq!(check_blob(&ends(&blob), rect, 16), Ok(()));
        let error = check_blob(&ends(&blob), Rect { x: 0, ..rect }, 16).expect_err("another tile");
        assert!(error.contains("not one of this tile"), "{error}");
        let error = check_blob(&ends(&blob[1..]), rect, 16).expect_err("too short");
        assert!(error.contains("59 bytes instead of 60"), "{error}");
        blob[0] = b'<';
        check_blob(&ends(&blob), rect, 16).expect_err("no blob");
    }
}
