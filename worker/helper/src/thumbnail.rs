//! Thumbnail of a stored picture, read row by row or block by block: PNG or EXR, detected by its first bytes.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek};
use std::path::Path;

use anyhow::{Context, anyhow, bail, ensure};
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::{ReadChannels, ReadLayers, ReadSpecificChannel, Vec2, read};
use png::{BitDepth, ColorType, Decoder, Limits, Reader};
use proto::preview_helper::StoredLayer;
use scene::ImageSpec;
use scene::color::linear_from_srgb;
use scene::film::DisplayTransform;
use scene::limits::{MAX_EDGE_PX, MAX_PIXELS};
use serde_json::json;

use crate::canvas::{Canvas, DisplayPixel, shown};

/// Maximum memory for a PNG's rows.
const MAX_ROW_BYTES: usize = 64 << 20;

/// First bytes of a PNG.
pub(super) const PNG_MAGIC: [u8; 4] = [0x89, b'P', b'N', b'G'];
/// First bytes of an EXR.
pub(super) const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Draws a layer of colors as a PNG of at most this width, with an exposure in stops; a PNG has one layer.
pub(super) fn draw(file: &Path, layer: &StoredLayer, width_px: u32, exposure: f32) -> anyhow::Result<Vec<u8>> {
    let context = || format!("could not read the stored picture {}", file.display());
    let mut input = BufReader::new(File::open(file).with_context(context)?);
    let mut magic = [0; 4];
    input.read_exact(&mut magic).with_context(context)?;
    input.rewind().with_context(context)?;
    let canvas = match magic {
        PNG_MAGIC => of_png(input, width_px, exposure).with_context(context)?,
        EXR_MAGIC => of_exr(input, layer, width_px, exposure).with_context(context)?,
        _ => bail!("the stored picture {} is neither PNG nor EXR", file.display()),
    };
    canvas.png(None)
}

/// Limits of a PNG's reader.
pub(super) fn limits() -> Limits {
    Limits { bytes: MAX_ROW_BYTES }
}

/// Samples of a PNG's pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct PngLayout {
    /// Samples of a pixel: red, green, blue, and perhaps alpha.
    pub(super) channels: usize,
    /// Bytes of a sample.
    pub(super) bytes: usize,
}

impl PngLayout {
    fn max(self) -> usize {
        if self.bytes == 1 { 255 } else { 65_535 }
    }

    fn level(self, pixel: &[u8], channel: usize) -> usize {
        let sample = &pixel[channel * self.bytes..][..self.bytes];
        sample.iter().fold(0, |value, byte| value << 8 | usize::from(*byte))
    }

    /// A sample of a pixel, from 0 to 1.
    pub(super) fn unit(self, pixel: &[u8], channel: usize) -> f32 {
        self.level(pixel, channel) as f32 / self.max() as f32
    }
}

/// Samples of the pixels of a PNG that a farm writes.
pub(super) fn png_layout<R: BufRead + Seek>(reader: &Reader<R>) -> anyhow::Result<PngLayout> {
    let (channels, bytes) = match reader.output_color_type() {
        (ColorType::Rgb, BitDepth::Eight) => (3, 1),
        (ColorType::Rgb, BitDepth::Sixteen) => (3, 2),
        (ColorType::Rgba, BitDepth::Eight) => (4, 1),
        (ColorType::Rgba, BitDepth::Sixteen) => (4, 2),
        other => bail!("its pixels are {other:?}, which sdfarm never writes"),
    };
    Ok(PngLayout { channels, bytes })
}

fn of_png(input: BufReader<File>, width_px: u32, exposure: f32) -> anyhow::Result<Canvas> {
    let mut reader = Decoder::new_with_limits(input, limits()).read_info()?;
    let (width, height) = (reader.info().width, reader.info().height);
    let layout = png_layout(&reader)?;
    let (most, gain) = (layout.max(), exposure.exp2());
    let light = |level: usize| (linear_from_srgb(level as f32 / most as f32) * gain).min(1.0);
    let light: Vec<f32> = (0..=most).map(light).collect();
    let mut canvas = Canvas::new(width, height, width_px);
    for y in 0..height {
        let row = reader.next_row()?.context("it ends early")?;
        let pixels = row.data().chunks_exact(layout.channels * layout.bytes).map(|pixel| {
            let alpha = if layout.channels == 4 { layout.unit(pixel, 3) } else { 1.0 };
            let [r, g, b] = std::array::from_fn(|channel| light[layout.level(pixel, channel)] * alpha);
            [r, g, b, alpha]
        });
        canvas.add(0, y, pixels);
    }
    Ok(canvas)
}

/// Checks that the header announces an image that a farm writes, because the reader allocates what it announces.
pub(super) fn check_exr_size(input: &mut BufReader<File>) -> anyhow::Result<()> {
    let meta = MetaData::read_from_buffered(&mut *input, false)?;
    for header in &meta.headers {
        let mut sizes = vec![header.layer_size];
        if let BlockDescription::Tiles(tiles) = header.blocks {
            sizes.push(tiles.tile_size);
        }
        for Vec2(width, height) in sizes {
            let (width, height) = (width as u64, height as u64);
            let is_valid = width.max(height) <= u64::from(MAX_EDGE_PX) && width * height <= MAX_PIXELS;
            ensure!(is_valid, "its size is {width}×{height}, which no farm writes");
        }
    }
    input.rewind()?;
    Ok(())
}

fn of_exr(mut input: BufReader<File>, layer: &StoredLayer, width_px: u32, exposure: f32) -> anyhow::Result<Canvas> {
    check_exr_size(&mut input)?;
    let grade = linear_transform(exposure)?;
    let [red, green, blue] = layer.channels().try_into().map_err(|_| anyhow!("{layer} has no colors"))?;
    let one = move |canvas: &mut Canvas, at: Vec2<usize>, (r, g, b, a): (f32, f32, f32, f32)| {
        let pixel: DisplayPixel = shown([r, g, b, a], grade, false);
        canvas.add(at.x() as u32, at.y() as u32, std::iter::once(pixel));
    };
    let create = move |size: Vec2<usize>, _: &_| Canvas::new(size.x() as u32, size.y() as u32, width_px);
    let picture = read()
        .no_deep_data()
        .largest_resolution_level()
        .specific_channels()
        .required(red.as_str())
        .required(green.as_str())
        .required(blue.as_str())
        .optional("A", 1.0)
        .collect_pixels(create, one)
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(input)?;
    Ok(picture.layer_data.channel_data.pixels)
}

/// An EXR is linear: its values are displayed with this exposure, in stops, and without a tone map.
fn linear_transform(exposure: f32) -> anyhow::Result<DisplayTransform> {
    let image = json!({ "width": 1, "height": 1, "exposure": exposure });
    let image: ImageSpec = serde_json::from_value(image).context("the exposure is out of range")?;
    Ok(DisplayTransform::new(&image))
}
