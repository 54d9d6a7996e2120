//! Layers and pixel values of a stored picture: PNG or EXR, read block by block, so that it is never in memory as a whole.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, bail};
use exr::block::BlockIndex;
use exr::block::reader::ChunksReader;
use exr::meta::MetaData;
use exr::meta::attribute::SampleType;
use exr::prelude::{Vec2, f16};
use png::Decoder;
use proto::preview_helper::{
    AboutPicture, HelperPicture, LayersView, PictureLayer, PixelView, StoredAnswer, StoredLayer,
};
use scene::Layer;
use scene::color::linear_from_srgb;

use crate::layer_picture;
use crate::thumbnail::{self, check_exr_size, limits, png_layout};

/// Maximum number of rows of a layer's picture.
const MAX_ROWS: u32 = 4096;
/// Suffix of the media type of each format.
const PNG: &str = "png";
const EXR: &str = "exr";

/// Stored picture, by its format.
enum Stored {
    Png(BufReader<File>),
    Exr(BufReader<File>),
}

impl Stored {
    fn open(file: &Path) -> anyhow::Result<Self> {
        let mut input = BufReader::new(File::open(file)?);
        let mut magic = [0; 4];
        input.read_exact(&mut magic)?;
        input.rewind()?;
        match magic {
            thumbnail::PNG_MAGIC => Ok(Self::Png(input)),
            thumbnail::EXR_MAGIC => {
                check_exr_size(&mut input)?;
                Ok(Self::Exr(input))
            }
            _ => bail!("it is neither PNG nor EXR"),
        }
    }
}

/// Context of an error about a file.
fn unreadable(file: &Path) -> String {
    format!("could not read the stored picture {}", file.display())
}

/// Lists the layers of a picture.
pub(super) fn layers(file: &Path) -> anyhow::Result<Vec<u8>> {
    let view = view(file).with_context(|| unreadable(file))?;
    Ok(serde_json::to_vec(&StoredAnswer::Layers(view))?)
}

fn view(file: &Path) -> anyhow::Result<LayersView> {
    Ok(match Stored::open(file)? {
        Stored::Png(input) => {
            let reader = Decoder::new_with_limits(input, limits()).read_info()?;
            let (width, height) = (reader.info().width, reader.info().height);
            LayersView { layers: vec![StoredLayer::Listed(PictureLayer::Color)], width, height, format: PNG.to_owned() }
        }
        Stored::Exr(mut input) => {
            let meta = MetaData::read_from_buffered(&mut input, false)?;
            let header = meta.headers.first().context("it has no header")?;
            let names: Vec<String> = header.channels.list.iter().map(|channel| channel.name.to_string()).collect();
            let Vec2(width, height) = header.layer_size;
            let layers = StoredLayer::of_channels(&names);
            LayersView { layers, width: width as u32, height: height as u32, format: EXR.to_owned() }
        }
    })
}

/// Draws a layer as a PNG of at most this width; an exposure, in stops, applies to colors.
pub(super) fn draw(file: &Path, layer: &StoredLayer, width_px: u32, exposure: f32) -> anyhow::Result<Vec<u8>> {
    let view = view(file).with_context(|| unreadable(file))?;
    if !view.layers.contains(layer) {
        return Ok(serde_json::to_vec(&StoredAnswer::NoLayer(view.layers))?);
    }
    let values = match layer {
        StoredLayer::Listed(PictureLayer::Noisy) | StoredLayer::Light(_) => None,
        StoredLayer::Listed(layer) => layer.of_exr(),
    };
    let picture = match values {
        None => {
            let png = thumbnail::draw(file, layer, width_px, exposure)?;
            let rendered_px = width_px.min(view.width);
            HelperPicture { about: AboutPicture { rendered_px, samples: 0, range: [Vec::new(), Vec::new()] }, png }
        }
        Some(layer) => of_layer(file, layer, width_px, &view).with_context(|| unreadable(file))?,
    };
    Ok(picture.encode()?)
}

/// Shows the values of the pixel in the middle of each pixel of the picture: a mean of depths or of objects would be
/// one that nothing has.
fn of_layer(file: &Path, layer: Layer, width_px: u32, view: &LayersView) -> anyhow::Result<HelperPicture> {
    let Stored::Exr(input) = Stored::open(file)? else { bail!("it is no EXR any more") };
    let not_too_high = u64::from(view.width) * u64::from(MAX_ROWS) / u64::from(view.height.max(1));
    let columns = width_px.min(view.width).min(u32::try_from(not_too_high).unwrap_or(u32::MAX).max(1));
    let rows = (u64::from(view.height) * u64::from(columns)).div_ceil(u64::from(view.width.max(1)));
    let rows = u32::try_from(rows)?.clamp(1, view.height.min(MAX_ROWS));
    let middles = |count: u32, of: u32| -> Vec<usize> {
        (0..u64::from(count)).map(|n| ((2 * n + 1) * u64::from(of) / (2 * u64::from(count))) as usize).collect()
    };
    let (xs, ys) = (middles(columns, view.width), middles(rows, view.height));
    let mut planes = vec![vec![0.0; columns as usize * rows as usize]; layer.channels().len()];
    let is_wanted =
        |block: Range<usize>| ys.get(ys.partition_point(|&y| y < block.start)).is_some_and(|&y| y < block.end);
    each_line(input, is_wanted, &mut |channel, [left, y], samples| {
        let plane = layer.channels().iter().position(|name| *name == channel);
        let (Some(plane), Ok(row)) = (plane, ys.binary_search(&y)) else { return };
        let first = xs.partition_point(|&x| x < left);
        let columns = xs.iter().enumerate().skip(first).take_while(|(_, x)| **x < left + samples.len());
        for (column, x) in columns {
            planes[plane][row * xs.len() + column] = samples[x - left];
        }
    })?;
    layer_picture::shown(layer, &planes, [columns, rows]).encode(columns, 0)
}

