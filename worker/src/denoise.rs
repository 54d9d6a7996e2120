//! The denoiser: averages the light of neighboring pixels that see the same surface, as far as their noise explains the
//! difference between them.
//!
//! An à-trous wavelet transform (Holger Dammertz, Daniel Sewtz, Johannes Hanika and Hendrik Lensch, "Edge-avoiding à-trous
//! wavelet transform for fast global illumination filtering", High Performance Graphics 2010), whose weights follow from
//! the variance of each pixel as in Christoph Schied et al., "Spatiotemporal variance-guided filtering", High Performance
//! Graphics 2017. Light is divided by the albedo before, so that textures stay sharp. Weights fall to 0 by Tukey's biweight,
//! which needs no exponential.
//!
//! A pixel depends on those up to [`MARGIN_PX`] away and on nothing else, and on IEEE-754 arithmetic in a fixed order: the
//! bits are the same for any division into regions, on every machine.

use rayon::prelude::*;
use scene::real::Real;

/// Number of passes; the distance between the pixels of a pass doubles from one to the next.
const PASSES: u32 = 5;
/// Distance to the farthest pixel that a pixel depends on, in pixels: 2·(1 + 2 + 4 + 8 + 16), 2 for the means that the
/// first pass compares, and 2 for outliers and the variance.
pub(crate) const MARGIN_PX: u32 = 2 * ((1 << PASSES) - 1) + 4;
/// The kernel of a pass in either direction, a cubic B-spline: distances in steps, and weights.
const SPLINE: [(isize, f32); 5] = [(-2, 1.0 / 16.0), (-1, 1.0 / 4.0), (0, 3.0 / 8.0), (1, 1.0 / 4.0), (2, 1.0 / 16.0)];
/// Difference of two normals from which on pixels see different surfaces.
const NORMAL_REACH: f32 = 0.35;
/// The same for direct neighbors, so that pixels on the edge between two surfaces are not left alone.
const NEAR_NORMAL_REACH: f32 = 0.9;
/// Difference of two albedos from which on they do.
const ALBEDO_REACH: f32 = 0.5;
/// Difference of two inverse depths from which on they do, relative to the inverse depth.
const DEPTH_REACH: f32 = 0.1;
/// Difference of two brightnesses from which on noise does not explain it, in standard deviations.
const NOISE_REACH: f32 = 4.0;
/// Variance of a neighbor over the pixel's own that is believed at most.
const MAX_NOISE_RATIO: f32 = 4.0;
/// Brightness over the mean of a pixel's neighbors from which on it is an outlier, in their standard deviations.
const OUTLIER_REACH: f32 = 3.0;
/// Least albedo that light is divided by.
const MIN_ALBEDO: f32 = 0.05;

/// A rectangle of pixels to denoise, as planes of `width` × `height` numbers.
#[derive(Clone, Debug)]
pub(crate) struct Region {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Light, linear.
    pub(crate) color: [Vec<f32>; 3],
    /// Albedo; 0 where nothing is hit, and where the surface has no color of its own.
    pub(crate) albedo: [Vec<f32>; 3],
    pub(crate) normal: [Vec<f32>; 3],
    /// 1 over the depth, which is linear along a plane; 0 where nothing is hit.
    pub(crate) inverse_depth: Vec<f32>,
    /// Standard error of the brightness.
    pub(crate) error: Vec<f32>,
}

/// Light divided by albedo, and the variance of its brightness: the planes that a pass filters.
struct Light {
    color: [Vec<f32>; 3],
    variance: Vec<f32>,
}

/// Planes that tell which pixels see the same surface.
struct Guides<'a> {
    width: usize,
    height: usize,
    albedo: &'a [Vec<f32>; 3],
    normal: &'a [Vec<f32>; 3],
    inverse_depth: &'a [f32],
    /// Changes of the inverse depth from one pixel to the next, to the right and downward.
    slopes: [Vec<f32>; 2],
}

/// Row of pixels that a pass computes.
struct RowSums {
    color: [Vec<f32>; 3],
    variance: Vec<f32>,
    weight: Vec<f32>,
}

