//! Thumbnail of a stored picture, read row by row or block by block: PNG or EXR, detected by its first bytes.

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use anyhow::{Context, bail, ensure};
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::{ReadChannels, ReadLayers, Vec2, read};
use png::{BitDepth, ColorType, Decoder, Limits};
use scene::Job;
use scene::color::{DisplayTransform, linear_from_srgb};
use scene::limits::{MAX_EDGE_PX, MAX_PIXELS};

use super::canvas::{Canvas, DisplayPixel, shown};

/// Maximum memory for a PNG's rows.
const MAX_ROW_BYTES: usize = 64 << 20;

/// Draws the thumbnail as a PNG of at most this width.
pub(super) fn draw(file: &Path, width_px: u32) -> anyhow::Result<Vec<u8>> {
    let context = || format!("could not read the stored picture {}", file.display());
    let mut input = BufReader::new(File::open(file).with_context(context)?);
    let mut magic = [0; 4];
    input.read_exact(&mut magic).with_context(context)?;
    input.rewind().with_context(context)?;
    let canvas = match magic {
        [0x89, b'P', b'N', b'G'] => of_png(input, width_px).with_context(context)?,
        [0x76, 0x2f, 0x31, 0x01] => of_exr(input, width_px).with_context(context)?,
        _ => bail!("the stored picture {} is neither PNG nor EXR", file.display()),
    };
    canvas.png(None)
}

fn of_png(input: BufReader<File>, width_px: u32) -> anyhow::Result<Canvas> {
    let mut reader = Decoder::new_with_limits(input, Limits { bytes: MAX_ROW_BYTES }).read_info()?;
    let (width, height) = (reader.info().width, reader.info().height);
    let (channels, bytes) = match reader.output_color_type() {
        (ColorType::Rgb, BitDepth::Eight) => (3, 1),
        (ColorType::Rgb, BitDepth::Sixteen) => (3, 2),
        (ColorType::Rgba, BitDepth::Eight) => (4, 1),
        (ColorType::Rgba, BitDepth::Sixteen) => (4, 2),
        other => bail!("its pixels are {other:?}, which sdfarm never writes"),
    };
    let most = if bytes == 1 { 255 } else { 65_535 };
    let unit = |value: usize| value as f32 / most as f32;
    let light: Vec<f32> = (0..=most).map(|value| linear_from_srgb(unit(value))).collect();
    let value = |sample: &[u8]| sample.iter().fold(0, |value, byte| value << 8 | usize::from(*byte));
    let mut canvas = Canvas::new(width, height, width_px);
    for y in 0..height {
        let row = reader.next_row()?.context("it ends early")?;
        let pixels = row.data().chunks_exact(channels * bytes).map(|pixel| {
            let sample = |channel: usize| value(&pixel[channel * bytes..][..bytes]);
            let alpha = if channels == 4 { unit(sample(3)) } else { 1.0 };
            [light[sample(0)] * alpha, light[sample(1)] * alpha, light[sample(2)] * alpha, alpha]
        });
        canvas.add(0, y, pixels);
    }
    Ok(canvas)
}

/// Checks that the header announces an image that a farm writes, because the reader allocates what it announces.
fn check_exr_size(input: &mut BufReader<File>) -> anyhow::Result<()> {
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

fn of_exr(mut input: BufReader<File>, width_px: u32) -> anyhow::Result<Canvas> {
    check_exr_size(&mut input)?;
    let grade = identity_transform();
    let one = move |canvas: &mut Canvas, at: Vec2<usize>, (r, g, b, a): (f32, f32, f32, f32)| {
        let pixel: DisplayPixel = shown([r, g, b, a], grade, false);
        canvas.add(at.x() as u32, at.y() as u32, std::iter::once(pixel));
    };
    let create = move |size: Vec2<usize>, _: &_| Canvas::new(size.x() as u32, size.y() as u32, width_px);
    let picture = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgba_channels(create, one)
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(input)?;
    Ok(picture.layer_data.channel_data.pixels)
}

/// An EXR is linear: its values are displayed without exposure or tone map.
fn identity_transform() -> DisplayTransform {
    const PLAIN: &str = r#"{ "scene": { "camera": { "position": [0, 0, 3], "look_at": [0, 0, 0] },
        "objects": [{ "shape": { "sphere": { "radius": 1 } } }] }, "image": { "width": 1, "height": 1 } }"#;
    let job: Job = scene::parse(PLAIN.as_bytes()).expect("a valid job");
    DisplayTransform::new(&job.image)
}