/// Reads the values of a pixel.
pub(super) fn pixel(file: &Path, x: u32, y: u32) -> anyhow::Result<Vec<u8>> {
    let view = view(file).with_context(|| unreadable(file))?;
    let answer = if x >= view.width || y >= view.height {
        StoredAnswer::Outside { width: view.width, height: view.height }
    } else {
        StoredAnswer::Pixel(pixel_of(file, x, y).with_context(|| unreadable(file))?)
    };
    Ok(serde_json::to_vec(&answer)?)
}

fn pixel_of(file: &Path, x: u32, y: u32) -> anyhow::Result<PixelView> {
    let finite = |value: f32| value.is_finite().then_some(value);
    match Stored::open(file)? {
        Stored::Png(input) => {
            let mut reader = Decoder::new_with_limits(input, limits()).read_info()?;
            let layout = png_layout(&reader)?;
            for _ in 0..y {
                reader.next_row()?.context("it ends early")?;
            }
            let row = reader.next_row()?.context("it ends early")?;
            let bytes = layout.channels * layout.bytes;
            let pixel =
                row.data().get(x as usize * bytes..).and_then(|rest| rest.get(..bytes)).context("it ends early")?;
            let values: Vec<f32> = (0..layout.channels).map(|channel| layout.unit(pixel, channel)).collect();
            let named = |of: fn(f32) -> f32, count: usize| -> BTreeMap<String, Option<f32>> {
                ["R", "G", "B", "A"]
                    .iter()
                    .zip(&values)
                    .take(count)
                    .map(|(name, &v)| ((*name).to_owned(), finite(of(v))))
                    .collect()
            };
            Ok(PixelView { x, y, values: named(|value| value, 4), linear: Some(named(linear_from_srgb, 3)) })
        }
        Stored::Exr(input) => {
            let (column, row) = (x as usize, y as usize);
            let mut values = BTreeMap::new();
            each_line(input, |rows| rows.contains(&row), &mut |channel, [left, y], samples| {
                if let (true, Some(&value)) = (y == row, column.checked_sub(left).and_then(|at| samples.get(at))) {
                    values.insert(channel.to_owned(), finite(value));
                }
            })?;
            Ok(PixelView { x, y, values, linear: None })
        }
    }
}

/// Calls a function with each line of an EXR's blocks in which `is_wanted` is true for the rows: the channel's name,
/// column and row of its first sample, and the samples.
fn each_line(
    input: BufReader<File>,
    is_wanted: impl Fn(Range<usize>) -> bool,
    visit: &mut impl FnMut(&str, [usize; 2], &[f32]),
) -> anyhow::Result<()> {
    let reader = exr::block::read(input, false)?;
    let in_rows = |block: &BlockIndex| is_wanted(block.pixel_position.1..block.pixel_position.1 + block.pixel_size.1);
    let is_of_first = |block: &BlockIndex| block.layer == 0 && block.level == Vec2(0, 0);
    let chunks = reader.filter_chunks(false, |_, _, block| is_of_first(&block) && in_rows(&block))?;
    let mut blocks = chunks.sequential_decompressor(false);
    let header = blocks.meta_data().headers.first().context("it has no header")?;
    let channels = header.channels.clone();
    let names: Vec<String> = channels.list.iter().map(|channel| channel.name.to_string()).collect();
    while let Some(block) = blocks.decompress_next_block() {
        let block = block?;
        for line in block.lines(&channels) {
            let at = line.location;
            let samples: Vec<f32> = match channels.list[at.channel].sample_type {
                SampleType::F16 => {
                    line.read_samples::<f16>().map(|value| value.map(f16::to_f32)).collect::<Result<_, _>>()?
                }
                SampleType::F32 => line.read_samples::<f32>().collect::<Result<_, _>>()?,
                SampleType::U32 => {
                    line.read_samples::<u32>().map(|value| value.map(|n| n as f32)).collect::<Result<_, _>>()?
                }
            };
            visit(&names[at.channel], [at.position.0, at.position.1], &samples);
        }
    }
    Ok(())
}
