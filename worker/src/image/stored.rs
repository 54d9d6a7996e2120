//! Reads a stored picture back: the exact value of every channel of every pixel, and its provenance; and computes the
//! values that a rendered tile has in such a file.
//!
//! Nothing is converted here: values are compared bit by bit, and only its values show whether another program wrote a file.

use std::io::{Cursor, ErrorKind};
use std::ops::Range;

use ::exr::image::FlatSamples;
use ::exr::meta::attribute::AttributeValue;
use ::exr::meta::{BlockDescription, MetaData};
use ::exr::prelude::{ReadChannels, ReadLayers, Vec2, read};
use ::half::f16;
use ::png::{BitDepth, ColorType, Decoder, Limits, Transformations};
use scene::limits::{MAX_EDGE_PX, MAX_PIXELS};
use scene::{Bits, Format, Precision};

use super::{EncodeThreads, ImageError, PROVENANCE_KEYWORD, PictureSpec, Provenance, exr, png};
use crate::renderer::{CancelFlag, TilePixels};
use crate::stitch::{RowBand, RowSource, StitchError};

/// Maximum memory that the decoder of a PNG may take for chunks.
const MAX_CHUNK_BYTES: usize = 64 << 20;
/// First bytes of a PNG.
const PNG_MAGIC: [u8; 4] = [0x89, b'P', b'N', b'G'];
/// First bytes of an EXR.
const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Kind of a channel's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ValueKind {
    /// From 0 to 255.
    Byte,
    /// From 0 to 65,535.
    Word,
    /// 16-bit floating point.
    Half,
    /// 32-bit floating point.
    Float,
    /// An unsigned integer, which sdfarm never writes.
    Integer,
}

impl ValueKind {
    /// The number that these bits are.
    pub fn number(self, bits: u32) -> f64 {
        match self {
            Self::Byte | Self::Word | Self::Integer => f64::from(bits),
            Self::Half => f64::from(f16::from_bits(bits as u16)),
            Self::Float => f64::from(f32::from_bits(bits)),
        }
    }
}

/// Bits of values, row by row from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Values {
    /// Of 8 bits.
    Bytes(Vec<u8>),
    /// Of 16 bits.
    Words(Vec<u16>),
    /// Of 32 bits.
    Longs(Vec<u32>),
}

impl Values {
    /// The bits of a value.
    pub fn bits(&self, index: usize) -> u32 {
        match self {
            Self::Bytes(values) => values[index].into(),
            Self::Words(values) => values[index].into(),
            Self::Longs(values) => values[index],
        }
    }

    /// Inverts a bit of a value; for tests of what finds that.
    pub fn flip(&mut self, index: usize, bit: u32) {
        match self {
            Self::Bytes(values) => values[index] ^= 1 << bit,
            Self::Words(values) => values[index] ^= 1 << bit,
            Self::Longs(values) => values[index] ^= 1 << bit,
        }
    }

    /// Bits of one value.
    pub fn width_bits(&self) -> u32 {
        match self {
            Self::Bytes(_) => 8,
            Self::Words(_) => 16,
            Self::Longs(_) => 32,
        }
    }
}

/// A channel of a picture or of a tile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChannelValues {
    /// Its name, `R` for example.
    pub name: String,
    /// Kind of its values.
    pub kind: ValueKind,
    /// Its values.
    pub values: Values,
}

/// Provenance as a file has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FoundProvenance {
    /// It has none.
    Missing,
    /// It has something else in its place.
    Unreadable,
    /// It has this one.
    Known(Provenance),
}

/// A picture that was read from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredPicture {
    /// The file's format.
    pub format: Format,
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
    /// Its channels: a PNG's are R G B A, an EXR's are ordered by name.
    pub channels: Vec<ChannelValues>,
    /// Its provenance.
    pub provenance: FoundProvenance,
}

/// Reason why a picture cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum UnreadablePicture {
    /// The first bytes belong to no picture.
    #[error("it is neither a PNG nor an EXR")]
    NotAPicture,
    /// It ends early.
    #[error("it is truncated: it ends before its last pixel")]
    Truncated,
    /// Its content is invalid.
    #[error("it is damaged: {0}")]
    Damaged(String),
    /// It has a size that sdfarm never writes.
    #[error("its size is {width}×{height}, which sdfarm never writes")]
    Size {
        /// Width, in pixels.
        width: u64,
        /// Height, in pixels.
        height: u64,
    },
}

