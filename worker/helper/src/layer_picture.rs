//! Layers as pictures: the values of each channel become colors that a person can tell apart.

use anyhow::Context;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::imageops::{self, FilterType as Resampling};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use proto::preview_helper::{AboutPicture, HelperPicture};
use scene::Layer;
use scene::color::srgb_from_linear;

/// Level of the farthest depth; what is behind it, where nothing is hit, is black.
const FAR_LEVEL: f32 = 0.12;
/// Smallest depth that gets another color, relative to the largest.
const MIN_DEPTH_RATIO: f32 = 1e-6;
/// Fraction of the positions on either end that the range leaves out: a floor reaches to the horizon.
const OUTSIDE_FRACTION: f64 = 0.02;
/// Colors from few steps to many, in sRGB: dark blue, violet, red, orange, light yellow.
const HEAT: [[f32; 3]; 6] = [
    [0.0, 0.0, 0.02],
    [0.23, 0.06, 0.44],
    [0.55, 0.16, 0.5],
    [0.87, 0.29, 0.41],
    [0.99, 0.62, 0.43],
    [0.99, 0.99, 0.75],
];
/// Number of colors of ids.
const ID_COLORS: u32 = 9973;
/// Golden ratio: hues of consecutive objects that are as far apart as possible.
const GOLDEN: f32 = 0.618_034;

/// Layer as an RGB picture.
#[derive(Clone, Debug)]
pub(super) struct LayerPicture {
    layer: Layer,
    pixels: RgbImage,
    range: [Vec<f32>; 2],
}

/// Shows a layer, given its channels row by row.
pub(super) fn shown(layer: Layer, planes: &[Vec<f32>], [width, height]: [u32; 2]) -> LayerPicture {
    let channel = |number: usize, index: usize| planes[number].get(index).copied().unwrap_or(0.0);
    let triple = |index: usize| -> [f32; 3] {
        std::array::from_fn(|number| if number < planes.len() { channel(number, index) } else { 0.0 })
    };
    let range = range(layer, planes);
    let color = |index: usize| match layer {
        Layer::Depth => gray(depth_level(channel(0, index), range[0][0], range[1][0])),
        Layer::Normal => match triple(index) {
            [0.0, 0.0, 0.0] => [0.0; 3],
            normal => normal.map(|coordinate| 0.5 * coordinate + 0.5),
        },
        Layer::Position => match triple(index) {
            [0.0, 0.0, 0.0] => [0.0; 3],
            position => std::array::from_fn(|axis| {
                let (least, most) = (range[0][axis], range[1][axis]);
                if most > least { (position[axis] - least) / (most - least) } else { 0.5 }
            }),
        },
        Layer::Albedo | Layer::Noisy => triple(index).map(srgb_from_linear),
        Layer::Object => object_color(channel(0, index)),
        Layer::CryptoObject | Layer::CryptoMaterial => match channel(0, index).to_bits() {
            0 => [0.0; 3],
            // Few enough that a number holds each exactly.
            id => object_color((id % ID_COLORS) as f32),
        },
        Layer::Motion => {
            let (longest, way) = (range[1][0], triple(index));
            let level = |way: f32| if longest > 0.0 { 0.5 + 0.5 * way / longest } else { 0.5 };
            [level(way[0]), level(way[1]), 0.5]
        }
        Layer::Steps | Layer::Samples => heat(if range[1][0] > 0.0 { channel(0, index) / range[1][0] } else { 0.0 }),
    };
    let pixels = RgbImage::from_fn(width, height, |x, y| {
        let byte = |level: f32| if level.is_nan() { 0 } else { (level.clamp(0.0, 1.0) * 255.0 + 0.5) as u8 };
        image::Rgb(color(y as usize * width as usize + x as usize).map(byte))
    });
    LayerPicture { layer, pixels, range }
}

