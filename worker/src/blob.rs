//! Tile blobs: a fixed header, then the planes, each row by row from the top.
//!
//! ```text
//! "sdfb" · version · x · y · width · height · planes      u32, little-endian
//! planes × height × width                                 f32, little-endian
//! ```
//!
//! Uncompressed, so that a band of rows is read with one seek per plane; a blob lives for seconds. This module
//! does not interpret the pixels.

use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;

use proto::Rect;

use crate::renderer::TilePixels;

const MAGIC: [u8; 4] = *b"sdfb";
const VERSION: u32 = 1;
/// Bytes before the first plane.
pub const HEADER_BYTES: usize = 28;
/// Maximum number of planes: four of color, the light groups', the brightness levels', every layer, and the guides.
pub const MAX_PLANES: usize = 128;
/// Maximum number of pixels of a picture, and so of a tile.
const MAX_PIXELS: u64 = 1 << 28;

/// Size of a tile's blob, in bytes.
pub fn size_bytes(rect: Rect, planes: usize) -> u64 {
    HEADER_BYTES as u64 + rect.pixels() * planes as u64 * size_of::<f32>() as u64
}

/// Encodes a tile.
pub fn encode(pixels: &TilePixels) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(size_bytes(pixels.rect, pixels.planes.len()) as usize);
    write(pixels, &mut bytes).expect("writing to memory cannot fail");
    bytes
}

/// Writes a tile to a file.
pub fn write(pixels: &TilePixels, out: &mut impl Write) -> io::Result<()> {
    let Rect { x, y, width, height } = pixels.rect;
    let planes = u32::try_from(pixels.planes.len()).expect("planes are few");
    out.write_all(&MAGIC)?;
    for field in [VERSION, x, y, width, height, planes] {
        out.write_all(&field.to_le_bytes())?;
    }
    let mut bytes = Vec::new();
    for plane in &pixels.planes {
        for part in plane.chunks(1 << 14) {
            bytes.clear();
            bytes.extend(part.iter().flat_map(|sample| sample.to_le_bytes()));
            out.write_all(&bytes)?;
        }
    }
    Ok(())
}

/// Key of a blob: the BLAKE3 of its bytes, in hex.
pub fn hash(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// Reads a blob, completely or a band of rows at a time.
#[derive(Debug)]
pub struct BlobReader<R> {
    input: R,
    planes_start: u64,
    rect: Rect,
    planes: usize,
}

impl<R: Read + Seek> BlobReader<R> {
    /// Reads the header of the blob that starts at `start`.
    pub fn open_at(mut input: R, start: u64) -> Result<Self, BlobError> {
        let mut header = [0; HEADER_BYTES];
        input.seek(SeekFrom::Start(start))?;
        input.read_exact(&mut header).map_err(short_is_truncated)?;
        let (rect, planes) = parse_header(&header)?;
        Ok(Self { input, planes_start: start + HEADER_BYTES as u64, rect, planes })
    }

    /// The tile's pixels.
    pub fn rect(&self) -> Rect {
        self.rect
    }

    /// Number of planes.
    pub fn planes(&self) -> usize {
        self.planes
    }

    /// Reads rows of one plane as bytes, for [`floats_from_bytes`]. Rows are counted from the tile's top.
    ///
    /// # Panics
    ///
    /// Panics if the tile has no such plane or rows.
    pub fn read_rows(&mut self, plane: usize, rows: Range<u32>, bytes: &mut Vec<u8>) -> Result<(), BlobError> {
        assert!(plane < self.planes && rows.start <= rows.end && rows.end <= self.rect.height, "a tile's own rows");
        let row_bytes = u64::from(self.rect.width) * size_of::<f32>() as u64;
        let skipped = (plane as u64 * u64::from(self.rect.height) + u64::from(rows.start)) * row_bytes;
        self.input.seek(SeekFrom::Start(self.planes_start + skipped))?;
        bytes.resize(rows.len() * row_bytes as usize, 0);
        self.input.read_exact(bytes).map_err(short_is_truncated)
    }
}

/// Decodes a complete blob; a longer one is an error.
pub fn decode(bytes: &[u8]) -> Result<TilePixels, BlobError> {
    let header = bytes.first_chunk::<HEADER_BYTES>().ok_or(BlobError::Truncated)?;
    let (rect, planes) = parse_header(header)?;
    let expected = size_bytes(rect, planes);
    if (bytes.len() as u64) < expected {
        return Err(BlobError::Truncated);
    }
    if bytes.len() as u64 > expected {
        return Err(BlobError::TooLong { expected });
    }
    let plane_bytes = rect.pixels() as usize * size_of::<f32>();
    let planes = bytes[HEADER_BYTES..].chunks_exact(plane_bytes);
    let planes = planes.map(|plane| {
        let mut samples = vec![0.0; plane_bytes / size_of::<f32>()];
        floats_from_bytes(plane, &mut samples);
        samples
    });
    Ok(TilePixels { rect, planes: planes.collect() })
}

/// Converts a blob's bytes to samples.
pub fn floats_from_bytes(bytes: &[u8], samples: &mut [f32]) {
    for (sample, bytes) in samples.iter_mut().zip(bytes.as_chunks::<4>().0) {
        *sample = f32::from_le_bytes(*bytes);
    }
}

fn parse_header(header: &[u8; HEADER_BYTES]) -> Result<(Rect, usize), BlobError> {
    if header[..4] != MAGIC {
        return Err(BlobError::NotABlob);
    }
    let field = |index: usize| u32::from_le_bytes(header.as_chunks::<4>().0[index]);
    if field(1) != VERSION {
        return Err(BlobError::Version(field(1)));
    }
    let rect = Rect { x: field(2), y: field(3), width: field(4), height: field(5) };
    let planes = field(6) as usize;
    let inside = rect.x.checked_add(rect.width).is_some() && rect.y.checked_add(rect.height).is_some();
    let countable = rect.pixels() <= MAX_PIXELS && (1..=MAX_PLANES).contains(&planes);
    if rect.width == 0 || rect.height == 0 || !inside || !countable {
        return Err(BlobError::Shape { rect, planes });
    }
    Ok((rect, planes))
}

fn short_is_truncated(error: io::Error) -> BlobError {
    if error.kind() == io::ErrorKind::UnexpectedEof { BlobError::Truncated } else { BlobError::Io(error) }
}

/// Reason why a blob is invalid.
#[derive(Debug, thiserror::Error)]
pub enum BlobError {
    /// The magic bytes are wrong.
    #[error("it is not a tile blob")]
    NotABlob,
    /// The format's version is another one.
    #[error("its format is version {0}, not {VERSION}")]
    Version(u32),
    /// The header's sizes are impossible.
    #[error("its header is damaged: {rect:?} with {planes} planes")]
    Shape {
        /// Rectangle in the header.
        rect: Rect,
        /// Number of planes in the header.
        planes: usize,
    },
    /// The blob is too short.
    #[error("it is truncated")]
    Truncated,
    /// The blob is too long.
    #[error("it is longer than its {expected} bytes")]
    TooLong {
        /// Size according to its header.
        expected: u64,
    },
    /// It cannot be read.
    #[error("it could not be read")]
    Io(#[from] io::Error),
}