impl Region {
    /// The light of the region without noise. Pixels nearer than [`MARGIN_PX`] to its edge are the picture's only
    /// if that edge is the picture's.
    pub(crate) fn denoised(&self) -> [Vec<f32>; 3] {
        let divisors: [Vec<f32>; 3] = std::array::from_fn(|channel| {
            let all = (0..self.color[0].len()).map(|pixel| self.divisor(channel, pixel));
            all.collect()
        });
        let color = std::array::from_fn(|channel| {
            self.color[channel].iter().zip(&divisors[channel]).map(|(light, divisor)| light / divisor).collect()
        });
        let own_variance = (0..self.error.len()).map(|pixel| {
            let error = self.error[pixel] / brightness(std::array::from_fn(|channel| divisors[channel][pixel]));
            error * error
        });
        let own_variance: Vec<f32> = own_variance.collect();
        let variance = blurred(&own_variance, self.width, self.height);
        let guides = Guides {
            width: self.width,
            height: self.height,
            albedo: &self.albedo,
            normal: &self.normal,
            inverse_depth: &self.inverse_depth,
            slopes: slopes(&self.inverse_depth, self.width),
        };
        let mut light = Light { color, variance };
        light.hold_outliers(&own_variance, self.width, self.height);
        // The first pass compares means of neighbors, because pixels by themselves are too noisy.
        let means = guides.filtered(&light, None, 1);
        light = guides.filtered(&light, Some(&means), 1);
        for pass in 1..PASSES {
            light = guides.filtered(&light, Some(&light), 1 << pass);
        }
        let mut color = light.color;
        for (plane, divisors) in color.iter_mut().zip(&divisors) {
            plane.iter_mut().zip(divisors).for_each(|(light, divisor)| *light *= divisor);
        }
        color
    }

    /// Divisor of the light of a pixel.
    fn divisor(&self, channel: usize, pixel: usize) -> f32 {
        let has_color = self.albedo.iter().any(|plane| plane[pixel] > 0.0);
        if has_color { self.albedo[channel][pixel].max(MIN_ALBEDO) } else { 1.0 }
    }
}

impl Light {
    fn brightnesses(&self) -> Vec<f32> {
        let of_pixel = |pixel: usize| brightness(std::array::from_fn(|channel| self.color[channel][pixel]));
        (0..self.variance.len()).map(of_pixel).collect()
    }

    /// Darkens pixels that are much brighter than those around them, as far as noise may explain that, by their own variance
    /// or by that of their neighbors: samples that found much light by chance.
    fn hold_outliers(&mut self, own_variance: &[f32], width: usize, height: usize) {
        let brightnesses = self.brightnesses();
        let factor = |(pixel, &own): (usize, &f32)| {
            let (x, y) = (pixel % width, pixel / width);
            let rows = y.saturating_sub(2)..height.min(y + 3);
            let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
            for row in rows {
                let start = row * width + x.saturating_sub(2);
                let others = &brightnesses[start..row * width + width.min(x + 3)];
                for (_, other) in others.iter().enumerate().filter(|(column, _)| start + column != pixel) {
                    // The pixel is left out and not subtracted: a firefly's square would leave nothing but its rounding.
                    sum += other;
                    squares += other * other;
                    count += 1.0;
                }
            }
            let count = f32::max(count, 1.0);
            let mean = sum / count;
            let deviation = Real::sqrt((squares / count - mean * mean).max(0.0));
            let limit = mean + OUTLIER_REACH * deviation;
            let explained = own - NOISE_REACH * Real::sqrt(self.variance[pixel].max(own_variance[pixel]));
            if own > limit { limit.max(explained) / own } else { 1.0 }
        };
        let factors: Vec<f32> = brightnesses.par_iter().enumerate().map(factor).collect();
        for plane in &mut self.color {
            plane.iter_mut().zip(&factors).for_each(|(light, factor)| *light *= factor);
        }
    }
}

