//! The Menger sponge.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{distance_from_box, folds, iterations};
use crate::bounds::Bounds;
use crate::kinds::Exactness;
use crate::limits::MAX_ITERATIONS;
use crate::nodes::Primitive;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Length;

/// The Menger sponge: a cube minus crosses of square bars of ever smaller sizes.
///
/// After Inigo Quilez, "Menger fractal": <https://iquilezles.org/articles/menger/>; cells are found by
/// reflections, which leave no seams. A bound: the greatest of the distances to the cube and into the bars,
/// each with Lipschitz factor 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct MengerSponge {
    /// Edge of the cube.
    pub size: Length,
    /// Number of sizes of bars that are removed.
    #[schemars(range(min = 1, max = MAX_ITERATIONS))]
    #[serde(deserialize_with = "iterations")]
    pub iterations: u32,
}

impl Primitive for MengerSponge {
    const EXAMPLE: &str = r#"{ "size": 1.36, "iterations": 4 }"#;
    const MORE_EXAMPLES: &[&str] = &[r#"{ "size": 1.3, "iterations": 1 }"#, r#"{ "size": 1.3, "iterations": 64 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let half = self.size.in_frame() * 0.5;
        let cube = distance_from_box(p, vec3(half, half, half));
        let place = vec3(p.x.abs(), p.y.abs(), p.z.abs());
        // Bars are a third of their cell wide: `third` is the width, half of it the greatest depth.
        let third = p.x.uniform(self.size.get() / 3.0);
        let (_, _, distance) = R::repeat(self.iterations, (place, third, cube), |(place, third, distance)| {
            // In a bar along an axis the other two coordinates are small.
            let bars = third.mul_add(third.constant(0.5), -folds::middle(place));
            let distance = distance.max(bars);
            // Relative to the center of the nearest of three cells in a row.
            let place = place.map(|c| c.min((c - third).abs()));
            let third = third * (1.0 / 3.0);
            // Smaller bars have no effect if they do not extend that far.
            (distance.lt(third * 0.5), (place, third, distance))
        });
        distance
    }

    fn exactness(&self) -> Exactness {
        Exactness::Bound
    }

    fn is_fine(&self) -> bool {
        true
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let half = self.size.in_frame() * 0.5;
        Bounds::symmetric(half, half, half).expanded(isolevel)
    }
}
