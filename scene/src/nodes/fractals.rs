//! Fractals: shapes of endless detail, cut off after a number of iterations.
//!
//! Those made of folds that keep lengths and of one scale have a distance or a true bound. The
//! others have an estimate: how far a point's orbit has come, over how fast orbits part there.

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

use crate::limits::MAX_ITERATIONS;
use crate::real::{Real, Vec3, vec3};

/// Keeps the growth of a derivative within what a quotient may have below it.
const LARGEST_SLOPE: f32 = 1e30;

impl Primitive for Mandelbulb {
    const EXAMPLE: &str = r#"{ "power": 8, "iterations": 8 }"#;

    #[inline(always)]
    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let away = p.length();
        let one = away.splat(1.0);
        let power = away.given(self.power.get());
        let bounded = !away.above(ESCAPE_RADIUS);
        let (_, radius, slope) = R::when(
            bounded,
            (p, away, one),
            #[inline(always)]
            || {
                R::repeat(
                    self.iterations,
                    (p, away, one),
                    #[inline(always)]
                    |(z, radius, slope)| {
                        let radius = radius.at_least(1e-6);
                        let (next, growth) = match whole(self.power) {
                            Some(whole) => turned_by_products(z, radius, whole, p),
                            None => turned_by_angles(z, radius, power, p),
                        };
                        let slope = (growth * power).mul_add(slope, one).at_most(LARGEST_SLOPE);
                        let radius = next.length();
                        (!radius.above(ESCAPE_RADIUS), (next, radius, slope))
                    },
                )
            },
        );
        let radius = radius.at_least(1e-6);
        let estimate = radius.ln() * radius / slope * 0.5;
        R::select(away.above(ESCAPE_RADIUS), estimate.min(away - away.given(self.bounding_radius())), estimate)
    }

    fn exactness(&self) -> Exactness {
        Exactness::Estimate
    }

    fn bounds(&self, level: f32) -> Bounds {
        // Inside the ball of escape the estimate says little about how far the surface is.
        let ball = self.bounding_radius();
        let radius = if level > 0.0 { (ball + level).max(ESCAPE_RADIUS) } else { ball };
        Bounds::symmetric(radius, radius, radius)
    }
}

impl Mandelbulb {
    fn bounding_radius(&self) -> f32 {
        if self.power.get() < 3.0 { 2.0 } else { 1.5 }
    }
}

/// The power, if it is a whole number in all frames: then its formula is code, not data.
fn whole(power: Power) -> Option<u32> {
    (power.get() % 1.0 == 0.0 && !power.is_moving()).then_some(power.get() as u32)
}

/// zⁿ + p and rⁿ⁻¹ for any power n.
/// An estimate held to the distance from a simple hull of the fractal: further than `margin` away
/// from it the hull's distance is all there is, which is never more than the fractal's; nearer, the
/// greater of the two counts, and what an unfinished fractal has outside its hull is cut off.
#[inline(always)]
fn held_to_hull<R: Real>(from_hull: R, margin: f32, estimate: impl FnOnce() -> R) -> R {
    R::when(
        !from_hull.given(margin).lt(from_hull),
        from_hull,
        #[inline(always)]
        || estimate().max(from_hull),
    )
}

/// The distance from a box around the origin, at most 0 inside.
#[inline(always)]
fn distance_from_box<R: Real>(p: Vec3<R>, half: Vec3<f32>) -> R {
    let past_face = vec3(p.x.abs(), p.y.abs(), p.z.abs()) - Vec3::given(p.x, half);
    let outside = past_face
        .map(
            #[inline(always)]
            |c| c.at_least(0.0),
        )
        .length();
    outside + past_face.max_element().at_most(0.0)
}

/// Reads a number of iterations that is in range.
fn iterations<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    crate::values::whole(deserializer, 1, MAX_ITERATIONS, "iterations")
}
