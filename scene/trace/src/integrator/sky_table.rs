//! A table of the sky's luminance, by which directions toward it are sampled.
//!
//! Petrik Clarberg et al., "Wavelet importance sampling: efficiently evaluating products of complex functions", SIGGRAPH
//! 2005: a cell is found by halving, each time with the probability of the halves.

use std::f32::consts::PI;

use crate::real::{Real, Vec3, vec3};

/// Bits of a row's index: rows are of one solid angle, from the lowest direction to the highest.
const ROW_BITS: usize = 3;
/// Bits of a column's index: columns are sectors around the vertical, from +x.
const COLUMN_BITS: usize = 4;
const ROWS: usize = 1 << ROW_BITS;
const COLUMNS: usize = 1 << COLUMN_BITS;
const CELLS: usize = ROWS * COLUMNS;
/// Directions along each edge of a cell whose luminance is averaged.
const TESTS: usize = 3;
/// Share of the mean luminance that every cell gets in addition, because a cell is not as dark everywhere.
const FLOOR: f32 = 0.1;

/// Probabilities of the cells of a sky.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SkyTable {
    /// For each number of halvings, the probability of the upper half in each part.
    upper: Vec<Vec<f32>>,
    /// Density in each cell, per steradian.
    densities: Vec<f32>,
    /// Mean luminance over all directions.
    pub(super) mean: f32,
}

/// A sampled direction, and its density per steradian.
pub(super) struct SkyDirection<R> {
    pub(super) direction: Vec3<R>,
    pub(super) density: R,
}

impl SkyTable {
    /// The table of a sky, by the radiance in each direction.
    pub(super) fn new(radiance: impl Fn(Vec3<f32>) -> Vec3<f32>) -> Self {
        let luminance = |cell: usize| {
            let tests = (0..TESTS * TESTS).map(|test| {
                let within = |index: usize| (index as f32 + 0.5) / TESTS as f32;
                radiance(direction_in(cell, within(test / TESTS), within(test % TESTS))).mean()
            });
            tests.sum::<f32>() / (TESTS * TESTS) as f32
        };
        let mut weights: Vec<f32> = (0..CELLS).map(luminance).collect();
        let mean = weights.iter().sum::<f32>() / CELLS as f32;
        for weight in &mut weights {
            *weight += (FLOOR * mean).max(1e-9);
        }
        let sum: f32 = weights.iter().sum();
        let densities = weights.iter().map(|weight| weight / sum * (CELLS as f32 / (4.0 * PI))).collect();
        let mut upper = Vec::new();
        let mut parts = weights;
        while parts.len() > 1 {
            let halves: Vec<_> =
                parts.chunks(2).map(|pair| (pair[1] / (pair[0] + pair[1]), pair[0] + pair[1])).collect();
            upper.insert(0, halves.iter().map(|&(share, _)| share).collect());
            parts = halves.into_iter().map(|(_, sum)| sum).collect();
        }
        Self { upper, densities, mean }
    }

    /// The direction that a pair of numbers from 0 to 1 chooses.
    pub(super) fn sample<R: Real>(&self, (u, v): (R, R)) -> SkyDirection<R> {
        let (mut u, mut v) = (u, v);
        let mut bits: Vec<R::Mask> = Vec::new();
        for (level, shares) in self.upper.iter().enumerate() {
            let rest = if level < ROW_BITS { &mut u } else { &mut v };
            let share = pick(*rest, shares, &bits);
            let lower = rest.constant(1.0) - share;
            let is_upper = !rest.lt(lower);
            let above = (*rest - lower) / share.at_least(1e-9);
            *rest = R::select(is_upper, above, *rest / lower.at_least(1e-9)).at_least(0.0).at_most(1.0);
            bits.push(is_upper);
        }
        let density = pick(u, &self.densities, &bits);
        let index = |bits: &[R::Mask]| {
            bits.iter()
                .fold(u.constant(0.0), |index, &bit| index + index + R::select(bit, u.constant(1.0), u.constant(0.0)))
        };
        let (rows, columns) = bits.split_at(ROW_BITS);
        let height = (index(rows) + u) * (2.0 / ROWS as f32) - 1.0;
        let turn = (index(columns) + v) * (1.0 / COLUMNS as f32);
        SkyDirection { direction: direction_at(height, turn), density }
    }

    /// Density with which a direction is sampled.
    pub(super) fn density<R: Real>(&self, direction: Vec3<R>) -> R {
        let one = direction.x.constant(1.0);
        let mut bits = Vec::new();
        let turn = direction.z.atan2(direction.x) * (0.5 / PI);
        let turn = R::select(turn.below(0.0), turn + 1.0, turn);
        for (number, count) in [((direction.y + 1.0) * 0.5, ROW_BITS), (turn, COLUMN_BITS)] {
            let mut rest = number;
            for _ in 0..count {
                rest = rest + rest;
                let is_upper = !rest.lt(one);
                rest = R::select(is_upper, rest - 1.0, rest);
                bits.push(is_upper);
            }
        }
        pick(one, &self.densities, &bits)
    }
}

/// The number of a list whose index has these bits, the highest first.
fn pick<R: Real>(like: R, numbers: &[f32], bits: &[R::Mask]) -> R {
    let Some((&highest, rest)) = bits.split_first() else { return like.uniform(numbers[0]) };
    let (lower, upper) = numbers.split_at(numbers.len() / 2);
    R::select(highest, pick(like, upper, rest), pick(like, lower, rest))
}

/// Direction at a place in a cell, from 0 to 1 along its height and its width.
fn direction_in(cell: usize, up: f32, along: f32) -> Vec3<f32> {
    let (row, column) = (cell / COLUMNS, cell % COLUMNS);
    direction_at((row as f32 + up) * (2.0 / ROWS as f32) - 1.0, (column as f32 + along) / COLUMNS as f32)
}

/// Direction of this height, turned from +x toward +z by a fraction of a revolution.
fn direction_at<R: Real>(height: R, turn: R) -> Vec3<R> {
    let (sine, cosine) = turn.sin_cos_turns();
    let across = (height.constant(1.0) - height.square()).sqrt();
    vec3(across * cosine, height, across * sine)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glow(direction: Vec3<f32>) -> Vec3<f32> {
        let bright = 0.2 + 5.0 * direction.dot(vec3(0.6, 0.64, -0.48)).max(0.0).square().square().square();
        vec3(bright, 0.5 * bright, 2.0 * bright)
    }

    #[test]
    fn samples_have_the_density_of_their_direction_and_integrate_the_sky() {
        let table = SkyTable::new(glow);
        let (mut sum, mut solid_angle, mut moved) = (0.0_f64, 0.0_f64, 0);
        for index in 0..4096_u32 {
            let pair = ((index as f32 + 0.5) / 4096.0, index.reverse_bits() as f32 / 4_294_967_296.0);
            let SkyDirection { direction, density } = table.sample(pair);
            assert!((direction.length() - 1.0).abs() < 1e-5);
            moved += u32::from((table.density(direction) / density - 1.0).abs() > 1e-3);
            solid_angle += f64::from(1.0 / density) / 4096.0;
            sum += f64::from(glow(direction).x / density) / 4096.0;
        }
        assert!(moved < 40, "rounding moves few directions over the border of their cells, not {moved}");
        // 4π·0.2 + 5·2π/9.
        let wanted = f64::from(PI) * (0.8 + 10.0 / 9.0);
        assert!((sum / wanted - 1.0).abs() < 0.01, "{sum} {wanted}");
        assert!((solid_angle / f64::from(4.0 * PI) - 1.0).abs() < 0.01, "{solid_angle}");
    }
}