impl StoredPicture {
    /// Reads a file.
    pub fn read(file: &[u8]) -> Result<Self, UnreadablePicture> {
        match file.first_chunk() {
            Some(&PNG_MAGIC) => read_png(file),
            Some(&EXR_MAGIC) => read_exr(file),
            Some(_) | None => Err(UnreadablePicture::NotAPicture),
        }
    }

    /// Writes the file that sdfarm would write for exactly these values. The picture must have this size and these
    /// channels ([`Self::misfit`]).
    pub fn rewrite(&self, picture: &PictureSpec) -> Result<Vec<u8>, ImageError> {
        let mut file = Cursor::new(Vec::new());
        let cancel = CancelFlag::new();
        match self.format {
            Format::Png => png::write_rows(picture, |y, row| self.append_row(y, row), &mut file)?,
            Format::Exr => {
                let rows = exr::band_rows(picture, EncodeThreads::One);
                let mut source = StoredRows { stored: self, picture };
                exr::write(picture, EncodeThreads::One, &mut source, &mut file, &cancel, rows)?;
            }
        }
        Ok(file.into_inner())
    }

    /// Appends a row as a PNG has it.
    fn append_row(&self, y: u32, row: &mut Vec<u8>) {
        let start = y as usize * self.width as usize;
        for index in start..start + self.width as usize {
            for channel in &self.channels {
                match &channel.values {
                    Values::Bytes(values) => row.push(values[index]),
                    Values::Words(values) => row.extend(values[index].to_be_bytes()),
                    Values::Longs(values) => row.extend(values[index].to_be_bytes()),
                }
            }
        }
    }

    /// How the size or the channels differ from a picture's, in words; `None` if they do not.
    pub fn misfit(&self, picture: &PictureSpec) -> Option<String> {
        if self.format != picture.format {
            let name = |format| if format == Format::Png { "a PNG" } else { "an EXR" };
            return Some(format!("it is {}, and the job makes {}", name(self.format), name(picture.format)));
        }
        if (self.width, self.height) != (picture.width, picture.height) {
            return Some(format!(
                "it has {}×{} pixels, and the job makes {}×{}",
                self.width, self.height, picture.width, picture.height
            ));
        }
        let described = |channels: &mut dyn Iterator<Item = (&str, ValueKind)>| {
            let list: Vec<String> = channels.map(|(name, kind)| format!("{name} {kind:?}").to_lowercase()).collect();
            list.join(", ")
        };
        let wanted = layout(picture);
        let found = described(&mut self.channels.iter().map(|channel| (channel.name.as_str(), channel.kind)));
        let wanted = described(&mut wanted.iter().map(|(name, kind, _)| (*name, *kind)));
        (found != wanted).then(|| format!("its channels are {found}, and the job makes {wanted}"))
    }

    /// The same picture without a channel of alpha in which every pixel is opaque, and with red, green and blue where
    /// there is only gray: other programs add and remove these.
    pub fn normalized(mut self, picture: &PictureSpec) -> Self {
        if self.format != Format::Png {
            return self;
        }
        if let Some(gray) = self.channels.iter().position(|channel| channel.name == "Y") {
            let gray = self.channels.remove(gray);
            let colors = ["R", "G", "B"].map(|name| ChannelValues { name: name.to_owned(), ..gray.clone() });
            self.channels.splice(0..0, colors);
        }
        let alpha = self.channels.iter().position(|channel| channel.name == "A");
        let is_opaque = |values: &Values| match values {
            Values::Bytes(values) => values.iter().all(|&value| value == u8::MAX),
            Values::Words(values) => values.iter().all(|&value| value == u16::MAX),
            Values::Longs(_) => false,
        };
        match alpha {
            Some(alpha) if picture.opaque && is_opaque(&self.channels[alpha].values) => {
                self.channels.remove(alpha);
            }
            None if !picture.opaque => {
                let like = self.channels.first().map(|channel| (channel.kind, channel.values.clone()));
                if let Some((kind, values)) = like {
                    let values = match values {
                        Values::Bytes(values) => Values::Bytes(vec![u8::MAX; values.len()]),
                        Values::Words(values) => Values::Words(vec![u16::MAX; values.len()]),
                        Values::Longs(values) => Values::Longs(values),
                    };
                    self.channels.push(ChannelValues { name: "A".to_owned(), kind, values });
                }
            }
            Some(_) | None => {}
        }
        self
    }
}

