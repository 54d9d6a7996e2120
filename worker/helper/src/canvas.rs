//! A small picture that a larger one is averaged into, pixel by pixel in any order, so that the large one is
//! never in memory. Uncovered areas show the picture below.
//!
//! All values are display values, 0 to 1, premultiplied by alpha; sRGB is applied last.

use anyhow::Context;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, Rgba32FImage};
use scene::color::{level_of_256, srgb_from_linear};
use scene::film::DisplayTransform;
use scene::sampling::thresholds;

/// Displayed color, premultiplied, and alpha.
pub(super) type DisplayPixel = [f32; 4];

/// Maximum number of rows: pictures may be far higher than wide.
const MAX_ROWS: u64 = 4096;

/// Color of unknown areas: a middle gray.
const NO_DATA: DisplayPixel = [0.2, 0.2, 0.2, 1.0];

/// Small picture made from a larger one.
#[derive(Debug)]
pub(super) struct Canvas {
    from: [u64; 2],
    size: [u64; 2],
    /// Color, and the covered fraction of the pixel.
    sums: Vec<([f32; 4], f32)>,
}

impl Canvas {
    /// Canvas for a picture of this size, at most this wide, and of limited height.
    pub(super) fn new(width: u32, height: u32, width_px: u32) -> Self {
        let from = [u64::from(width.max(1)), u64::from(height.max(1))];
        let not_too_high = (from[0] * MAX_ROWS / from[1]).max(1);
        let columns = u64::from(width_px).min(not_too_high).clamp(1, from[0]);
        let rows = ((from[1] * columns + from[0] / 2) / from[0]).clamp(1, from[1].min(MAX_ROWS));
        let length = usize::try_from(columns * rows).expect("a width is limited, and so is a picture's height");
        Self { from, size: [columns, rows], sums: vec![([0.0; 4], 0.0); length] }
    }

    /// Number of columns and rows.
    pub(super) fn size(&self) -> [u32; 2] {
        self.size.map(|count| count as u32)
    }

    /// Adds pixels of the larger picture that lie in a row, the first of them in this column.
    pub(super) fn add(&mut self, column: u32, row: u32, pixels: impl Iterator<Item = DisplayPixel>) {
        let Some(rows) = coverage(u64::from(row), self.from[1], self.size[1]) else { return };
        for (at, light) in (u64::from(column)..).zip(pixels) {
            let Some(columns) = coverage(at, self.from[0], self.size[0]) else { return };
            for (y, height) in rows {
                for (x, width) in columns {
                    let share = width * height;
                    if share > 0.0 {
                        let (sum, covered) = &mut self.sums[(y * self.size[0] + x) as usize];
                        for (sum, light) in sum.iter_mut().zip(light) {
                            *sum = light.mul_add(share, *sum);
                        }
                        *covered += share;
                    }
                }
            }
        }
    }

    /// Encodes the PNG; uncovered areas show `below`, a picture of the same size, or gray.
    pub(super) fn png(&self, below: Option<&Rgba32FImage>) -> anyhow::Result<Vec<u8>> {
        let pixels = self.sums.iter().enumerate().map(|(index, (sum, covered))| {
            // Rounding errors do not count as uncovered.
            let bare = if *covered > 0.999 { 0.0 } else { 1.0 - covered };
            let below = below.map_or(NO_DATA, |below| below.as_raw().as_chunks().0[index]);
            let scale = if bare == 0.0 { covered.recip() } else { 1.0 };
            std::array::from_fn(|channel| bare.mul_add(below[channel], sum[channel] * scale))
        });
        let pixels: Vec<DisplayPixel> = pixels.collect();
        let opaque = pixels.iter().all(|pixel| pixel[3] > 0.999);
        let mut bytes = Vec::with_capacity(pixels.len() * 4);
        for (index, [r, g, b, alpha]) in pixels.into_iter().enumerate() {
            let index = index as u64;
            let thresholds = thresholds((index % self.size[0]) as f32, (index / self.size[0]) as f32);
            let straight = |light: f32| if alpha > 0.0 { light / alpha } else { 0.0 };
            let colors = [r, g, b].into_iter().zip(thresholds);
            bytes.extend(colors.map(|(light, threshold)| byte(straight(light), threshold)));
            if !opaque {
                bytes.push((alpha.clamp(0.0, 1.0) * 255.0 + 0.5) as u8);
            }
        }
        let [width, height] = self.size();
        let color = if opaque { ExtendedColorType::Rgb8 } else { ExtendedColorType::Rgba8 };
        let mut png = Vec::new();
        PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Paeth)
            .write_image(&bytes, width, height, color)
            .context("could not encode the preview")?;
        Ok(png)
    }
}

