//! The Apollonian gasket of spheres.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{MAX_DERIVATIVE, clamp_to_hull, folds, iterations};
use crate::bounds::Bounds;
use crate::kinds::Exactness;
use crate::limits::MAX_ITERATIONS;
use crate::nodes::Primitive;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Length;

/// The Apollonian gasket in space: a ball packed with four equal balls that touch, and every remaining space with the
/// largest ball that fits, to infinity.
///
/// The packing is Frederick Soddy's, "The bowl of integers and the hexlet", Nature 139, 1937, and its group of
/// inversions David W. Boyd's, "The osculatory packing of a three dimensional sphere", Canadian Journal of
/// Mathematics 25, 1973. Space is folded by those inversions with a running derivative, as Knighty and
/// Inigo Quilez do: <https://iquilezles.org/articles/distancefractals/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct ApollonianGasket {
    /// Radius of the ball that is packed.
    pub radius: Length,
    /// Number of inversions that lead to the smallest balls.
    #[schemars(range(min = 1, max = MAX_ITERATIONS))]
    #[serde(deserialize_with = "iterations")]
    pub iterations: u32,
}

/// Coordinate of the center of the ball toward (1, 1, 1), where each of the four balls has radius 1.
const BALL_CENTER: f32 = std::f32::consts::FRAC_1_SQRT_2;
/// Radius of the ball around all four: 1 + √(3/2).
const HULL_RADIUS: f32 = 2.224_744_9;
/// Square of the radius of the sphere through the points where the four touch.
const CORE_RADIUS_SQUARED: f32 = 0.5;
/// Square of a radius inside the center ball, whose radius is ½/`HULL_RADIUS` and to which the hull is inverted.
const INNER_RADIUS_SQUARED: f32 = 0.02;
/// Coordinates of the center of the sphere through the points where the hull touches three of the balls, without the
/// ball toward (1, 1, 1). It is at right angles to all of them, so its center is (1/2 + `HULL_RADIUS`²)·√(3/2) from the
/// origin.
const OUTER_CENTER: f32 = -3.853_372_6;
/// Square of that sphere's radius: 3·`OUTER_CENTER`² − `HULL_RADIUS`².
const FAR_SQUARED: f32 = 39.595_917;
/// Distance from the hull within which the estimate is used, in radii of the hull.
const MARGIN: f32 = 0.25;
/// Greater than any distance from a ball.
const NOWHERE: f32 = 1e3;

impl Primitive for ApollonianGasket {
    const EXAMPLE: &str = r#"{ "radius": 1.15, "iterations": 4 }"#;
    const MORE_EXAMPLES: &[&str] = &[r#"{ "radius": 1, "iterations": 1 }"#, r#"{ "radius": 1, "iterations": 64 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let radius = self.radius.in_frame();
        clamp_to_hull(p.length() - p.x.uniform(radius), MARGIN * radius, || self.estimate(p))
    }

    fn exactness(&self) -> Exactness {
        Exactness::Estimate
    }

    /// Maximum ratio of the estimate (distance from a ball at its last position over the derivative) to the distance
    /// from the original ball: tested against a list of all balls.
    fn lipschitz(&self) -> f32 {
        1.25
    }

    fn is_fine(&self) -> bool {
        true
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let reach = self.radius.in_frame() + isolevel;
        Bounds::symmetric(reach, reach, reach)
    }
}

