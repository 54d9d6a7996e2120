//! Picture of a price's map: on the left how long each cell takes, on the right how many steps its rays make, both over the
//! frame in gray.

use anyhow::Context;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use proto::Rect;
use proto::price::PriceMap;
use scene::color::srgb_from_linear;
use scene::film::DisplayTransform;
use scene::{Film, Job};
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TilePixels, TileRequest};

/// Width of each of the two parts, and their maximum height, in pixels.
const PART_PX: u32 = 640;
const MAX_HEIGHT_PX: u32 = 1280;
/// Space between them.
const GAP_PX: u32 = 8;
/// Width of the frame in gray that is rendered for it.
const FRAME_PX: u32 = 320;
/// Colors from nothing to the most, in sRGB: dark blue, violet, orange, pale yellow, as in matplotlib's inferno.
const COLORS: [[f32; 3]; 6] = [
    [8.0, 6.0, 40.0],
    [66.0, 10.0, 104.0],
    [147.0, 38.0, 103.0],
    [221.0, 81.0, 58.0],
    [252.0, 165.0, 10.0],
    [252.0, 255.0, 164.0],
];
/// Share of the color in the picture; the rest is the frame.
const COLOR_SHARE: f32 = 0.72;

/// Draws the map as a PNG.
pub(super) fn draw(job: &Job, map: &PriceMap) -> anyhow::Result<Vec<u8>> {
    let (width, height) = (job.image.film().width, job.image.film().height);
    let scaled = |length: u32, to: u32, from: u32| (u64::from(length) * u64::from(to) / u64::from(from)) as u32;
    let part_height = scaled(height, PART_PX, width).clamp(1, MAX_HEIGHT_PX);
    let frame = gray_frame(job)?;
    let mut pixels = vec![[24_u8; 3]; (2 * PART_PX + GAP_PX) as usize * part_height as usize];
    for (part, values) in [&map.seconds, &map.steps].into_iter().enumerate() {
        let most = values.iter().copied().fold(0.0, f64::max);
        let left = part as u32 * (PART_PX + GAP_PX);
        for y in 0..part_height {
            for x in 0..PART_PX {
                let cell = scaled(y, map.rows, part_height) * map.columns + scaled(x, map.columns, PART_PX);
                let value = values.get(cell as usize).copied().unwrap_or(0.0);
                let gray = frame.at(x as f32 / PART_PX as f32, y as f32 / part_height as f32);
                let color = color(if most > 0.0 { (value / most) as f32 } else { 0.0 });
                let place = y as usize * (2 * PART_PX + GAP_PX) as usize + (left + x) as usize;
                pixels[place] = color.map(|level| {
                    (level * COLOR_SHARE + gray * 255.0 * (1.0 - COLOR_SHARE) + 0.5).clamp(0.0, 255.0) as u8
                });
            }
        }
    }
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(pixels.as_flattened(), 2 * PART_PX + GAP_PX, part_height, ExtendedColorType::Rgb8)
        .context("could not encode the map")?;
    Ok(png)
}

/// Color of a value from 0 to 1.
fn color(value: f32) -> [f32; 3] {
    let last = COLORS.len() - 1;
    let place = value.clamp(0.0, 1.0) * last as f32;
    let from = (place as usize).min(last - 1);
    let share = place - from as f32;
    std::array::from_fn(|channel| COLORS[from][channel] * (1.0 - share) + COLORS[from + 1][channel] * share)
}

/// Luminance of a small frame.
struct Frame {
    width: u32,
    height: u32,
    levels: Vec<f32>,
}

impl Frame {
    /// Level at a place from 0 to 1, 0 to 1.
    fn at(&self, x: f32, y: f32) -> f32 {
        let index = |place: f32, length: u32| ((place * length as f32) as u32).min(length - 1);
        self.levels[(index(y, self.height) * self.width + index(x, self.width)) as usize]
    }
}

fn gray_frame(job: &Job) -> anyhow::Result<Frame> {
    let mut small = job.clone();
    let Film { width, height, .. } = small.image.film();
    let to_width = FRAME_PX.min(width);
    let to_height = (u64::from(height) * u64::from(to_width) / u64::from(width)).clamp(1, FRAME_PX.into()) as u32;
    small.image.resize(to_width, to_height);
    small.image.samples = 1.into();
    small.image.clear_layers();
    let renderer = CpuRenderer::new(None, Simd::Auto)?;
    let rect = Rect::full(to_width, to_height);
    let TilePixels { planes, .. } =
        renderer.render(&TileRequest { job: &small, frame: 0, rect }, &CancelFlag::new(), &|_| ())?;
    let grade = DisplayTransform::new(&small.image);
    let level = |index: usize| {
        let shown = |plane: usize| srgb_from_linear(grade.apply(planes[plane][index]).clamp(0.0, 1.0));
        0.2126 * shown(0) + 0.7152 * shown(1) + 0.0722 * shown(2)
    };
    Ok(Frame { width: to_width, height: to_height, levels: (0..planes[0].len()).map(level).collect() })
}
