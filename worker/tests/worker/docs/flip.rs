//! LDR-FLIP: how different two pictures look to somebody who flips between them, from 0 to 1 in each pixel.
//!
//! Pontus Andersson et al., "FLIP: a difference evaluator for alternating images", HPG 2020,
//! <https://doi.org/10.1145/3406183>, with its constants.

#![expect(clippy::disallowed_methods, reason = "it compares pictures and makes none")]

use std::f64::consts::{PI, SQRT_2};

/// Pixels of a degree: a screen of 3840 pixels and 0.7 m, 0.7 m away.
const PIXELS_PER_DEGREE: f64 = 67.020_645;
/// Reflectance of white in CIE XYZ under D65.
const WHITE: [f64; 3] = [0.950_428_545, 1.0, 1.088_900_371];
const XYZ_OF_RGB: [[f64; 3]; 3] = [
    [0.412_386_56, 0.357_591_49, 0.180_450_49],
    [0.212_636_82, 0.715_182_98, 0.072_180_20],
    [0.019_330_62, 0.119_197_16, 0.950_372_59],
];
const RGB_OF_XYZ: [[f64; 3]; 3] = [
    [3.241_003_26, -1.537_398_99, -0.498_615_87],
    [-0.969_224_26, 1.875_929_99, 0.041_554_22],
    [0.055_639_42, -0.204_011_20, 1.057_148_97],
];
/// Exponent of color differences, and the part of their range that becomes the part `PART_OF_ERRORS` of errors.
const COLOR_EXPONENT: f64 = 0.7;
const PART_OF_COLORS: f64 = 0.4;
const PART_OF_ERRORS: f64 = 0.95;
/// Width of what is taken for an edge or a point, in degrees.
const FEATURE_DEGREES: f64 = 0.082;

/// One number of every pixel.
struct Plane {
    width: usize,
    values: Vec<f64>,
}

/// Weights around a pixel, in a square.
struct Kernel {
    radius: usize,
    weights: Vec<f64>,
}

impl Kernel {
    fn new(radius: f64, weight: impl Fn(f64, f64) -> f64) -> Self {
        let radius = radius.ceil() as usize;
        let places = || (0..=2 * radius).map(|place| place as f64 - radius as f64);
        let weights = places().flat_map(|y| places().map(move |x| (x, y))).map(|(x, y)| weight(x, y)).collect();
        Self { radius, weights }
    }

    /// The kernel whose positive weights have the sum 1, and the negative ones −1.
    fn normalized(mut self) -> Self {
        let sum = |sign: f64| self.weights.iter().map(|weight| (sign * weight).max(0.0)).sum::<f64>();
        let (above, below) = (sum(1.0), sum(-1.0));
        for weight in &mut self.weights {
            *weight /= if *weight > 0.0 { above } else { below.max(f64::MIN_POSITIVE) };
        }
        self
    }

    /// The eye's blur of a channel: two Gaussians, as weights and spreads in degrees.
    fn of_contrast(gaussians: [[f64; 2]; 2]) -> Self {
        const WIDEST: f64 = 0.04;
        Self::new(3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE, |x, y| {
            let square = (x * x + y * y) / (PIXELS_PER_DEGREE * PIXELS_PER_DEGREE);
            let gaussian =
                |[weight, spread]: [f64; 2]| weight * (PI / spread).sqrt() * (-PI * PI * square / spread).exp();
            gaussians.into_iter().map(gaussian).sum()
        })
        .normalized()
    }

    /// The filter of edges or points along the axis x.
    fn of_feature(is_point: bool) -> Self {
        let spread = 0.5 * FEATURE_DEGREES * PIXELS_PER_DEGREE;
        Self::new(3.0 * spread, |x, y| {
            let gaussian = (-(x * x + y * y) / (2.0 * spread * spread)).exp();
            gaussian * if is_point { x * x / (spread * spread) - 1.0 } else { -x }
        })
        .normalized()
    }

    fn transposed(&self) -> Self {
        let edge = 2 * self.radius + 1;
        let weights = (0..edge * edge).map(|place| self.weights[place % edge * edge + place / edge]).collect();
        Self { radius: self.radius, weights }
    }
}

impl Plane {
    /// The plane after a kernel; pixels beyond an edge equal the edge's.
    fn filtered(&self, kernel: &Kernel) -> Self {
        let (width, height, edge) = (self.width, self.values.len() / self.width, 2 * kernel.radius + 1);
        let clamped = |place: usize, end: usize| place.saturating_sub(kernel.radius).min(end - 1);
        let pixel = |place: usize| {
            let (x, y) = (place % width, place / width);
            let row = |dy: usize| {
                let (values, weights) =
                    (&self.values[clamped(y + dy, height) * width..][..width], &kernel.weights[dy * edge..]);
                (0..edge).map(|dx| values[clamped(x + dx, width)] * weights[dx]).sum::<f64>()
            };
            (0..edge).map(row).sum()
        };
        Self { width, values: (0..self.values.len()).map(pixel).collect() }
    }

    /// Lengths of the vectors of a kernel's answers along x and along y.
    fn feature(&self, kernel: &Kernel) -> Vec<f64> {
        let [x, y] = [self.filtered(kernel), self.filtered(&kernel.transposed())];
        x.values.iter().zip(&y.values).map(|(x, y)| x.hypot(*y)).collect()
    }
}

