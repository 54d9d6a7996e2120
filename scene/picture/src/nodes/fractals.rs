//! Fractals: shapes with infinite detail, limited to a number of iterations.
//!
//! Fractals built from length-preserving folds and one scale have an exact distance or a bound. The others have an
//! estimate: the distance of a point's orbit, divided by the rate at which orbits diverge there.

mod apollonian_gasket;
mod folds;
mod kaleidoscopic_ifs;
mod mandelbox;
mod mandelbrot_relief;
mod mandelbulb;
mod menger_sponge;
mod quaternion_julia;
mod sierpinski;

pub use apollonian_gasket::ApollonianGasket;
pub use kaleidoscopic_ifs::{KaleidoscopicFolds, KaleidoscopicIfs};
pub use mandelbox::Mandelbox;
pub use mandelbrot_relief::MandelbrotRelief;
pub use mandelbulb::Mandelbulb;
pub use menger_sponge::MengerSponge;
pub use quaternion_julia::QuaternionJulia;
pub use sierpinski::Sierpinski;

use super::Node;
use crate::limits::MAX_ITERATIONS;
use crate::real::{Real, Vec3, vec3};

impl Node {
    /// Whether it has a fractal.
    pub fn has_fractal(&self) -> bool {
        match self {
            Self::ApollonianGasket(_)
            | Self::KaleidoscopicIfs(_)
            | Self::Mandelbox(_)
            | Self::MandelbrotRelief(_)
            | Self::Mandelbulb(_)
            | Self::MengerSponge(_)
            | Self::QuaternionJulia(_)
            | Self::Sierpinski(_) => true,
            _ => self.children().iter().any(Self::has_fractal),
        }
    }
}

/// Keeps the growth of a derivative within the range of a divisor.
const MAX_DERIVATIVE: f32 = 1e30;

/// Clamps an estimate to the distance from a simple hull of the fractal. Farther than `margin` from the hull
/// the hull's distance is used, which is never more than the fractal's; nearer, the greater of the two is
/// used, so that parts of an unfinished fractal outside its hull are cut off.
fn clamp_to_hull<R: Real>(from_hull: R, margin: f32, estimate: impl FnOnce() -> R) -> R {
    R::when(!from_hull.uniform(margin).lt(from_hull), from_hull, || estimate().max(from_hull))
}

/// The distance from a box around the origin, at most 0 inside.
fn distance_from_box<R: Real>(p: Vec3<R>, half: Vec3<f32>) -> R {
    let past_face = vec3(p.x.abs(), p.y.abs(), p.z.abs()) - Vec3::uniform(p.x, half);
    let outside = past_face.map(|c| c.at_least(0.0)).length();
    outside + past_face.max_element().at_most(0.0)
}

/// Deserializes a number of iterations and checks its range.
fn iterations<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    crate::values::integer_in_range(deserializer, 1, MAX_ITERATIONS, "iterations")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn a_fractal_is_found_inside_of_other_nodes() {
        let has_fractal = |shape: &str| serde_json::from_str::<Node>(shape).expect(shape).has_fractal();
        assert!(has_fractal(
            r#"{ "union": { "of": [{ "sphere": { "radius": 1 } }, { "scale": { "by": 2, "child": { "mandelbulb": { "power": 8, "iterations": 8 } } } }] } }"#
        ));
        assert!(!has_fractal(
            r#"{ "union": { "of": [{ "sphere": { "radius": 1 } }, { "box": { "size": [1, 1, 1] } }] } }"#
        ));
    }

    #[test]
    fn surfaces_with_fine_detail_are_fractals_or_have_noise() {
        let nodes =
            Node::examples().into_iter().map(|example| serde_json::from_str::<Node>(&example.json).expect("valid"));
        let others: BTreeSet<&str> =
            nodes.filter(|node| node.is_fine() && !node.has_fractal()).map(|node| node.name()).collect();
        assert_eq!(others.into_iter().collect::<Vec<_>>(), ["displace", "height_field", "warp"]);
    }
}