impl Guides<'_> {
    /// A pass over pixels that are `step` apart, whose light is compared as `compared` has it; without it, their guides
    /// alone are compared.
    fn filtered(&self, light: &Light, compared: Option<&Light>, step: isize) -> Light {
        let length = self.width * self.height;
        let compared = match compared {
            Some(compared) => (compared.brightnesses(), &compared.variance),
            None => (vec![0.0; length], &light.variance),
        };
        let rows: Vec<RowSums> =
            (0..self.height).into_par_iter().map(|y| self.row(light, (&compared.0, compared.1), step, y)).collect();
        let joined = |plane: fn(&RowSums) -> &[f32]| rows.iter().flat_map(|row| plane(row).iter().copied()).collect();
        Light {
            color: [joined(|row| &row.color[0]), joined(|row| &row.color[1]), joined(|row| &row.color[2])],
            variance: joined(|row| &row.variance),
        }
    }

    fn row(&self, light: &Light, compared: (&[f32], &[f32]), step: isize, y: usize) -> RowSums {
        let nothing = || vec![0.0; self.width];
        let mut sums = RowSums { color: [nothing(), nothing(), nothing()], variance: nothing(), weight: nothing() };
        for (down, of_row) in SPLINE {
            let Some(other) = y.checked_add_signed(down * step).filter(|&other| other < self.height) else { continue };
            for (right, of_column) in SPLINE {
                self.add(&mut sums, light, compared, [y, other], right * step, of_row * of_column);
            }
        }
        for x in 0..self.width {
            // The pixel itself has a weight.
            let share = 1.0 / sums.weight[x];
            for plane in &mut sums.color {
                plane[x] *= share;
            }
            sums.variance[x] *= share * share;
        }
        sums
    }

    /// Adds the pixels of the row `other`, `shift` to the right, to the pixels of the row `y`.
    fn add(
        &self,
        sums: &mut RowSums,
        light: &Light,
        (brightnesses, variances): (&[f32], &[f32]),
        [y, other]: [usize; 2],
        shift: isize,
        kernel: f32,
    ) {
        let start = usize::try_from(-shift).unwrap_or(0).min(self.width);
        let end = self.width - usize::try_from(shift).unwrap_or(0).min(self.width);
        if start >= end {
            return;
        }
        let (own, far) = (y * self.width + start, (other * self.width + start).strict_add_signed(shift));
        let count = end - start;
        let reach = if shift.unsigned_abs() <= 2 && other.abs_diff(y) <= 2 { NEAR_NORMAL_REACH } else { NORMAL_REACH };
        let per_normal = 1.0 / (reach * reach);
        let down = other as f32 - y as f32;
        let right = shift as f32;
        // Slices of one length, so that no index is checked in the loop.
        macro_rules! both {
            ($plane:expr) => {
                (&$plane[own..own + count], &$plane[far..far + count])
            };
        }
        let (normal, albedo, color) = (self.normal, self.albedo, &light.color);
        let (nx, nxs) = both!(normal[0]);
        let (ny, nys) = both!(normal[1]);
        let (nz, nzs) = both!(normal[2]);
        let (ar, ars) = both!(albedo[0]);
        let (ag, ags) = both!(albedo[1]);
        let (ab, abs) = both!(albedo[2]);
        let (depth, depths) = both!(self.inverse_depth);
        let (bright, brights) = both!(brightnesses);
        let (variance, variances) = both!(variances);
        let summed = &light.variance[far..far + count];
        let (sx, sy) = (&self.slopes[0][own..own + count], &self.slopes[1][own..own + count]);
        let (reds, greens, blues) =
            (&color[0][far..far + count], &color[1][far..far + count], &color[2][far..far + count]);
        let [red, green, blue] = &mut sums.color;
        let (red, green, blue) = (&mut red[start..end], &mut green[start..end], &mut blue[start..end]);
        let (sum, weight) = (&mut sums.variance[start..end], &mut sums.weight[start..end]);
        for x in 0..count {
            let (dx, dy, dz) = (nx[x] - nxs[x], ny[x] - nys[x], nz[x] - nzs[x]);
            let of_normal = biweight((dx * dx + dy * dy + dz * dz) * per_normal);
            let (dr, dg, db) = (ar[x] - ars[x], ag[x] - ags[x], ab[x] - abs[x]);
            let of_albedo = biweight((dr * dr + dg * dg + db * db) * (1.0 / (ALBEDO_REACH * ALBEDO_REACH)));
            let off_plane = depths[x] - (depth[x] + sx[x] * right + sy[x] * down);
            let reach = DEPTH_REACH * depth[x].max(depths[x]) + 1e-12;
            let of_depth = biweight((off_plane * off_plane) / (reach * reach));
            let difference = bright[x] - brights[x];
            // A neighbor's noise explains no more than a few times the pixel's own, so that bright edges do not leak.
            let variances = variance[x] + variances[x].min(MAX_NOISE_RATIO * variance[x]);
            let noise = (NOISE_REACH * NOISE_REACH) * variances + 1e-12;
            let of_light = biweight((difference * difference) / noise);
            let w = kernel * ((of_normal * of_albedo) * (of_depth * of_light));
            red[x] += w * reds[x];
            green[x] += w * greens[x];
            blue[x] += w * blues[x];
            sum[x] += w * w * summed[x];
            weight[x] += w;
        }
    }
}

