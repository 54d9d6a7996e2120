//! The Sierpiński tetrahedron.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{folds, iterations};
use crate::bounds::Bounds;
use crate::limits::MAX_ITERATIONS;
use crate::nodes::Primitive;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Length;

/// The Sierpiński tetrahedron: four of half the size at its corners, recursively.
///
/// By folds as in Mikael Christensen, "Distance Estimated 3D Fractals", part III:
/// <http://blog.hvidtfeldts.net/index.php/2011/08/distance-estimated-3d-fractals-iii-folding-space/>, with a
/// full tetrahedron at the end. Exact: the quarter of space around a corner contains the tetrahedron there, and the
/// other three are its mirror images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Sierpinski {
    /// Edge of the cube of whose corners four are the tetrahedron's; one of them has the greatest x, y and z.
    pub size: Length,
    /// Number of subdivisions of the tetrahedra.
    #[schemars(range(min = 1, max = MAX_ITERATIONS))]
    #[serde(deserialize_with = "iterations")]
    pub iterations: u32,
}

impl Primitive for Sierpinski {
    const EXAMPLE: &str = r#"{ "size": 1.36, "iterations": 5 }"#;
    const MORE_EXAMPLES: &[&str] = &[r#"{ "size": 1.3, "iterations": 1 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let half = p.x.uniform(self.size.get() * 0.5);
        // Below this size no f32 distinguishes two neighboring tetrahedra.
        let finest = p.x.uniform(self.size.get() * 1e-8);
        let (place, half) = R::repeat(self.iterations, (p, half), |(place, half)| {
            let half = half * 0.5;
            let place = folds::tetrahedral(place) - vec3(half, half, half);
            (finest.lt(half), (place, half))
        });
        tetrahedron(folds::tetrahedral(place), half)
    }

    fn is_fine(&self) -> bool {
        true
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let half = self.size.in_frame() * 0.5;
        Bounds::symmetric(half, half, half).expanded(isolevel)
    }
}

/// The distance to the tetrahedron in a cube of this half edge, from a point whose nearest corner is that of (1, 1, 1).
///
/// `high`, `middle`, `low` are the coordinates in descending order. The nearest edge ends there and runs
/// through `high` = half; the nearest face is below it.
fn tetrahedron<R: Real>(p: Vec3<R>, half: R) -> R {
    const PER_ROOT_2: f32 = std::f32::consts::FRAC_1_SQRT_2;
    const PER_ROOT_3: f32 = 0.577_350_26;
    const PER_ROOT_6: f32 = 0.408_248_3;
    let high = p.max_element();
    let low = p.x.min(p.y).min(p.z);
    let middle = folds::middle(p);
    let (above, across) = (high - half, middle - low);
    let from_face = (above + across) * PER_ROOT_3;
    // Along the face from the edge, and along the edge from its center.
    let inwards = (across - above * 2.0) * PER_ROOT_6;
    let past_corner = ((middle + low - half * 2.0) * PER_ROOT_2).at_least(0.0);
    let from_edge = from_face.square_add(inwards.square_add(past_corner.square())).sqrt();
    R::select(inwards.below(0.0), from_edge, from_face)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Minimum distance to any of the tetrahedra, computed without folding more than once.
    fn by_all(p: Vec3<f32>, half: f32, iterations: u32) -> f32 {
        const CORNERS: [[f32; 3]; 4] = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
        if iterations == 0 {
            return tetrahedron(folds::tetrahedral(p), half);
        }
        let part = half * 0.5;
        let at = |[x, y, z]: [f32; 3]| by_all(p - vec3(x * part, y * part, z * part), part, iterations - 1);
        CORNERS.map(at).into_iter().fold(f32::INFINITY, f32::min)
    }

    fn places() -> impl Iterator<Item = Vec3<f32>> {
        let turn = |speed: f32, step: u32| 1.2 * Real::sin(speed * step as f32);
        (0..400).map(move |step| vec3(turn(1.3, step), turn(2.1, step), turn(0.7, step)))
    }

    fn with(iterations: u32) -> Sierpinski {
        Sierpinski { size: Length::new(1.5).unwrap(), iterations }
    }

    #[test]
    fn folds_find_the_nearest_of_all_tetrahedra() {
        for iterations in 1..6 {
            for p in places() {
                let (got, want) = (with(iterations).distance(p), by_all(p, 0.75, iterations));
                assert!((got - want).abs() < 2e-6, "{iterations} iterations at {p:?}: {got}, by all {want}");
            }
        }
    }

    #[test]
    fn finer_tetrahedra_are_inside_coarser_ones() {
        for p in places() {
            let mut coarser = with(1).distance(p);
            for iterations in 2..=MAX_ITERATIONS {
                let finer = with(iterations).distance(p);
                assert!(finer >= coarser - 1e-6, "{iterations} iterations at {p:?}: {finer} after {coarser}");
                coarser = finer;
            }
        }
    }
}