/// Name, kind and plane of each channel of a picture's file, in their order.
fn layout(picture: &PictureSpec) -> Vec<(&str, ValueKind, usize)> {
    match picture.format {
        Format::Png => {
            let kind = match picture.bits {
                Bits::Eight => ValueKind::Byte,
                Bits::Sixteen => ValueKind::Word,
            };
            let count = if picture.opaque { 3 } else { 4 };
            ["R", "G", "B", "A"].into_iter().zip(0..).map(|(name, plane)| (name, kind, plane)).take(count).collect()
        }
        Format::Exr => {
            let color = match picture.precision {
                Precision::Half => ValueKind::Half,
                Precision::Float => ValueKind::Float,
            };
            let planes = picture.channels.iter().zip(0..);
            let kind = |plane: usize| if plane < picture.light_channels { color } else { ValueKind::Float };
            let mut channels: Vec<_> = planes.map(|(name, plane)| (&**name, kind(plane), plane)).collect();
            channels.sort_by_key(|(name, ..)| *name);
            channels
        }
    }
}

/// Values that a tile has in the file of its picture.
pub fn tile_values(picture: &PictureSpec, tile: &TilePixels) -> Result<Vec<ChannelValues>, ImageError> {
    let layout = layout(picture);
    let planes: Vec<Values> = match picture.format {
        Format::Png => {
            let bytes = png::tile_bytes(picture, tile)?;
            let plane = |index: usize| match picture.bits {
                Bits::Eight => Values::Bytes(bytes.iter().skip(index).step_by(layout.len()).copied().collect()),
                Bits::Sixteen => {
                    let words = bytes.as_chunks::<2>().0.iter().skip(index).step_by(layout.len());
                    Values::Words(words.map(|word| u16::from_be_bytes(*word)).collect())
                }
            };
            (0..layout.len()).map(plane).collect()
        }
        Format::Exr => {
            let plane = |&(_, kind, plane): &(_, ValueKind, usize)| match kind {
                ValueKind::Half => Values::Words(exr::half_bits(&tile.planes[plane])),
                _ => Values::Longs(exr::float_bits(&tile.planes[plane])),
            };
            layout.iter().map(plane).collect()
        }
    };
    let channels = layout.iter().zip(planes);
    Ok(channels.map(|(&(name, kind, _), values)| ChannelValues { name: name.to_owned(), kind, values }).collect())
}

/// Rows of an EXR that was read.
struct StoredRows<'a> {
    stored: &'a StoredPicture,
    picture: &'a PictureSpec,
}

impl RowSource for StoredRows<'_> {
    fn read(&mut self, rows: Range<u32>, band: &mut RowBand) -> Result<(), StitchError> {
        let width = self.stored.width as usize;
        band.reset(rows.clone());
        for (channel, (.., plane)) in self.stored.channels.iter().zip(layout(self.picture)) {
            for y in rows.clone() {
                let start = y as usize * width;
                for (index, to) in (start..).zip(band.row_mut(plane, (y - rows.start) as usize)) {
                    let bits = channel.values.bits(index);
                    *to = match channel.kind {
                        ValueKind::Half => f16::from_bits(bits as u16).to_f32(),
                        _ => f32::from_bits(bits),
                    };
                }
            }
        }
        Ok(())
    }
}

fn check_size(width: u64, height: u64) -> Result<(), UnreadablePicture> {
    let is_valid = width.max(height) <= u64::from(MAX_EDGE_PX) && width * height <= MAX_PIXELS && width * height > 0;
    if is_valid { Ok(()) } else { Err(UnreadablePicture::Size { width, height }) }
}

fn found(text: Option<&str>) -> FoundProvenance {
    match text.map(serde_json::from_str) {
        None => FoundProvenance::Missing,
        Some(Err(_)) => FoundProvenance::Unreadable,
        Some(Ok(provenance)) => FoundProvenance::Known(provenance),
    }
}