/// Tukey's biweight: 1 for 0, and 0 from 1 on.
fn biweight(squared: f32) -> f32 {
    let rest = 1.0 - squared.min(1.0);
    rest * rest
}

fn brightness([red, green, blue]: [f32; 3]) -> f32 {
    (red + green + blue) * (1.0 / 3.0)
}

/// A plane, averaged over the kernel's 5 × 5 pixels.
fn blurred(plane: &[f32], width: usize, height: usize) -> Vec<f32> {
    let row = |y: usize| {
        let mut sums = vec![0.0; width];
        let mut weights = vec![0.0; width];
        for (down, of_row) in SPLINE {
            let Some(other) = y.checked_add_signed(down).filter(|&other| other < height) else { continue };
            for (right, of_column) in SPLINE {
                for x in 0..width {
                    let Some(far) = x.checked_add_signed(right).filter(|&far| far < width) else { continue };
                    sums[x] += of_row * of_column * plane[other * width + far];
                    weights[x] += of_row * of_column;
                }
            }
        }
        sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum /= weight);
        sums
    };
    (0..height).into_par_iter().flat_map_iter(row).collect()
}

/// The change from each pixel to the next, to the right and downward: the lesser of those on its two sides.
fn slopes(plane: &[f32], width: usize) -> [Vec<f32>; 2] {
    let along = |distance: usize, is_first: fn(usize, usize) -> bool, is_last: fn(usize, usize, usize) -> bool| {
        let slope = |pixel: usize| {
            let before = (!is_first(pixel, width)).then(|| plane[pixel] - plane[pixel - distance]);
            let after = (!is_last(pixel, width, plane.len())).then(|| plane[pixel + distance] - plane[pixel]);
            match (before, after) {
                (Some(before), Some(after)) => {
                    if before.abs() <= after.abs() {
                        before
                    } else {
                        after
                    }
                }
                (Some(only), None) | (None, Some(only)) => only,
                (None, None) => 0.0,
            }
        };
        (0..plane.len()).map(slope).collect()
    };
    [
        along(1, |pixel, width| pixel % width == 0, |pixel, width, _| pixel % width == width - 1),
        along(width, |pixel, width| pixel < width, |pixel, width, length| pixel + width >= length),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 160;
    const HEIGHT: usize = 150;

    /// A number from −1 to 1 that follows from an index.
    fn noise(index: usize) -> f32 {
        let hash = (index as u32 ^ 0x9e37_79b9).wrapping_mul(0x85eb_ca6b);
        let hash = (hash ^ (hash >> 15)).wrapping_mul(0xc2b2_ae35);
        ((hash ^ (hash >> 16)) >> 8) as f32 / (1 << 23) as f32 - 1.0
    }

    /// Two walls of a room, one on each side, with the texture of a checkerboard and light that differs, and what is
    /// behind them. `strength` is that of the noise.
    fn room(strength: f32) -> (Region, [Vec<f32>; 3]) {
        let (mut truth, mut region) = (
            [const { Vec::new() }; 3],
            Region {
                width: WIDTH,
                height: HEIGHT,
                color: [const { Vec::new() }; 3],
                albedo: [const { Vec::new() }; 3],
                normal: [const { Vec::new() }; 3],
                inverse_depth: Vec::new(),
                error: Vec::new(),
            },
        );
        for (y, x) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (y, x))) {
            let (is_behind, is_left) = (y < 20, x < WIDTH / 2);
            let light = if is_behind {
                0.4
            } else if is_left {
                1.0
            } else {
                0.2 + 0.001 * y as f32
            };
            let base = if (x / 5 + y / 5) % 2 == 0 { 0.8 } else { 0.3 };
            let albedo = if is_behind { 0.0 } else { base };
            let divisor = if is_behind { 1.0 } else { base };
            let random = strength * noise(y * WIDTH + x) * light * divisor;
            for channel in 0..3 {
                let share = [1.0, 0.9, 0.7][channel];
                truth[channel].push(light * divisor * share);
                region.color[channel].push((light * divisor + random) * share);
                region.albedo[channel].push(albedo);
            }
            let normal = if is_behind {
                [0.0; 3]
            } else if is_left {
                [1.0, 0.0, 0.0]
            } else {
                [0.0, 0.0, 1.0]
            };
            region.normal.iter_mut().zip(normal).for_each(|(plane, number)| plane.push(number));
            region.inverse_depth.push(if is_behind { 0.0 } else { 0.2 + 0.0005 * x as f32 });
            // As good as a guess from two halves: between 0 and twice the noise.
            region.error.push((strength * light * divisor * (1.0 + noise(y * WIDTH + x + 7_777_777)) * 0.6).abs());
        }
        (region, truth)
    }

    fn error(color: &[Vec<f32>; 3], truth: &[Vec<f32>; 3]) -> f64 {
        let squares =
            color.iter().flatten().zip(truth.iter().flatten()).map(|(a, b)| f64::from(a - b) * f64::from(a - b));
        (squares.sum::<f64>() / (3 * WIDTH * HEIGHT) as f64).sqrt()
    }

    #[test]
    fn noise_goes_and_textures_and_edges_stay() {
        let (region, truth) = room(0.6);
        let (before, denoised) = (error(&region.color, &truth), region.denoised());
        let after = error(&denoised, &truth);
        assert!(after < before / 8.0, "{before} to {after}");
        // The pixels beside the edge between the walls, whose light differs by a factor of 4.
        for y in (30..HEIGHT).step_by(10) {
            for x in [WIDTH / 2 - 1, WIDTH / 2] {
                let pixel = y * WIDTH + x;
                assert!((denoised[0][pixel] / truth[0][pixel] - 1.0).abs() < 0.35, "{x}, {y}");
            }
        }
    }

    #[test]
    fn a_picture_without_noise_is_the_same_up_to_rounding() {
        let (region, truth) = room(0.0);
        let denoised = region.denoised();
        let differs = denoised.iter().flatten().zip(truth.iter().flatten()).any(|(a, b)| (a / b - 1.0).abs() > 2e-5);
        assert!(!differs, "{}", error(&denoised, &truth));
    }

    #[test]
    fn a_pixel_depends_on_no_farther_ones() {
        let (region, _) = room(0.6);
        let whole = region.denoised();
        // The left part, whose right edge is not the picture's.
        let part = 100;
        let crop = |plane: &Vec<f32>| plane.chunks(WIDTH).flat_map(|row| row[..part].iter().copied()).collect();
        let cropped = Region {
            width: part,
            height: HEIGHT,
            color: region.color.each_ref().map(crop),
            albedo: region.albedo.each_ref().map(crop),
            normal: region.normal.each_ref().map(crop),
            inverse_depth: crop(&region.inverse_depth),
            error: crop(&region.error),
        };
        let alone = cropped.denoised();
        let sure = part - MARGIN_PX as usize;
        for y in 0..HEIGHT {
            for x in 0..sure {
                assert_eq!(alone[1][y * part + x].to_bits(), whole[1][y * WIDTH + x].to_bits(), "{x}, {y}");
            }
        }
    }

    #[test]
    fn a_firefly_goes() {
        for light in [40.0, 1e6] {
            let (mut region, truth) = room(0.2);
            let pixel = 60 * WIDTH + 40;
            region.color.iter_mut().for_each(|plane| plane[pixel] = light);
            region.error[pixel] = light / 2.0;
            let denoised = region.denoised();
            assert!(denoised[0][pixel] < 1.5 * truth[0][pixel], "{light}: {} {}", denoised[0][pixel], truth[0][pixel]);
        }
    }
}
