//! The Mandelbox: space folded at planes and at a ball.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{MAX_DERIVATIVE, clamp_to_hull, distance_from_box, iterations};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::limits::MAX_ITERATIONS;
use crate::nodes::Primitive;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Length, MandelboxScale};

/// The Mandelbox: fold at the sides of a cube, invert in a sphere, grow, add the point.
///
/// Tom Lowe's, <https://sites.google.com/site/mandelbox/what-is-a-mandelbox>; the distance estimate by a
/// running derivative is that of Buddhi and Rrrola, as in Mikael Christensen, "Distance Estimated 3D
/// Fractals", part VI: <http://blog.hvidtfeldts.net/index.php/2011/11/distance-estimated-3d-fractals-vi-the-mandelbox/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Mandelbox {
    /// Edge of the cube that contains it. All other lengths are in the formula's own units.
    pub size: Length,
    /// Growth of each iteration: 2 and −1.5 are the best known.
    pub scale: MandelboxScale,
    /// Maximum number of iterations: more give finer detail.
    #[schemars(range(min = 1, max = MAX_ITERATIONS))]
    #[serde(deserialize_with = "iterations")]
    pub iterations: u32,
    /// Coordinate at which space is folded.
    #[serde(default = "one")]
    pub fold: Length,
    /// Inside a ball of this radius the sphere fold only scales.
    #[serde(default = "default_min_radius")]
    pub min_radius: Length,
    /// Radius of the sphere that inverts the shell between it and the inner ball.
    #[serde(default = "one")]
    pub fixed_radius: Length,
}

/// Escape radius, in folds.
const ESCAPE_RADIUS: f32 = 40.0;
/// Distance at which a point that has not escaped counts as on the surface, in folds.
const SURFACE_RADIUS: f32 = 2.0;
/// Distance from the cube within which the estimate is used, in half edges.
const MARGIN: f32 = 0.25;

impl Primitive for Mandelbox {
    const EXAMPLE: &str = r#"{ "size": 1.36, "scale": 2, "iterations": 10 }"#;
    const MORE_EXAMPLES: &[&str] = &[
        r#"{ "size": 1.3, "scale": -1.5, "iterations": 12 }"#,
        r#"{ "size": 1.3, "scale": 3, "iterations": 8, "min_radius": 0.25, "fold": 0.9 }"#,
    ];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let half = self.size.in_frame() * 0.5;
        let from_cube = distance_from_box(p, vec3(half, half, half));
        clamp_to_hull(from_cube, MARGIN * half, || self.estimate(p))
    }

    fn exactness(&self) -> Exactness {
        Exactness::Estimate
    }

    fn validate(&self) -> Option<NodeError> {
        let (least, fixed, fold) = (self.min_radius.in_frame(), self.fixed_radius.in_frame(), self.fold.in_frame());
        if least > fixed {
            let cure = format!("is more than fixed_radius: make min_radius {fixed} or less");
            return Some(NodeError::new("min_radius", cure));
        }
        if fixed > 100.0 * least {
            let cure = format!("is less than a hundredth of fixed_radius: make min_radius {} or more", fixed * 0.01);
            return Some(NodeError::new("min_radius", cure));
        }
        let is_near = (0.01 * fold..=100.0 * fold).contains(&fixed);
        (!is_near).then(|| {
            let cure = format!("must be from fold/100 to fold·100: make fixed_radius {fold}");
            NodeError::new("fixed_radius", cure)
        })
    }

    fn is_fine(&self) -> bool {
        true
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let half = self.size.in_frame() * 0.5;
        Bounds::symmetric(half, half, half).expanded(isolevel)
    }
}

impl Mandelbox {
    fn estimate<R: Real>(&self, p: Vec3<R>) -> R {
        let (scale, fold) = (self.scale.in_frame(), self.fold.in_frame());
        // In units of the fold, so that all numbers are near 1.
        let unit = self.size.in_frame() * 0.5 / self.half_edge();
        let (least, fixed) = (self.min_radius.in_frame() / fold, self.fixed_radius.in_frame() / fold);
        let (least, fixed) = (p.x.uniform(least * least), p.x.uniform(fixed * fixed));
        let (growth, slope_growth) = (fixed * p.x.uniform(scale), fixed * p.x.uniform(scale.abs()));
        let start = p * p.x.uniform(1.0 / unit);
        let one = p.x.constant(1.0);
        let (_, squared, slope) = R::repeat(self.iterations, (start, one, one), |(z, _, slope)| {
            let folded = z.map(|c| c.at_least(-1.0).at_most(1.0).mul_add(c.constant(2.0), -c));
            let inverse = one / folded.length_squared().max(least).min(fixed);
            let z = folded.mul_add(inverse * growth, start);
            let slope = (inverse * slope_growth).mul_add(slope, one).at_most(MAX_DERIVATIVE);
            let squared = z.length_squared();
            (squared.below(ESCAPE_RADIUS * ESCAPE_RADIUS), (z, squared, slope))
        });
        (squared.sqrt() - SURFACE_RADIUS) / slope * p.x.uniform(unit)
    }

    /// Half the edge of the cube that contains it, in folds.
    ///
    /// Let x be one coordinate of the orbit, a that of the point, both in folds, and s the scale. For s > 1 and a =
    /// 2(s + 1)/(s − 1) + e the second step makes x < −2 and the third x ≥ a + s(s − 1)e, and so on, faster and
    /// faster, because no fold reduces a length by more than the growth increases it. For s < −1 and a = 2 + e each
    /// step multiplies x − 2 by at least |s|.
    fn half_edge(&self) -> f32 {
        let scale = self.scale.in_frame();
        if scale > 0.0 { 2.0 * (scale + 1.0) / (scale - 1.0) } else { 2.0 }
    }
}

fn one() -> Length {
    Length::new(1.0).expect("1 is in range")
}

fn default_min_radius() -> Length {
    Length::new(0.5).expect("0.5 is in range")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a point's orbit escapes, computed in folds and in double precision.
    fn escapes(p: [f64; 3], scale: f64) -> bool {
        let mut z = p;
        for _ in 0..400 {
            let folded = z.map(|c| 2.0 * c.clamp(-1.0, 1.0) - c);
            let factor = scale / folded.iter().map(|c| c * c).sum::<f64>().clamp(0.25, 1.0);
            z = [0, 1, 2].map(|axis| folded[axis] * factor + p[axis]);
            if z.iter().any(|c| c.abs() > 1e6) {
                return true;
            }
        }
        false
    }

    #[test]
    fn nothing_is_outside_the_cube() {
        for scale in [-3.0_f32, -2.0, -1.5, -1.1, 1.2, 1.5, 2.0, 3.0, 4.0] {
            let mandelbox: Mandelbox =
                serde_json::from_str(&format!(r#"{{ "size": 1, "scale": {scale}, "iterations": 9 }}"#)).unwrap();
            let half = f64::from(mandelbox.half_edge());
            let turn = |speed: f32, step: u32| f64::from(Real::sin(speed * step as f32)) * half;
            for step in 0..2_000 {
                let (y, z) = (turn(2.1, step), turn(0.7, step));
                let x = half * (1.001 + 0.01 * f64::from(step % 100));
                assert!(escapes([x, y, z], scale.into()), "({x}, {y}, {z}) stays with scale {scale}");
            }
        }
    }
}
