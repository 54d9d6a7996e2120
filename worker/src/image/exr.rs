//! EXR: scene-linear, premultiplied, light half or float, other layers always float; scan lines in blocks of 16, each
//! compressed separately (ZIP).
//!
//! Written block by block through the crate's low-level API, so that the whole picture is never in memory. No
//! -0.0 and no NaN reaches a file.

use std::io::{Seek, SeekFrom, Write};
use std::ops::Range;

use ::half::f16;
use ::half::slice::HalfFloatSliceExt;
use exr::block::chunk::{Chunk, CompressedBlock, CompressedScanLineBlock, TileCoordinates};
use exr::block::writer::ChunksWriter;
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{self, AttributeValue, ChannelDescription, Chromaticities, LineOrder, SampleType, Text};
use exr::meta::header::{Header, LayerAttributes};
use rayon::prelude::*;
use scene::Precision;
use scene::mattes::Matte;

use super::PROVENANCE_KEYWORD;
use super::{EncodeThreads, ImageError, PictureSpec};
use crate::renderer::CancelFlag;
use crate::stitch::{RowBand, RowSource};

/// Rows compressed together, by the format.
const BLOCK_ROWS: u32 = 16;
/// Bytes before the header: the magic number, and the version.
const START_BYTES: usize = 8;
/// Memory limit of a band: a band has fewer blocks if it would take more.
const BAND_BYTES: u64 = 32 << 20;

/// Primaries and white point of the scene's light, as in sRGB: ITU-R BT.709, table 1.
const REC_709: Chromaticities =
    Chromaticities { red: Vec2(0.64, 0.33), green: Vec2(0.3, 0.6), blue: Vec2(0.15, 0.06), white: Vec2(0.3127, 0.329) };

/// Rows read at a time: two blocks for each thread, if memory allows.
pub fn band_rows(picture: &PictureSpec, threads: EncodeThreads) -> u32 {
    let row_bytes = u64::from(picture.width) * picture.channels.len() as u64 * size_of::<f32>() as u64;
    let fits = (BAND_BYTES / row_bytes) as u32 / BLOCK_ROWS * BLOCK_ROWS;
    let count = match threads {
        EncodeThreads::All => rayon::current_num_threads() as u32,
        EncodeThreads::One => 1,
    };
    count.saturating_mul(2 * BLOCK_ROWS).min(fits).max(BLOCK_ROWS)
}

/// Writes a picture, reading this many rows at a time, rounded up to whole blocks.
pub fn write(
    picture: &PictureSpec,
    threads: EncodeThreads,
    source: &mut dyn RowSource,
    out: &mut (impl Write + Seek),
    cancel: &CancelFlag,
    band_rows: u32,
) -> Result<(), ImageError> {
    let channels = Channels::new(picture);
    let header = channels.header(picture);
    let band_rows = band_rows.next_multiple_of(BLOCK_ROWS);
    let mut band = RowBand::new(picture.width, picture.channels.len());
    let mut refused = None;
    let written = exr::block::write(&mut *out, [header.clone()].into_iter().collect(), true, |meta, file| {
        let header = &meta.headers[0];
        for top in (0..picture.height).step_by(band_rows as usize) {
            let rows = top..top.saturating_add(band_rows).min(picture.height);
            if let Err(error) = pull(source, rows.clone(), &mut band, cancel) {
                refused = Some(error);
                return Err(exr::error::Error::Aborted);
            }
            let blocks: Vec<u32> = rows.step_by(BLOCK_ROWS as usize).collect();
            let compress = |&y: &u32| channels.compress(header, &band, y);
            let chunks: Vec<_> = match threads {
                EncodeThreads::All => blocks.par_iter().map(compress).collect(),
                EncodeThreads::One => blocks.iter().map(compress).collect(),
            };
            for (y, chunk) in blocks.into_iter().zip(chunks) {
                file.write_chunk((y / BLOCK_ROWS) as usize, chunk?)?;
            }
        }
        Ok(())
    });
    if let Some(error) = refused {
        return Err(error);
    }
    written?;
    sort_attributes(&header, out)
}

/// Writes the attributes that are in a hash map, and so in random order, again in the order of their names.
fn sort_attributes(header: &Header, out: &mut (impl Write + Seek)) -> Result<(), ImageError> {
    let mut attributes: Vec<_> = header.own_attributes.other.iter().collect();
    attributes.sort_by_key(|(name, _)| name.as_slice());
    let (mut sorted, mut all) = (Vec::new(), Vec::new());
    for (name, value) in attributes {
        attribute::write(name.as_slice(), value, &mut sorted)?;
    }
    header.write(&mut all)?;
    // They are the last of the header, before the byte that ends it.
    let start = START_BYTES + all.len() - 1 - sorted.len();
    let end = out.stream_position()?;
    out.seek(SeekFrom::Start(start as u64))?;
    out.write_all(&sorted)?;
    out.seek(SeekFrom::Start(end))?;
    Ok(())
}