/// Position of a source pixel among fewer pixels, and how much of each it covers; `None` beyond the last.
fn coverage(at: u64, from: u64, to: u64) -> Option<[(u64, f32); 2]> {
    if at >= from {
        return None;
    }
    let (start, end) = (at * to, (at + 1) * to);
    let first = start / from;
    let border = (first + 1) * from;
    let part = |length: u64| length as f32 / from as f32;
    if end <= border {
        return Some([(first, part(end - start)), (first, 0.0)]);
    }
    Some([(first, part(border - start)), (first + 1, part(end - border))])
}

/// The byte that shows linear light, rounded like the stored picture.
fn byte(light: f32, threshold: f32) -> u8 {
    level_of_256(srgb_from_linear(light), threshold) as u8
}

/// A pixel as a PNG would show it; `opaque` ones have no alpha.
pub(super) fn shown([r, g, b, alpha]: [f32; 4], grade: DisplayTransform, opaque: bool) -> DisplayPixel {
    let number = |value: f32| if value.is_nan() { 0.0 } else { value };
    let alpha = if opaque { 1.0 } else { number(alpha).clamp(0.0, 1.0) };
    let light = [r, g, b].map(|light| {
        let straight = if opaque { light } else { light / alpha };
        number(grade.apply(number(straight))).clamp(0.0, 1.0) * alpha
    });
    [light[0], light[1], light[2], alpha]
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::color::linear_from_srgb;

    fn decoded(png: &[u8]) -> image::DynamicImage {
        image::load_from_memory_with_format(png, image::ImageFormat::Png).expect("a valid PNG")
    }

    #[test]
    fn uniform_picture_stays_uniform_at_every_size() {
        for (width, height, width_px) in
            [(7, 5, 7), (7, 5, 3), (1, 9, 4), (640, 3, 100), (3, 640, 2), (10, 10, 1), (3, 9000, 3)]
        {
            let mut canvas = Canvas::new(width, height, width_px);
            let [r, g, b] = [188.0, 64.0, 255.0].map(|level| linear_from_srgb(level / 255.0_f32));
            let light = [r, g, b, 1.0];
            for row in 0..height {
                canvas.add(0, row, (0..width).map(|_| light));
            }
            let picture = decoded(&canvas.png(None).expect("encoded")).into_rgb8();
            assert!(
                picture.pixels().all(|pixel| pixel.0 == [188, 64, 255]),
                "{width}×{height} to {width_px}: {picture:?}"
            );
        }
    }

    #[test]
    fn picture_of_the_same_size_is_unchanged() {
        let mut canvas = Canvas::new(16, 2, 500);
        let light = |x: u32, y: u32| [x as f32 / 16.0, y as f32 / 2.0, 0.5, 1.0];
        for y in [1, 0] {
            canvas.add(0, y, (0..16).map(|x| light(x, y)));
        }
        let picture = decoded(&canvas.png(None).expect("encoded")).into_rgb8();
        for (x, y, pixel) in picture.enumerate_pixels() {
            let [r, g, b, _] = light(x, y);
            let [at_r, at_g, at_b] = thresholds(x as f32, y as f32);
            assert_eq!(pixel.0, [byte(r, at_r), byte(g, at_g), byte(b, at_b)], "{x}, {y}");
        }
    }

    #[test]
    fn half_covered_pixel_blends_with_the_picture_below() {
        let mut canvas = Canvas::new(4, 1, 2);
        canvas.add(0, 0, [[1.0, 1.0, 1.0, 1.0]; 3].into_iter());
        let below = Rgba32FImage::from_pixel(2, 1, image::Rgba([0.0, 0.0, 0.0, 1.0]));
        let picture = decoded(&canvas.png(Some(&below)).expect("encoded")).into_rgb8();
        assert_eq!(picture.get_pixel(0, 0).0, [255; 3]);
        assert_eq!(picture.get_pixel(1, 0).0, thresholds(1.0, 0.0).map(|threshold| byte(0.5, threshold)));
    }

    #[test]
    fn uncovered_color_keeps_its_alpha() {
        let mut canvas = Canvas::new(2, 1, 1);
        let grade = DisplayTransform::new(&serde_json::from_str(r#"{ "width": 2, "height": 1 }"#).expect("an image"));
        let pixels = [[0.5, 0.0, 0.0, 0.5], [f32::NAN, 0.0, 0.0, 0.0]];
        canvas.add(0, 0, pixels.into_iter().map(|pixel| shown(pixel, grade, false)));
        let picture = decoded(&canvas.png(None).expect("encoded")).into_rgba8();
        assert_eq!(picture.get_pixel(0, 0).0, [255, 0, 0, 64]);
    }
}