impl ApollonianGasket {
    fn estimate<R: Real>(&self, p: Vec3<R>) -> R {
        let one = p.x.constant(1.0);
        let far = vec3(one * OUTER_CENTER, one * OUTER_CENTER, one * OUTER_CENTER);
        let start = p * p.x.uniform(HULL_RADIUS / self.radius.get());
        let (place, slope, hull) =
            R::repeat(self.iterations, (start, one, one.constant(NOWHERE)), |(place, slope, hull)| {
                // Opposite to (1, 1, 1), toward the center of the sphere that leaves out that ball.
                let away = -folds::tetrahedral(-place) - far;
                let squared = away.length_squared();
                let outer =
                    R::select(squared.below(FAR_SQUARED), one.constant(FAR_SQUARED) / squared.at_least(1.0), one);
                let place = away.mul_add(outer, far);
                let squared = place.length_squared();
                let is_in_core = squared.below(CORE_RADIUS_SQUARED);
                let is_deep = squared.below(INNER_RADIUS_SQUARED);
                let inner = one.constant(CORE_RADIUS_SQUARED) / squared.at_least(INNER_RADIUS_SQUARED);
                let inner = R::select(is_in_core & !is_deep, inner, one);
                // From here on the hull represents a ball inside; deep inside that ball no inversion is needed.
                let hull = R::select(is_in_core, one.constant(HULL_RADIUS), hull);
                let hull = R::select(is_deep, -one, hull);
                let slope = (slope * outer * inner).at_most(MAX_DERIVATIVE);
                ((outer * inner).above(1.0), (place * inner, slope, hull))
            });
        let from_ball =
            (folds::tetrahedral(place) - vec3(one * BALL_CENTER, one * BALL_CENTER, one * BALL_CENTER)).length() - 1.0;
        let nearest = from_ball.min(hull - place.length());
        nearest / slope * p.x.uniform(self.radius.get() / HULL_RADIUS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sphere, in units in which the four balls have radius 1.
    #[derive(Clone, Copy)]
    struct Ball {
        middle: Vec3<f32>,
        radius: f32,
    }

    const CORNERS: [[f32; 3]; 4] = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];

    fn ball([x, y, z]: [f32; 3], coordinate: f32, radius: f32) -> Ball {
        Ball { middle: vec3(x * coordinate, y * coordinate, z * coordinate), radius }
    }

    impl Ball {
        fn inverted_at(self, mirror: Ball) -> Ball {
            let away = self.middle - mirror.middle;
            let factor = mirror.radius * mirror.radius / (away.length_squared() - self.radius * self.radius);
            Ball { middle: away.mul_add(factor, mirror.middle), radius: self.radius * factor.abs() }
        }

        fn is(self, other: Ball) -> bool {
            (self.middle - other.middle).length() < 1e-3 && (self.radius - other.radius).abs() < 1e-3
        }
    }

    /// All balls after `inversions` inversions, except those smaller than `least`.
    fn packing(inversions: u32, least: f32) -> Vec<Ball> {
        let mut mirrors = vec![ball([0.0; 3], 0.0, CORE_RADIUS_SQUARED.sqrt())];
        mirrors.extend(CORNERS.map(|corner| ball(corner, OUTER_CENTER, FAR_SQUARED.sqrt())));
        let mut all = vec![ball([0.0; 3], 0.0, HULL_RADIUS)];
        all.extend(CORNERS.map(|corner| ball(corner, BALL_CENTER, 1.0)));
        let mut newest = all.clone();
        for _ in 0..inversions {
            let mut next: Vec<Ball> = Vec::new();
            for (one, mirror) in newest.iter().flat_map(|one| mirrors.iter().map(move |mirror| (one, mirror))) {
                let made = one.inverted_at(*mirror);
                if made.radius >= least && !all.iter().chain(&next).any(|known| known.is(made)) {
                    next.push(made);
                }
            }
            all.extend(&next);
            newest = next;
        }
        all.remove(0);
        all
    }

    fn places() -> impl Iterator<Item = Vec3<f32>> {
        let turn = |speed: f32, step: u32| HULL_RADIUS * Real::sin(speed * step as f32);
        let all = (0..40_000).map(move |step| vec3(turn(1.3, step), turn(2.1, step), turn(0.7, step)));
        all.filter(|p| p.length() < HULL_RADIUS)
    }

    #[test]
    fn balls_of_the_packing_touch_and_do_not_overlap() {
        let all = packing(4, 0.15);
        assert!(all.len() > 50, "{} balls", all.len());
        for (index, a) in all.iter().enumerate() {
            assert!(
                a.middle.length() + a.radius < HULL_RADIUS + 1e-4,
                "{a:?} leaves the hull",
                a = (a.middle, a.radius)
            );
            for b in &all[..index] {
                let gap = (a.middle - b.middle).length() - a.radius - b.radius;
                assert!(gap > -1e-3, "{:?} and {:?} overlap by {gap}", (a.middle, a.radius), (b.middle, b.radius));
            }
        }
    }

    #[test]
    fn no_estimate_exceeds_the_distance_to_the_nearest_ball() {
        let balls = packing(8, 0.06);
        for iterations in [1, 2, 3] {
            let gasket = ApollonianGasket { radius: Length::new(HULL_RADIUS).unwrap(), iterations };
            // A few inversions do not reach all balls.
            let solid: Vec<&Ball> = balls.iter().filter(|ball| gasket.distance(ball.middle) < 0.0).collect();
            let (mut outside, mut worst) = (0, (0.0, vec3(0.0, 0.0, 0.0)));
            for p in places() {
                let value = gasket.distance(p);
                let gap = |ball: &&Ball| (p - ball.middle).length() - ball.radius;
                let nearest = solid.iter().map(gap).fold(f32::INFINITY, f32::min);
                assert!(nearest > -1e-4 || value < 0.0, "{p:?} is {nearest} inside a ball, but {value} away");
                // If a ball too small for the list is nearest, it decides the value.
                if nearest > 1e-3 && value > 0.0 {
                    outside += 1;
                    worst = if value / nearest > worst.0 { (value / nearest, p) } else { worst };
                }
            }
            assert!(outside > 1_000, "only {outside} points are outside all balls");
            assert!(worst.0 <= Primitive::lipschitz(&gasket), "{worst:?} with {iterations} iterations");
        }
    }
}