fn read_png(file: &[u8]) -> Result<StoredPicture, UnreadablePicture> {
    let mut decoder = Decoder::new_with_limits(Cursor::new(file), Limits { bytes: MAX_CHUNK_BYTES });
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(png_error)?;
    let (width, height) = (reader.info().width, reader.info().height);
    check_size(width.into(), height.into())?;
    let size =
        reader.output_buffer_size().ok_or(UnreadablePicture::Size { width: width.into(), height: height.into() })?;
    let mut bytes = vec![0; size];
    let frame = reader.next_frame(&mut bytes).map_err(png_error)?;
    reader.finish().map_err(png_error)?;
    let names: &[&str] = match frame.color_type {
        ColorType::Grayscale => &["Y"],
        ColorType::GrayscaleAlpha => &["Y", "A"],
        ColorType::Rgb => &["R", "G", "B"],
        ColorType::Rgba => &["R", "G", "B", "A"],
        ColorType::Indexed => return Err(UnreadablePicture::Damaged("its palette is missing".to_owned())),
    };
    let channel = |(index, name): (usize, &&str)| {
        let (kind, values) = if frame.bit_depth == BitDepth::Sixteen {
            let words = bytes.as_chunks::<2>().0.iter().skip(index).step_by(names.len());
            (ValueKind::Word, Values::Words(words.map(|word| u16::from_be_bytes(*word)).collect()))
        } else {
            (ValueKind::Byte, Values::Bytes(bytes.iter().skip(index).step_by(names.len()).copied().collect()))
        };
        ChannelValues { name: (*name).to_owned(), kind, values }
    };
    let channels = names.iter().enumerate().map(channel).collect();
    let info = reader.info();
    let in_itxt = info.utf8_text.iter().find(|text| text.keyword == PROVENANCE_KEYWORD);
    let in_text = info.uncompressed_latin1_text.iter().find(|text| text.keyword == PROVENANCE_KEYWORD);
    let text = in_itxt.and_then(|text| text.get_text().ok()).or_else(|| in_text.map(|text| text.text.clone()));
    Ok(StoredPicture { format: Format::Png, width, height, channels, provenance: found(text.as_deref()) })
}

fn png_error(error: ::png::DecodingError) -> UnreadablePicture {
    match error {
        ::png::DecodingError::IoError(error) if error.kind() == ErrorKind::UnexpectedEof => {
            UnreadablePicture::Truncated
        }
        other => UnreadablePicture::Damaged(other.to_string()),
    }
}

fn read_exr(file: &[u8]) -> Result<StoredPicture, UnreadablePicture> {
    let meta = MetaData::read_from_buffered(Cursor::new(file), false).map_err(exr_error)?;
    // The reader allocates what the header announces.
    for header in &meta.headers {
        let mut sizes = vec![header.layer_size];
        if let BlockDescription::Tiles(tiles) = header.blocks {
            sizes.push(tiles.tile_size);
        }
        for Vec2(width, height) in sizes {
            check_size(width as u64, height as u64)?;
        }
    }
    let picture = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(file))
        .map_err(exr_error)?;
    let layer = picture.layer_data;
    let (width, height) = (layer.size.width() as u32, layer.size.height() as u32);
    let channels = layer.channel_data.list.into_iter().map(|channel| {
        let (kind, values) = match channel.sample_data {
            FlatSamples::F16(values) => {
                (ValueKind::Half, Values::Words(values.into_iter().map(f16::to_bits).collect()))
            }
            FlatSamples::F32(values) => {
                (ValueKind::Float, Values::Longs(values.into_iter().map(f32::to_bits).collect()))
            }
            FlatSamples::U32(values) => (ValueKind::Integer, Values::Longs(values)),
        };
        ChannelValues { name: channel.name.to_string(), kind, values }
    });
    let mut channels: Vec<_> = channels.collect();
    channels.sort_by(|left, right| left.name.cmp(&right.name));
    let attributes = layer.attributes.other.iter().chain(&picture.attributes.other);
    let mut texts = attributes.filter(|(name, _)| *name == PROVENANCE_KEYWORD);
    let text = texts.find_map(|(_, value)| match value {
        AttributeValue::Text(text) => Some(text.to_string()),
        _ => None,
    });
    Ok(StoredPicture { format: Format::Exr, width, height, channels, provenance: found(text.as_deref()) })
}

fn exr_error(error: ::exr::error::Error) -> UnreadablePicture {
    match error {
        ::exr::error::Error::Io(error) if error.kind() == ErrorKind::UnexpectedEof => UnreadablePicture::Truncated,
        other => UnreadablePicture::Damaged(other.to_string()),
    }
}