fn product(matrix: &[[f64; 3]; 3], color: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * color[0] + row[1] * color[1] + row[2] * color[2])
}

/// `YCxCz` of 8-bit sRGB.
fn opponent(srgb: &[u8]) -> [f64; 3] {
    let linear = [0, 1, 2].map(|channel| {
        let value = f64::from(srgb[channel]) / 255.0;
        if value > 0.04045 { ((value + 0.055) / 1.055).powf(2.4) } else { value / 12.92 }
    });
    let xyz = product(&XYZ_OF_RGB, linear);
    let [x, y, z] = [0, 1, 2].map(|axis| xyz[axis] / WHITE[axis]);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Linear RGB of `YCxCz`, as far as a screen shows it.
fn shown([luminance, cx, cz]: [f64; 3]) -> [f64; 3] {
    let y = (luminance + 16.0) / 116.0;
    let xyz = [(y + cx / 500.0) * WHITE[0], y * WHITE[1], (y - cz / 200.0) * WHITE[2]];
    product(&RGB_OF_XYZ, xyz).map(|value| value.clamp(0.0, 1.0))
}

/// CIE Lab of linear RGB, with less color where it is dark.
fn lab(linear: [f64; 3]) -> [f64; 3] {
    const DELTA: f64 = 6.0 / 29.0;
    let xyz = product(&XYZ_OF_RGB, linear);
    let [x, y, z] = [0, 1, 2].map(|axis| {
        let value: f64 = xyz[axis] / WHITE[axis];
        if value > DELTA.powi(3) { value.cbrt() } else { value / (3.0 * DELTA * DELTA) + 4.0 / 29.0 }
    });
    let lightness = 116.0 * y - 16.0;
    [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
}

/// Distance of two colors.
fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    ((a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])).powf(COLOR_EXPONENT)
}

/// A picture as the eye takes it: blurred colors, edges and points.
struct Seen {
    colors: Vec<[f64; 3]>,
    edges: Vec<f64>,
    points: Vec<f64>,
}

impl Seen {
    fn new(rgb: &[u8], width: usize) -> Self {
        let opponents: Vec<[f64; 3]> = rgb.chunks_exact(3).map(opponent).collect();
        let plane = |channel: usize| Plane { width, values: opponents.iter().map(|color| color[channel]).collect() };
        let spreads = [[[1.0, 0.0047], [0.0, 1.0]], [[1.0, 0.0053], [0.0, 1.0]], [[34.1, 0.04], [13.5, 0.025]]];
        let [y, cx, cz] =
            [0, 1, 2].map(|channel| plane(channel).filtered(&Kernel::of_contrast(spreads[channel])).values);
        let colors = (0..y.len()).map(|pixel| lab(shown([y[pixel], cx[pixel], cz[pixel]]))).collect();
        let mut luminance = plane(0);
        luminance.values.iter_mut().for_each(|value| *value = (*value + 16.0) / 116.0);
        let feature = |is_point| luminance.feature(&Kernel::of_feature(is_point));
        Self { colors, edges: feature(false), points: feature(true) }
    }
}

/// Error of each pixel of a picture against another of the same size; both are 8-bit sRGB, three bytes a pixel.
pub(crate) fn errors(reference: &[u8], picture: &[u8], width: usize) -> Vec<f64> {
    let [wanted, got] = [Seen::new(reference, width), Seen::new(picture, width)];
    let largest = distance(lab([0.0, 1.0, 0.0]), lab([0.0, 0.0, 1.0]));
    let knee = PART_OF_COLORS * largest;
    let error = |pixel: usize| {
        let color = distance(wanted.colors[pixel], got.colors[pixel]);
        let of_color = if color < knee {
            color * PART_OF_ERRORS / knee
        } else {
            PART_OF_ERRORS + (color - knee) / (largest - knee) * (1.0 - PART_OF_ERRORS)
        };
        let edges = (wanted.edges[pixel] - got.edges[pixel]).abs();
        let points = (wanted.points[pixel] - got.points[pixel]).abs();
        let of_features = (edges.max(points) / SQRT_2).sqrt().min(1.0);
        of_color.min(1.0).powf(1.0 - of_features)
    };
    (0..wanted.colors.len()).map(error).collect()
}

#[test]
fn errors_are_as_of_the_published_program() {
    // A slope with a square, and the same with another square, in 48 × 32 pixels.
    let picture = |square: std::ops::Range<usize>| -> Vec<u8> {
        let pixel = |place: usize| {
            let (x, y) = (place % 48, place / 48);
            let is_inside = square.contains(&x) && square.contains(&y);
            if is_inside { [200, 60, 30] } else { [(x * 5) as u8, (y * 7) as u8, 128] }
        };
        (0..48 * 32).flat_map(pixel).collect()
    };
    let [a, b] = [picture(8..20), picture(10..22)];
    let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len() as f64;
    assert_eq!(mean(&errors(&a, &a, 48)), 0.0);
    let found = errors(&a, &b, 48);
    let largest = found.iter().copied().fold(0.0, f64::max);
    // The values of the authors' FLIP 1.7.
    assert!(
        (mean(&found) - 0.082_470).abs() < 1e-4 && (largest - 0.715_817).abs() < 1e-3,
        "{} {largest}",
        mean(&found)
    );
}
