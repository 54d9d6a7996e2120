//! Kaleidoscopic iterated function systems.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{folds, iterations};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::limits::MAX_ITERATIONS;
use crate::nodes::Primitive;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{GrowthFactor, Point, Rotation};

/// A kaleidoscopic iterated function system: rotate, fold, rotate, and grow about a point, repeatedly.
///
/// Knighty's, <http://www.fractalforums.com/sierpinski-gasket/kaleidoscopic-(escape-time-ifs)/>, as in Mikael
/// Christensen, "Distance Estimated 3D Fractals", part III:
/// <http://blog.hvidtfeldts.net/index.php/2011/08/distance-estimated-3d-fractals-iii-folding-space/>. After
/// the last iteration, balls remain: the bounding ball scaled down by scaleⁿ. A bound: every step except the
/// growth preserves lengths.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct KaleidoscopicIfs {
    /// Planes in which space is folded.
    pub folds: KaleidoscopicFolds,
    /// Growth of each iteration: 2 and 3 give the classical shapes.
    pub scale: GrowthFactor,
    /// The fixed point of the growth. The ball around the origin through it contains the shape.
    pub offset: Point,
    /// A rotation before the folds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turn_before: Option<Box<Rotation>>,
    /// A rotation after the folds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turn_after: Option<Box<Rotation>>,
    /// Number of iterations.
    #[schemars(range(min = 1, max = MAX_ITERATIONS))]
    #[serde(deserialize_with = "iterations")]
    pub iterations: u32,
}

/// Planes in which a kaleidoscopic system folds space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum KaleidoscopicFolds {
    /// The mirror planes between a corner of a tetrahedron and the others: with offset (1, 1, 1), Sierpiński's
    /// tetrahedron.
    Tetrahedral,
    /// All mirror planes of a cube: with offset (1, 0, 0), Sierpiński's octahedron.
    Octahedral,
    /// The planes of a tetrahedron, and one between the center and the end of an edge: with scale 3 and offset (1, 1,
    /// 1), Menger's sponge.
    MengerLike,
}

impl Primitive for KaleidoscopicIfs {
    const EXAMPLE: &str = r#"{ "folds": "menger_like", "scale": 3, "offset": [0.66, 0.66, 0.66],
        "turn_before": [0, 0, 12], "turn_after": [8, 0, 0], "iterations": 8 }"#;
    const MORE_EXAMPLES: &[&str] = &[
        r#"{ "folds": "tetrahedral", "scale": 2, "offset": [0.65, 0.65, 0.65], "turn_before": [0, 20, 0], "iterations": 12 }"#,
        r#"{ "folds": "octahedral", "scale": 2, "offset": [1.1, 0, 0], "turn_after": [15, 0, 25], "iterations": 12 }"#,
        r#"{ "folds": "menger_like", "scale": 3, "offset": [0.66, 0.66, 0.66], "iterations": 64 }"#,
    ];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let offset = self.offset.in_frame();
        let scale = self.scale.in_frame();
        // Space is not scaled; the step of each iteration shrinks instead, so that no value overflows.
        let share = (scale - 1.0) / scale;
        let step = Vec3::uniform(p.x, offset.map(|c| c * share));
        let shrink = p.x.uniform(1.0 / scale);
        let (place, size) = R::repeat(self.iterations, (p, p.x.constant(1.0)), |(place, size)| {
            let place = rotated_by(place, self.turn_before.as_deref());
            let place = match self.folds {
                KaleidoscopicFolds::Tetrahedral => folds::tetrahedral(place),
                KaleidoscopicFolds::Octahedral | KaleidoscopicFolds::MengerLike => folds::octahedral(place),
            };
            let place = rotated_by(place, self.turn_after.as_deref());
            let step = step * size;
            let place = match self.folds {
                KaleidoscopicFolds::Tetrahedral | KaleidoscopicFolds::Octahedral => place - step,
                KaleidoscopicFolds::MengerLike => {
                    let mirror = step.z * 0.5;
                    vec3(place.x - step.x, place.y - step.y, mirror - (place.z - mirror).abs())
                }
            };
            // Smaller balls are below the precision of f32.
            let size = size * shrink;
            (size.above(1e-9), (place, size))
        });
        size.mul_add(-p.x.uniform(self.bounding_radius()), place.length())
    }

    fn exactness(&self) -> Exactness {
        Exactness::Bound
    }

    fn validate(&self) -> Option<NodeError> {
        let is_nothing = self.offset.in_frame().map(f32::abs).max_element() < 1e-6;
        is_nothing.then(|| NodeError::new("offset", "has no length, so the shape has no size: make a coordinate 1"))
    }

    fn is_fine(&self) -> bool {
        true
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        // A step multiplies a length by scale and subtracts |offset|·(scale − 1): beyond |offset| no orbit returns.
        let reach = self.bounding_radius() + isolevel;
        Bounds::symmetric(reach, reach, reach)
    }
}

impl KaleidoscopicIfs {
    /// Radius of the ball that contains it.
    fn bounding_radius(&self) -> f32 {
        self.offset.in_frame().length()
    }
}

/// The point, rotated if there is a rotation.
fn rotated_by<R: Real>(p: Vec3<R>, rotation: Option<&Rotation>) -> Vec3<R> {
    match rotation {
        Some(rotation) => {
            let [x, y, z] = rotation.inverse_rows();
            vec3(p.dot_uniform(x), p.dot_uniform(y), p.dot_uniform(z))
        }
        None => p,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nodes::Node;

    /// Checks that a system's balls contain all of a classical shape, and extend beyond it by no more than their size.
    fn check(system: &str, shape: &str, ball: f32) {
        let [system, shape]: [Node; 2] = [system, shape].map(|text| serde_json::from_str(text).unwrap());
        let turn = |speed: f32, step: u32| Real::sin(speed * step as f32);
        let mut inside = 0;
        for step in 0..100_000 {
            let p = vec3(turn(1.3, step), turn(2.1, step), turn(0.7, step));
            let (value, known) = (system.distance(p), shape.distance(p));
            if known < 0.0 {
                inside += 1;
                assert!(value < 1e-6, "{p:?} is in the shape, but {value} away from the system's balls");
            }
            assert!(value > 0.0 || known <= ball, "{p:?} is in a ball, but {known} away from the shape");
        }
        assert!(inside > 1_000, "only {inside} points are inside");
    }

    #[test]
    fn folds_of_a_cube_give_the_menger_sponge() {
        check(
            r#"{ "kaleidoscopic_ifs": { "folds": "menger_like", "scale": 3, "offset": [0.9, 0.9, 0.9], "iterations": 3 } }"#,
            r#"{ "menger_sponge": { "size": 1.8, "iterations": 3 } }"#,
            0.9 * 1.733 / 27.0,
        );
    }

    #[test]
    fn folds_of_a_tetrahedron_give_the_sierpinski_tetrahedron() {
        check(
            r#"{ "kaleidoscopic_ifs": { "folds": "tetrahedral", "scale": 2, "offset": [0.9, 0.9, 0.9], "iterations": 3 } }"#,
            r#"{ "sierpinski": { "size": 1.8, "iterations": 3 } }"#,
            0.9 * 1.733 / 8.0,
        );
    }
}
