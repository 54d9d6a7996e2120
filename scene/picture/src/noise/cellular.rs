//! Cellular noise: distance to the nearest of points scattered one per cell.
//!
//! Steven Worley, "A cellular texture basis function", SIGGRAPH 1996, <https://doi.org/10.1145/237170.237267>.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lattice::{LatticeHash, cell};
use crate::real::{FunctionKey, Real, Vec3, vec3};
use crate::seek::Seek;

/// Value computed from the distances to the nearest points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// The distance to the nearest point, in cells, at most 1.
    #[default]
    F1,
    /// Difference of the distances to the second and the nearest point: 0 on the walls between cells.
    F2MinusF1,
}

/// Squared distances to the nearest and the second point, each at most 1. Any point nearer than 1 is in the
/// cell or one of the 26 around it, so there is no step at the edge of the search.
fn f1_f2_squared<R: Real>(p: Vec3<R>, seed: R) -> (R, R) {
    p.x.call(FunctionKey::new("cellular"), (p, seed), |(p, seed)| {
        let (corner, fraction) = cell(p);
        let (mut first, mut second) = (seed.constant(1.0), seed.constant(1.0));
        for place in 0..27_u8 {
            let step = [place % 3, place / 3 % 3, place / 9].map(|n| f32::from(n) - 1.0);
            let step = vec3(seed.constant(step[0]), seed.constant(step[1]), seed.constant(step[2]));
            let word = LatticeHash::new(corner + step, seed).mixed_hash();
            let point = vec3(
                R::from_bits((word >> 9) | 0x3f80_0000),
                R::from_bits(((word << 1) & 0x007f_ffff) | 0x3f80_0000),
                R::from_bits(((word << 11) & 0x007f_ffff) | 0x3f80_0000),
            );
            let from = fraction - step;
            let away = vec3(from.x + 1.0, from.y + 1.0, from.z + 1.0) - point;
            let distance = away.length_squared();
            second = second.min(first.max(distance));
            first = first.min(distance);
        }
        (first, second)
    })
}

/// Cellular noise, 0 to 1.
pub(super) fn cellular<R: Real>(p: Vec3<R>, seed: R, feature: Feature) -> R {
    let (first, second) = f1_f2_squared(p, seed);
    match feature {
        Feature::F1 => first.sqrt(),
        Feature::F2MinusF1 => second.sqrt() - first.sqrt(),
    }
}
