//! Perlin's noise, value noise and simplex noise: something random at the points of a lattice,
//! smoothly mixed in between.

use super::lattice::{Index, along_gradient, between_corners, cell, corner_words, from_corners, one_to_two};
use crate::real::{Real, Vec3, vec3};

// Each corner's gradient or value is drawn alone, so the steepest slope along a direction u at a point is the
// sum over the corners of the most that each can give: w·g·u + (u·∇w)·(g·d) for a gradient g at distance d with
// the weight w. The factors are the greatest of these sums over all points and directions; a test looks for greater.

/// Perlin's noise is steepest in the middle of a cell.
pub(super) const PERLIN_LIPSCHITZ: f32 = 3.750_1;
/// Value noise is steepest between two faces of opposite values: twice the quintic's greatest slope, 15/8.
pub(super) const VALUE_LIPSCHITZ: f32 = 3.750_1;
/// The greatest sum is 0.090620090 before it is scaled.
pub(super) const SIMPLEX_LIPSCHITZ: f32 = 0.090_621 * SIMPLEX_SCALE;

/// Ken Perlin, "Improving noise", SIGGRAPH 2002, <https://mrl.cs.nyu.edu/~perlin/paper445.pdf>:
/// gradients at the corners of unit cubes, mixed by a quintic.
#[inline(always)]
pub(super) fn perlin<R: Real>(p: Vec3<R>, seed: R) -> R {
    p.x.shared(
        "perlin",
        (p, seed),
        #[inline(always)]
        |(p, seed)| {
            let (corner, fraction) = cell(p);
            let words = corner_words(Index::pair(corner, seed));
            let away = from_corners(fraction);
            let mut corners = [seed; 8];
            for n in 0..8 {
                corners[n] = along_gradient(away[n], words[n]);
            }
            between_corners(corners, fraction)
        },
    )
}

/// Random values at the corners of unit cubes, −1 to 1, mixed by the same quintic.
#[inline(always)]
pub(super) fn value<R: Real>(p: Vec3<R>, seed: R) -> R {
    p.x.shared(
        "value_noise",
        (p, seed),
        #[inline(always)]
        |(p, seed)| {
            let (corner, fraction) = cell(p);
            let words = corner_words(Index::pair(corner, seed));
            let mut corners = [seed; 8];
            for n in 0..8 {
                corners[n] = one_to_two(words[n]);
            }
            between_corners(corners, fraction).mul_add(seed.splat(2.0), seed.splat(-3.0))
        },
    )
}

/// Twice this is the furthest cell of the lattice.
const FARTHEST: f32 = 2_097_151.0;
/// One over the most that the sum of a simplex's four corners can be, which is 0.013007157.
const SIMPLEX_SCALE: f32 = 76.88;

/// Simplex noise: Ken Perlin, "Noise hardware", in "Real-Time Shading", SIGGRAPH 2001 course notes; as in
/// Stefan Gustavson, "Simplex noise demystified", 2005,
/// <https://cgvr.cs.uni-bremen.de/teaching/cg_literatur/simplexnoise.pdf>, with the kernel (½ − r²)⁴, which
/// is continuous.
#[inline(always)]
pub(super) fn simplex<R: Real>(p: Vec3<R>, seed: R) -> R {
    p.x.shared(
        "simplex",
        (p, seed),
        #[inline(always)]
        |(p, seed)| {
            let (one, none) = (seed.splat(1.0), seed.splat(0.0));
            // Skewed, the lattice is one of cubes, each cut into six simplices by the order of the coordinates.
            let p = p.map(
                #[inline(always)]
                |c| c.at_least(-FARTHEST).at_most(FARTHEST),
            );
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
                let near = (seed.splat(0.5) - away.length_squared()).at_least(0.0);
                let kernel = near.square().square();
                let word = Index::new(corner + step, seed).word();
                sum = kernel.mul_add(along_gradient(away, word), sum);
            }
            sum * SIMPLEX_SCALE
        },
    )
}
