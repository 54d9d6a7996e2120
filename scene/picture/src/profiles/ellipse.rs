//! The ellipse: its nearest point has no short formula and is found by iteration.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Bounds2, ProfileSdf};
use crate::real::Real;
use crate::seek::Seek;
use crate::values::Length;

/// Maximum number of Newton steps; the largest number found was 17, near the center of curvature of a thin ellipse's
/// end.
const MAX_STEPS: u32 = 24;
/// Tolerance of the nearest point, as a fraction of the ellipse's size.
const TOLERANCE: f32 = 1e-6;

/// An ellipse around the origin, its axes along x and y.
///
/// With half axes a ≥ b, the point nearest to (x, y) is (a²x/(s + a² − b²), b²y/s) for the greatest s that puts it on
/// the ellipse: David Eberly, "Distance from a Point to an Ellipse, an Ellipsoid, or a Hyperellipsoid",
/// <https://www.geometrictools.com/Documentation/DistancePointEllipseEllipsoid.pdf>. That s is found from below by
/// Newton's method on one over the norm, as Moré and Sorensen do in "Computing a Trust Region Step",
/// <https://doi.org/10.1137/0904038>. It takes three steps nearly everywhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Ellipse {
    /// Full extents along x and y.
    pub size: [Length; 2],
}

impl ProfileSdf for Ellipse {
    const EXAMPLE: &str = r#"{ "size": [2.2, 1.2] }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[r#"{ "size": [0.3, 2] }"#, r#"{ "size": [1.4, 1.4] }"#];

    fn is_symmetric(&self) -> bool {
        true
    }

    fn distance<R: Real>(&self, x: R, y: R) -> R {
        let [width, height] = self.size.each_ref().map(|extent| extent.in_frame() / 2.0);
        let (a, b) = (width.max(height), width.min(height));
        let is_tall = x.uniform(width).lt(x.uniform(height));
        let (along, across) = (R::select(is_tall, y, x).abs(), R::select(is_tall, x, y).abs());
        // Never exactly on the long axis, where s would be 0.
        let across = across.max(x.uniform(b * TOLERANCE));
        let eccentric = x.uniform((a - b) * (a + b));
        let (along_a, across_b) = (along * x.uniform(a), across * x.uniform(b));
        // For either of these the point is on the ellipse's bounding square or outside it.
        let start = (along_a - eccentric).max(across_b);
        let s = R::repeat(MAX_STEPS, start, |s| {
            let one = s.constant(1.0);
            let (over_long, over_short) = (one / (s + eccentric), one / s);
            let (u, v) = ((along_a * over_long).square(), (across_b * over_short).square());
            let square = u + v;
            let excess = (square.sqrt() - 1.0).at_least(0.0);
            let step = excess * square / u.mul_add(over_long, v * over_short);
            (excess.above(TOLERANCE), s + step)
        });
        // From the nearest point it is (s − b²) times the ellipse's normal there.
        let one = s.constant(1.0);
        let normal = (along * (one / (s + eccentric))).square_add((across * (one / s)).square()).sqrt();
        (s - x.uniform(b * b)) * normal
    }

    fn extent(&self, isolevel: f32) -> Bounds2 {
        let [width, height] = &self.size;
        Bounds2::symmetric(width.in_frame() / 2.0, height.in_frame() / 2.0).widened(isolevel)
    }
}
