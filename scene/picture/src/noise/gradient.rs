//! Perlin noise, value noise and simplex noise: random values or gradients at the points of a lattice, interpolated
//! smoothly.

use super::lattice::{LatticeHash, cell, corner_hashes, corner_offsets, float_in_1_2, gradient_dot, trilinear};
use crate::real::{FunctionKey, Real, Vec3, vec3};

// Each corner's gradient or value is independent, so the maximum slope along a direction u at a point is the sum over
// the corners of the maximum of each: w·g·u + (u·∇w)·(g·d) for a gradient g at distance d with the weight w. The
// factors are the greatest of these sums over all points and directions; a test searches for greater ones.

/// Perlin noise has its maximum slope at the center of a cell.
pub(super) const PERLIN_LIPSCHITZ: f32 = 3.750_1;
/// Value noise has its maximum slope between two faces of opposite values: twice the quintic's maximum slope, 15/8.
pub(super) const VALUE_LIPSCHITZ: f32 = 3.750_1;
/// The maximum of the sum is 0.090620090 before scaling.
pub(super) const SIMPLEX_LIPSCHITZ: f32 = 0.090_621 * SIMPLEX_SCALE;

/// Ken Perlin, "Improving noise", SIGGRAPH 2002, <https://mrl.cs.nyu.edu/~perlin/paper445.pdf>: gradients at the
/// corners of unit cubes, interpolated by a quintic.
pub(super) fn perlin<R: Real>(p: Vec3<R>, seed: R) -> R {
    p.x.call(FunctionKey::new("perlin"), (p, seed), |(p, seed)| {
        let (corner, fraction) = cell(p);
        let words = corner_hashes(LatticeHash::pair(corner, seed));
        let away = corner_offsets(fraction);
        let mut corners = [seed; 8];
        for n in 0..8 {
            corners[n] = gradient_dot(away[n], words[n]);
        }
        trilinear(corners, fraction)
    })
}

/// Random values at the corners of unit cubes, −1 to 1, interpolated by the same quintic.
pub(super) fn value<R: Real>(p: Vec3<R>, seed: R) -> R {
    p.x.call(FunctionKey::new("value_noise"), (p, seed), |(p, seed)| {
        let (corner, fraction) = cell(p);
        let words = corner_hashes(LatticeHash::pair(corner, seed));
        let mut corners = [seed; 8];
        for n in 0..8 {
            corners[n] = float_in_1_2(words[n]);
        }
        trilinear(corners, fraction).mul_add(seed.constant(2.0), seed.constant(-3.0))
    })
}

/// Half the maximum cell coordinate of the lattice.
const MAX_CELL: f32 = 2_097_151.0;
/// One over the maximum of the sum of a simplex's four corners, which is 0.013007157.
const SIMPLEX_SCALE: f32 = 76.88;

