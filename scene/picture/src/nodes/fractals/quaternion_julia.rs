//! Julia sets of quaternions.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{clamp_to_hull, iterations};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::limits::MAX_ITERATIONS;
use crate::nodes::Primitive;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Coordinate;

/// The filled Julia set of z → z² + c for quaternions, cut where the last part is 0.
///
/// John C. Hart, Daniel J. Sandin, Louis H. Kauffman, "Ray tracing deterministic 3-D fractals", Computer Graphics
/// 23(3) (SIGGRAPH), 1989: <https://www.evl.uic.edu/hypercomplex/html/book/rtqjs.pdf>. The distance estimate is
/// ½·|z|·ln |z|/|z′| with |z′| → 2·|z|·|z′|. The potential of the escape radius in the last iteration, where the solid
/// ends, is subtracted from the potential ln |z|/2ⁿ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct QuaternionJulia {
    /// The quaternion c: its real part, along x, and its parts along y, z and the invisible fourth axis; of length 2
    /// or less.
    pub c: [Coordinate; 4],
    /// Maximum number of iterations: more give finer detail.
    #[schemars(range(min = 1, max = MAX_ITERATIONS))]
    #[serde(deserialize_with = "iterations")]
    pub iterations: u32,
}

/// Square of the escape radius.
const ESCAPE_SQUARED: f32 = 256.0;
/// Logarithm of that square.
const ESCAPE_LOGARITHM: f32 = 5.545_177_5;
/// Keeps the square of a derivative where a quotient by it still has a root.
const MAX_DERIVATIVE_SQUARED: f32 = 1e26;
/// Distance from the bounding ball within which the estimate is used.
const MARGIN: f32 = 0.25;

impl Primitive for QuaternionJulia {
    const EXAMPLE: &str = r#"{ "c": [-0.2, 0.6, 0.2, 0.2], "iterations": 12 }"#;
    const MORE_EXAMPLES: &[&str] = &[
        r#"{ "c": [-0.213, -0.041, -0.563, -0.56], "iterations": 10 }"#,
        r#"{ "c": [0, 0, 0, 0], "iterations": 64 }"#,
    ];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        clamp_to_hull(p.length() - p.x.uniform(self.bounding_radius()), MARGIN, || self.estimate(p))
    }

    fn exactness(&self) -> Exactness {
        Exactness::Estimate
    }

    fn validate(&self) -> Option<NodeError> {
        (self.length() > 2.0).then(|| {
            let cure = "is longer than 2, so the set is only dust: make the sum of its squares 4 or less";
            NodeError::new("c", cure)
        })
    }

    fn is_fine(&self) -> bool {
        true
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let reach = self.bounding_radius() + isolevel;
        Bounds::symmetric(reach, reach, reach)
    }
}

impl QuaternionJulia {
    fn estimate<R: Real>(&self, p: Vec3<R>) -> R {
        let [real, x, y, z] = self.c.each_ref().map(Coordinate::in_frame);
        let real = p.x.uniform(real);
        let imaginary = Vec3::uniform(p.x, vec3(x, y, z));
        let start = vec3(p.y, p.z, p.x.constant(0.0));
        let squared = p.length_squared();
        // Points that have not escaped by the last iteration are solid: their potential is at most ln
        // E/2ᴺ.
        let isolevel = p.x.uniform(ESCAPE_LOGARITHM / (1_u64 << self.iterations.min(63)) as f32);
        let (_, _, squared, slope, isolevel) = R::repeat(
            self.iterations,
            (p.x, start, squared, p.x.constant(1.0), isolevel),
            |(a, v, squared, slope, isolevel)| {
                // Orbits do not diverge at 0, but they do near it.
                let slope = ((squared * 4.0).at_least(1.0) * slope).at_most(MAX_DERIVATIVE_SQUARED);
                let next = a.square_add(real) - v.length_squared();
                let v = v.mul_add(a * 2.0, imaginary);
                let squared = next.square_add(v.length_squared());
                (squared.below(ESCAPE_SQUARED), (next, v, squared, slope, isolevel * 2.0))
            },
        );
        let squared = squared.at_least(1e-12);
        (squared / slope).sqrt() * (squared.ln() - isolevel) * 0.25
    }

    fn length(&self) -> f32 {
        let [a, x, y, z] = self.c.each_ref().map(Coordinate::in_frame);
        Real::sqrt(a * a + x * x + y * y + z * z)
    }

    /// Radius of the ball that contains it: where |z|² − |c| = |z|, beyond which orbits only grow.
    fn bounding_radius(&self) -> f32 {
        0.5 + 0.5 * Real::sqrt(1.0 + 4.0 * self.length())
    }
}
