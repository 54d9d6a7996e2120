//! Picture of a verification: the file in gray, darker where nothing was checked, and in color what differs.

use anyhow::Context;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use proto::Rect;
use scene::color::srgb_from_linear;
use worker::image::stored::{StoredPicture, ValueKind};

use super::Checked;

/// Color of a pixel that differs.
const WRONG: [u8; 3] = [255, 40, 60];
/// Color of the frames around tiles that differ.
const FRAME: [u8; 3] = [255, 196, 0];
/// Distance of the ring around a pixel that differs, in pixels: one pixel alone is hard to see.
const MARK_PX: i64 = 6;
/// Maximum number of pixels that get a ring.
const MAX_MARKS: usize = 256;
/// Brightness of what was checked, and of what was not.
const CHECKED: f32 = 0.75;
const UNCHECKED: f32 = 0.3;

/// Draws the differences as a PNG of the picture's size.
pub fn draw(stored: &StoredPicture, checked: &Checked) -> anyhow::Result<Vec<u8>> {
    let [width, height] = [stored.width, stored.height];
    let mut canvas = Canvas { width, height, pixels: vec![[0; 3]; width as usize * height as usize] };
    canvas.draw_gray(&Rect::full(width, height), stored, UNCHECKED);
    for tile in &checked.tiles {
        canvas.draw_gray(tile, stored, CHECKED);
    }
    for tile in &checked.comparison.differs {
        let (x, y) = (i64::from(tile.x), i64::from(tile.y));
        canvas.draw_frame([x, y], [x + i64::from(tile.width) - 1, y + i64::from(tile.height) - 1], FRAME);
    }
    let has_marks = checked.pixels.len() <= MAX_MARKS;
    for &[x, y] in &checked.pixels {
        let (x, y) = (i64::from(x), i64::from(y));
        canvas.set(x, y, WRONG);
        if has_marks {
            canvas.draw_frame([x - MARK_PX, y - MARK_PX], [x + MARK_PX, y + MARK_PX], WRONG);
        }
    }
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(canvas.pixels.as_flattened(), width, height, ExtendedColorType::Rgb8)
        .context("could not encode the picture of the differences")?;
    Ok(png)
}

struct Canvas {
    width: u32,
    height: u32,
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    fn set(&mut self, x: i64, y: i64, color: [u8; 3]) {
        if (0..i64::from(self.width)).contains(&x) && (0..i64::from(self.height)).contains(&y) {
            self.pixels[y as usize * self.width as usize + x as usize] = color;
        }
    }

    fn draw_frame(&mut self, [left, top]: [i64; 2], [right, bottom]: [i64; 2], color: [u8; 3]) {
        for x in left..=right {
            self.set(x, top, color);
            self.set(x, bottom, color);
        }
        for y in top..=bottom {
            self.set(left, y, color);
            self.set(right, y, color);
        }
    }

    fn draw_gray(&mut self, rect: &Rect, stored: &StoredPicture, brightness: f32) {
        for y in rect.y..rect.y + rect.height {
            for x in rect.x..rect.x + rect.width {
                let index = y as usize * self.width as usize + x as usize;
                let gray = (luminance(stored, index) * brightness * 255.0 + 0.5) as u8;
                self.pixels[index] = [gray; 3];
            }
        }
    }
}

/// Displayed luminance of a pixel, 0 to 1.
fn luminance(stored: &StoredPicture, index: usize) -> f32 {
    let of = |name: &str, weight: f32| {
        let channel = stored.channels.iter().find(|channel| channel.name == name);
        channel.map_or(0.0, |channel| {
            let number = channel.kind.number(channel.values.bits(index)) as f32;
            let shown = match channel.kind {
                ValueKind::Byte => number / 255.0,
                ValueKind::Word => number / 65535.0,
                ValueKind::Half | ValueKind::Float | ValueKind::Integer => {
                    srgb_from_linear(if number.is_nan() { 0.0 } else { number.clamp(0.0, 1.0) })
                }
            };
            shown * weight
        })
    };
    (of("R", 0.2126) + of("G", 0.7152) + of("B", 0.0722) + of("Y", 1.0)).min(1.0)
}