/// Simplex noise: Ken Perlin, "Noise hardware", in "Real-Time Shading", SIGGRAPH 2001 course notes; as in
/// Stefan Gustavson, "Simplex noise demystified", 2005,
/// <https://cgvr.cs.uni-bremen.de/teaching/cg_literatur/simplexnoise.pdf>, with the kernel (½ − r²)⁴, which
/// is continuous.
pub(super) fn simplex<R: Real>(p: Vec3<R>, seed: R) -> R {
    p.x.call(FunctionKey::new("simplex"), (p, seed), |(p, seed)| {
        let (one, none) = (seed.constant(1.0), seed.constant(0.0));
        // Skewed, the lattice consists of cubes, each cut into six simplices by the order of the coordinates.
        let p = p.map(|c| c.at_least(-MAX_CELL).at_most(MAX_CELL));
        let skew = (p.x + p.y + p.z) * (1.0 / 3.0);
        let (corner, f) = cell(vec3(p.x + skew, p.y + skew, p.z + skew));
        let (x_over_y, x_over_z, y_over_z) = (!f.x.lt(f.y), !f.x.lt(f.z), !f.y.lt(f.z));
        let greatest = vec3(
            R::select(x_over_y & x_over_z, one, none),
            R::select(!x_over_y & y_over_z, one, none),
            R::select(!x_over_z & !y_over_z, one, none),
        );
        let not_least = vec3(
            R::select(x_over_y | x_over_z, one, none),
            R::select(!x_over_y | y_over_z, one, none),
            R::select(!x_over_z | !y_over_z, one, none),
        );
        let mut sum = none;
        for step in [vec3(none, none, none), greatest, not_least, vec3(one, one, one)] {
            let skewed = f - step;
            let unskew = (skewed.x + skewed.y + skewed.z) * (-1.0 / 6.0);
            let away = vec3(skewed.x + unskew, skewed.y + unskew, skewed.z + unskew);
            let near = (seed.constant(0.5) - away.length_squared()).at_least(0.0);
            let kernel = near.square().square();
            let word = LatticeHash::new(corner + step, seed).hash();
            sum = kernel.mul_add(gradient_dot(away, word), sum);
        }
        sum * SIMPLEX_SCALE
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Maximum of the dot products of `v` with the twelve gradients: the sum of its two largest
    /// components.
    fn most(v: Vec3<f32>) -> f32 {
        let Vec3 { x, y, z } = vec3(v.x.abs(), v.y.abs(), v.z.abs());
        x + y + z - x.min(y).min(z)
    }

    /// Weight of a corner or a simplex point, the weight's gradient, and the vector from there.
    type LatticePart = (f32, Vec3<f32>, Vec3<f32>);

    fn cube_parts(p: Vec3<f32>) -> Vec<LatticePart> {
        let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let slope = |t: f32| 30.0 * t * t * (t - 1.0) * (t - 1.0);
        let along =
            |t: f32, high: bool| if high { (fade(t), slope(t), t - 1.0) } else { (1.0 - fade(t), -slope(t), t) };
        (0..8)
            .map(|corner| {
                let ((wx, sx, dx), (wy, sy, dy), (wz, sz, dz)) =
                    (along(p.x, corner & 1 > 0), along(p.y, corner & 2 > 0), along(p.z, corner & 4 > 0));
                (wx * wy * wz, vec3(sx * wy * wz, wx * sy * wz, wx * wy * sz), vec3(dx, dy, dz))
            })
            .collect()
    }

    /// Parts for skewed coordinates in descending order; the other simplices are this one with the axes swapped.
    fn simplex_parts(p: Vec3<f32>) -> Vec<LatticePart> {
        let mut f = [p.x, p.y, p.z];
        f.sort_by(|a, b| b.total_cmp(a));
        (0..4)
            .map(|steps| {
                let [x, y, z] = [0, 1, 2].map(|axis| f[axis] - if axis < steps { 1.0 } else { 0.0 });
                let skew = (x + y + z) / 6.0;
                let away = vec3(x - skew, y - skew, z - skew);
                let near = (0.5 - away.length_squared()).max(0.0) * SIMPLEX_SCALE.sqrt().sqrt();
                let slope = -8.0 * near * near * near * SIMPLEX_SCALE.sqrt().sqrt();
                (near * near * near * near, away * slope, away)
            })
            .collect()
    }

    /// Maximum value and slope, by a search from many starting points.
    fn search(parts: fn(Vec3<f32>) -> Vec<LatticePart>, score: impl Fn(&[LatticePart], Vec3<f32>) -> f32) -> f32 {
        let mut state = 1_u32;
        let mut random = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
            (((word >> 22) ^ word) >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        let mut point = move |size: f32| vec3(random(), random(), random()) * size;
        let mut greatest = 0.0_f32;
        for _ in 0..60 {
            let (mut p, mut u, mut best) = (point(0.5) + vec3(0.5, 0.5, 0.5), point(1.0), 0.0);
            for round in 0..2_000 {
                let size = [0.3, 0.1, 0.03, 0.01, 0.003][round / 400];
                let there = (p + point(size)).map(|c| c.clamp(0.0, 1.0));
                let along = (u + point(size)).normalize();
                let found = score(&parts(there), along);
                if found > best {
                    (p, u, best) = (there, along, found);
                }
            }
            greatest = greatest.max(best);
        }
        greatest
    }

    fn value(parts: &[LatticePart], _: Vec3<f32>) -> f32 {
        parts.iter().map(|&(weight, _, away)| weight * most(away)).sum()
    }

    fn slope(parts: &[LatticePart], u: Vec3<f32>) -> f32 {
        parts.iter().map(|&(weight, change, away)| most(u * weight + away * u.dot(change))).sum()
    }

    fn slope_of_values(parts: &[LatticePart], u: Vec3<f32>) -> f32 {
        parts.iter().map(|&(_, change, _)| u.dot(change).abs()).sum()
    }

    #[test]
    fn random_gradients_stay_within_ranges_and_lipschitz_factors() {
        for (name, found, said) in [
            ("perlin's range", search(cube_parts, value), 1.036_354),
            ("perlin's slope", search(cube_parts, slope), PERLIN_LIPSCHITZ),
            ("value noise's slope", search(cube_parts, slope_of_values), VALUE_LIPSCHITZ),
            ("simplex noise's range", search(simplex_parts, value), 1.0),
            ("simplex noise's slope", search(simplex_parts, slope), SIMPLEX_LIPSCHITZ),
        ] {
            assert!((0.999..1.000_01).contains(&(found / said)), "{name}: {found} was found, {said} is said");
        }
    }
}
