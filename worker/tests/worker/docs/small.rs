//! The small file of a documented picture: WebP for people, replaced only if the picture looks different.

use super::flip;
use super::picture::Pixels;

/// Maximum size of one, in bytes.
pub(crate) const MAX_BYTES: usize = 25 << 10;
/// Quality of a file, lowered until the file is small.
const QUALITY: f32 = 70.0;
const QUALITY_STEP: f32 = 5.0;
/// Edge of the parts of a picture that are compared, in pixels.
const PART_PX: usize = 32;
/// A picture looks different if a part's mean error is larger than that of a new file by this.
const LOOKS_DIFFERENT: f64 = 0.05;

/// The small file of a picture.
pub(crate) fn encode(pixels: &Pixels) -> Vec<u8> {
    let Pixels { width, height, rgba, .. } = pixels;
    let mut config = webp::WebPConfig::new().expect("libwebp has the version of its header");
    (config.method, config.use_sharp_yuv, config.quality) = (6, 1, QUALITY);
    loop {
        let encoder = webp::Encoder::from_rgba(rgba, *width, *height);
        let file = encoder.encode_advanced(&config).expect("a small picture is encoded");
        if file.len() <= MAX_BYTES {
            return file.to_vec();
        }
        config.quality -= QUALITY_STEP;
    }
}

/// Size of the picture in a small file.
pub(crate) fn size(file: &[u8]) -> Option<[u32; 2]> {
    webp::BitstreamFeatures::new(file).map(|features| [features.width(), features.height()])
}

/// Whether a picture looks different from what is in its small file.
pub(crate) fn looks_different(file: &[u8], pixels: &Pixels) -> bool {
    if size(file) != Some([pixels.width, pixels.height]) {
        return true;
    }
    let (old, new) = (errors(file, pixels), errors(&encode(pixels), pixels));
    old.into_iter().zip(new).any(|(old, new)| old > new + LOOKS_DIFFERENT)
}

/// Mean error of each part of the picture in a file.
fn errors(file: &[u8], pixels: &Pixels) -> Vec<f64> {
    let image = webp::Decoder::new(file).decode().expect("a WebP file");
    let (width, channels) = (pixels.width as usize, image.len() / (pixels.width * pixels.height) as usize);
    let errors = flip::errors(&on_white(&pixels.rgba, 4), &on_white(&image, channels), width);
    let parts_of_a_row = width.div_ceil(PART_PX);
    let mut parts = vec![(0.0, 0.0); parts_of_a_row * (pixels.height as usize).div_ceil(PART_PX)];
    for (place, error) in errors.into_iter().enumerate() {
        let (sum, count) = &mut parts[place / width / PART_PX * parts_of_a_row + place % width / PART_PX];
        (*sum, *count) = (*sum + error, *count + 1.0);
    }
    parts.into_iter().map(|(sum, count)| sum / count).collect()
}

/// RGB of pixels in front of white.
fn on_white(pixels: &[u8], channels: usize) -> Vec<u8> {
    let color = |pixel: &[u8]| {
        let alpha = u16::from(pixel.get(3).copied().unwrap_or(255));
        [0, 1, 2].map(|channel| ((u16::from(pixel[channel]) * alpha + 255 * (255 - alpha)) / 255) as u8)
    };
    pixels.chunks_exact(channels).flat_map(color).collect()
}

#[test]
fn a_picture_looks_different_only_if_a_part_of_it_does() {
    let picture = |brightness: isize, square_px: usize| {
        let pixel = |place: usize| {
            let (x, y) = (place % 96, place / 96);
            let value =
                if x < square_px && y < square_px { 250 } else { (60 + x).saturating_add_signed(brightness) as u8 };
            [value, value / 2 + 40, 90, 255]
        };
        Pixels { width: 96, height: 64, rgba: (0..96 * 64).flat_map(pixel).collect(), low: Vec::new() }
    };
    let file = encode(&picture(0, 12));
    assert!(!looks_different(&file, &picture(0, 12)) && !looks_different(&file, &picture(2, 12)));
    assert!(looks_different(&file, &picture(0, 24)) && looks_different(&file, &picture(30, 12)));
    let wider = Pixels { width: 64, height: 96, ..picture(0, 12) };
    assert!(looks_different(&file, &wider) && looks_different(b"no file", &wider));
}