impl LayerPicture {
    /// The picture in a larger size. Objects keep their colors, because a mixture would be that of another.
    pub(super) fn scaled_up(self, width: u32, height: u32) -> Self {
        let is_thing = self.layer == Layer::Object || self.layer.is_matte();
        let filter = if is_thing { Resampling::Nearest } else { Resampling::CatmullRom };
        Self { pixels: imageops::resize(&self.pixels, width, height, filter), ..self }
    }

    /// The response with this picture, rendered or read with this width and these samples.
    pub(super) fn encode(self, rendered_px: u32, samples: u32) -> anyhow::Result<HelperPicture> {
        let (width, height) = self.pixels.dimensions();
        let mut png = Vec::new();
        PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Paeth)
            .write_image(&self.pixels, width, height, ExtendedColorType::Rgb8)
            .context("could not encode the layer")?;
        Ok(HelperPicture { about: AboutPicture { rendered_px, samples, range: self.range }, png })
    }
}

/// Least and most value of each channel that the colors depend on.
fn range(layer: Layer, planes: &[Vec<f32>]) -> [Vec<f32>; 2] {
    let ends = |values: &[f32]| -> [f32; 2] {
        let least = values.iter().copied().reduce(f32::min).unwrap_or(0.0);
        [least, values.iter().copied().reduce(f32::max).unwrap_or(0.0)]
    };
    let each: Vec<[f32; 2]> = match layer {
        Layer::Depth => {
            let hit: Vec<f32> = planes[0].iter().copied().filter(|depth| depth.is_finite()).collect();
            vec![ends(&hit)]
        }
        Layer::Position => {
            let is_hit = |&index: &usize| planes.iter().any(|plane| plane[index] != 0.0);
            let hit: Vec<usize> = (0..planes[0].len()).filter(is_hit).collect();
            let inner = |plane: &Vec<f32>| {
                let mut values: Vec<f32> = hit.iter().map(|&index| plane[index]).collect();
                values.sort_by(f32::total_cmp);
                let outside = (values.len() as f64 * OUTSIDE_FRACTION) as usize;
                ends(&values[outside..values.len() - outside])
            };
            planes.iter().map(inner).collect()
        }
        Layer::Steps | Layer::Samples => vec![[0.0, ends(&planes[0])[1]]],
        Layer::Motion => {
            let longest = planes.iter().flatten().fold(0.0, |longest, way| way.abs().max(longest));
            vec![[-longest, longest]; 2]
        }
        Layer::Normal | Layer::Albedo | Layer::Object | Layer::Noisy | Layer::CryptoObject | Layer::CryptoMaterial => {
            Vec::new()
        }
    };
    [0, 1].map(|end| each.iter().map(|ends| ends[end]).collect())
}

/// Brightness of a depth, by its logarithm: near is 1, far dark, and infinitely far black.
fn depth_level(depth: f32, near: f32, far: f32) -> f32 {
    if !depth.is_finite() {
        return 0.0;
    }
    let near = near.max(far * MIN_DEPTH_RATIO);
    if far <= near {
        return 1.0;
    }
    let part = (depth.max(near) / near).ln() / (far / near).ln();
    (1.0 - FAR_LEVEL).mul_add(1.0 - part, FAR_LEVEL)
}

/// Color of an object, by its index.
fn object_color(index: f32) -> [f32; 3] {
    if index < 0.0 {
        return [0.0; 3];
    }
    let (hue, turn) = ((index * GOLDEN).fract() * 6.0, index as u32 % 3);
    let (least, most) = [(0.25, 0.95), (0.1, 0.7), (0.5, 1.0)][turn as usize];
    let channel = |shift: f32| {
        let at = (hue + shift) % 6.0;
        let share = ((at - 3.0).abs() - 1.0).clamp(0.0, 1.0);
        (most - least) * share + least
    };
    [channel(0.0), channel(4.0), channel(2.0)]
}

fn heat(fraction: f32) -> [f32; 3] {
    let at = fraction.clamp(0.0, 1.0) * (HEAT.len() - 1) as f32;
    let first = (at as usize).min(HEAT.len() - 2);
    let share = at - first as f32;
    std::array::from_fn(|channel| {
        (HEAT[first + 1][channel] - HEAT[first][channel]).mul_add(share, HEAT[first][channel])
    })
}