fn pull(
    source: &mut dyn RowSource,
    rows: Range<u32>,
    band: &mut RowBand,
    cancel: &CancelFlag,
) -> Result<(), ImageError> {
    if cancel.is_cancelled() {
        return Err(ImageError::Cancelled);
    }
    Ok(source.read(rows, band)?)
}

/// Planes in the order of the file: by name.
struct Channels<'a>(Vec<Channel<'a>>);

struct Channel<'a> {
    name: &'a str,
    plane: usize,
    sample: SampleType,
}

impl<'a> Channels<'a> {
    fn new(picture: &'a PictureSpec) -> Self {
        let color = match picture.precision {
            Precision::Half => SampleType::F16,
            Precision::Float => SampleType::F32,
        };
        let planes = picture.channels.iter().enumerate();
        let sample = |plane: usize| if plane < picture.light_channels { color } else { SampleType::F32 };
        let mut channels: Vec<_> = planes.map(|(plane, name)| Channel { name, plane, sample: sample(plane) }).collect();
        channels.sort_by_key(|channel| channel.name);
        Self(channels)
    }

    fn header(&self, picture: &PictureSpec) -> Header {
        let size = Vec2(picture.width as usize, picture.height as usize);
        let channels =
            self.0.iter().map(|channel| ChannelDescription::new(text(channel.name), channel.sample, false)).collect();
        let mut attributes = LayerAttributes::default();
        let own = [(PROVENANCE_KEYWORD.to_owned(), picture.provenance.json())];
        let own = own.into_iter().chain(picture.mattes.iter().flat_map(Matte::attributes));
        attributes.other.extend(own.map(|(name, value)| (text(&name), AttributeValue::Text(text(&value)))));
        let metadata = picture.metadata;
        attributes.frames_per_second = Some(metadata.frames_per_second);
        attributes.world_to_camera = Some(metadata.world_to_camera);
        attributes.world_to_normalized_device = metadata.world_to_ndc;
        let mut header = Header::new(text(""), size, channels)
            .with_encoding(Compression::ZIP16, BlockDescription::ScanLines, LineOrder::Increasing)
            .with_attributes(attributes);
        header.shared_attributes.chromaticities = Some(REC_709);
        header
    }

    fn compress(&self, header: &Header, band: &RowBand, top: u32) -> exr::error::Result<Chunk> {
        let tile = TileCoordinates { tile_index: Vec2(0, (top / BLOCK_ROWS) as usize), level_index: Vec2(0, 0) };
        let section = header.get_absolute_block_pixel_coordinates(tile)?;
        let first = (top - band.rows().start) as usize;
        let mut bytes = Vec::with_capacity(section.size.area() * header.channels.bytes_per_pixel);
        let mut halves = Vec::new();
        for row in first..first + section.size.height() {
            for channel in &self.0 {
                append(band.row(channel.plane, row), channel.sample, &mut halves, &mut bytes);
            }
        }
        let compressed_pixels_le = header.compression.compress_image_section_to_le(header, bytes, section)?;
        let block = CompressedScanLineBlock { y_coordinate: section.position.y(), compressed_pixels_le };
        Ok(Chunk { layer_index: 0, compressed_block: CompressedBlock::ScanLine(block) })
    }
}

fn text(ascii: &str) -> Text {
    Text::new_or_panic(ascii)
}

/// Appends a row in native byte order, which the crate converts to the file's.
fn append(row: &[f32], sample: SampleType, halves: &mut Vec<f16>, bytes: &mut Vec<u8>) {
    match sample {
        SampleType::F16 => {
            to_halves(row, halves);
            bytes.extend(halves.iter().flat_map(|half| half.to_ne_bytes()));
        }
        SampleType::F32 => bytes.extend(row.iter().flat_map(|&value| canonical_float(value).to_ne_bytes())),
        SampleType::U32 => unreachable!("no channel is an integer"),
    }
}

/// Rounds a row to halves.
fn to_halves(row: &[f32], halves: &mut Vec<f16>) {
    let clean: Vec<f32> = row.iter().map(|&value| canonical_float(value)).collect();
    halves.resize(row.len(), f16::ZERO);
    halves.convert_from_f32_slice(&clean);
    // A half rounds small negatives to -0.0 again.
    halves.iter_mut().filter(|half| **half == f16::ZERO).for_each(|half| *half = f16::ZERO);
}

/// Bits of numbers as a file stores them with 16 bits.
pub fn half_bits(numbers: &[f32]) -> Vec<u16> {
    let mut halves = Vec::new();
    to_halves(numbers, &mut halves);
    halves.into_iter().map(f16::to_bits).collect()
}

/// Bits of numbers as a file stores them with 32 bits.
pub fn float_bits(numbers: &[f32]) -> Vec<u32> {
    numbers.iter().map(|&number| canonical_float(number).to_bits()).collect()
}

/// Replaces -0.0 and NaN by 0.
fn canonical_float(value: f32) -> f32 {
    if value.is_nan() { 0.0 } else { value + 0.0 }
}