fn gray(level: f32) -> [f32; 3] {
    [level; 3]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn pixels(layer: Layer, planes: &[&[f32]]) -> (Vec<[u8; 3]>, [Vec<f32>; 2]) {
        let planes: Vec<Vec<f32>> = planes.iter().map(|plane| plane.to_vec()).collect();
        let picture = shown(layer, &planes, [planes[0].len() as u32, 1]);
        (picture.pixels.pixels().map(|pixel| pixel.0).collect(), picture.range)
    }

    #[test]
    fn near_is_bright_far_is_dark_and_the_sky_is_black() {
        let (levels, range) = pixels(Layer::Depth, &[&[2.0, 4.0, 8.0, f32::INFINITY]]);
        assert_eq!(levels.iter().map(|level| level[0]).collect::<Vec<_>>(), [255, 143, 31, 0]);
        assert_eq!(range, [vec![2.0], vec![8.0]]);
        let (levels, range) = pixels(Layer::Depth, &[&[f32::INFINITY; 2]]);
        assert_eq!((levels, range), (vec![[0; 3]; 2], [vec![0.0], vec![0.0]]));
        assert_eq!(pixels(Layer::Depth, &[&[3.0, 3.0]]).0, [[255; 3]; 2]);
    }

    #[test]
    fn normals_are_colors_around_gray() {
        let (colors, _) = pixels(Layer::Normal, &[&[1.0, 0.0, 0.0], &[0.0, -1.0, 0.0], &[0.0, 0.0, 0.0]]);
        assert_eq!(colors, [[255, 128, 128], [128, 0, 128], [0, 0, 0]]);
    }

    #[test]
    fn positions_fill_the_range_of_the_picture() {
        let (colors, range) = pixels(Layer::Position, &[&[1.0, 3.0, 2.0], &[5.0, 5.0, 5.0], &[-4.0, 4.0, 0.0]]);
        assert_eq!(colors, [[0, 128, 0], [255, 128, 255], [128, 128, 128]]);
        assert_eq!(range, [vec![1.0, 5.0, -4.0], vec![3.0, 5.0, 4.0]]);
    }

    #[test]
    fn objects_have_colors_of_their_own() {
        let indices: Vec<f32> = (-1..64_i16).map(f32::from).collect();
        let (colors, _) = pixels(Layer::Object, &[&indices]);
        assert_eq!(colors[0], [0; 3]);
        assert_eq!(colors.iter().collect::<BTreeSet<_>>().len(), 65);
        for pair in colors.windows(2) {
            let apart: i32 = (0..3).map(|n| i32::from(pair[0][n].abs_diff(pair[1][n]))).sum();
            assert!(apart > 150, "{pair:?}");
        }
    }

    #[test]
    fn steps_are_hotter_the_more_they_are() {
        let (colors, range) = pixels(Layer::Steps, &[&[0.0, 5.0, 10.0]]);
        assert_eq!(range, [vec![0.0], vec![10.0]]);
        let sums: Vec<u32> = colors.iter().map(|color| color.iter().map(|&level| u32::from(level)).sum()).collect();
        assert!(sums.is_sorted() && sums[0] < 20 && sums[2] > 650, "{sums:?}");
        assert_eq!(pixels(Layer::Steps, &[&[0.0]]).0, pixels(Layer::Steps, &[&[0.0, 1.0]]).0[..1]);
    }

    #[test]
    fn objects_are_not_mixed_when_they_are_scaled_up() {
        let picture = shown(Layer::Object, &[vec![0.0, 1.0]], [2, 1]);
        let own: BTreeSet<[u8; 3]> = picture.pixels.pixels().map(|pixel| pixel.0).collect();
        let large = picture.scaled_up(9, 5).pixels;
        assert_eq!(large.dimensions(), (9, 5));
        assert_eq!(large.pixels().map(|pixel| pixel.0).collect::<BTreeSet<_>>(), own);
    }
}
