//! Estimates before rendering, from a sample of rays, how often rays run out of steps.

use super::Integrator;
use super::scene_distance::AlongRay;
use crate::march::{MarchRange, march_to_root};
use crate::ray::Tolerance;

/// Maximum number of sample rays.
const MAX_PROBE_RAYS: u32 = 256;
/// Minimum number of sample rays; fewer would not be representative.
const MIN_PROBE_RAYS: u32 = 64;
/// Maximum number of node evaluations of all rays together: some milliseconds.
const MAX_NODE_EVALUATIONS: f32 = 400_000.0;

impl Integrator<'_> {
    /// Estimated fraction of the picture's rays that run out of steps before they come near enough to a surface to
    /// show it. `None` if sampling would take too long. `work` is the cost of one distance, in simple nodes.
    pub fn fraction_out_of_steps(&self, width: u32, height: u32, work: f32) -> Option<f32> {
        let max_steps = self.scene.march.max_steps;
        let mut left = (MAX_NODE_EVALUATIONS / work.max(1.0)) as u32;
        let (mut rays, mut out) = (0, 0);
        for number in 0..MAX_PROBE_RAYS {
            if left == 0 {
                break;
            }
            let (across, down) = r2_point(number);
            let of_lens = || richtmyer_point(number);
            let ray = self.view.ray_through_lens(across * width as f32, down * height as f32, of_lens);
            let (nearest, farthest) = self.bounds.intersect_ray(&ray, self.scene.march.max_distance.in_frame());
            rays += 1;
            if nearest >= farthest {
                continue;
            }
            let reach =
                MarchRange { t_min: nearest, t_max: farthest, max_steps: max_steps.min(left), max_past: self.max_past };
            let Tolerance { slope, floor: near } = self.tolerance;
            let approach = self.approach(slope, near, false);
            let along = AlongRay { integrator: self, ray: &ray };
            let marched = march_to_root(&ray, reach, approach, &along, |p| self.distance(p), |p| self.is_fine(p));
            left -= (marched.steps as u32).min(left);
            let seen: f32 = self.view.footprint().at(marched.t);
            if marched.hit.0 || marched.t >= farthest || marched.distance < seen {
                continue;
            }
            if reach.max_steps < max_steps {
                rays -= 1;
                break;
            }
            out += 1;
        }
        (rays >= MIN_PROBE_RAYS).then(|| out as f32 / rays as f32)
    }
}

/// Point `number` of a low-discrepancy sequence over the unit square, from the plastic number: Martin Roberts, "The
/// unreasonable effectiveness of quasirandom sequences",
/// <https://extremelearning.com.au/unreasonable-effectiveness-of-quasirandom-sequences/>.
fn r2_point(number: u32) -> (f32, f32) {
    multiples(number, [0.754_877_666_246_693, 0.569_840_290_998_053])
}

/// Point `number` of another such sequence, which is spread evenly together with the first, from the square roots of 2 and
/// 3: R. D. Richtmyer, "The evaluation of definite integrals, and a quasi-Monte-Carlo method based on the properties of
/// algebraic numbers", Los Alamos LA-1342, 1951.
fn richtmyer_point(number: u32) -> (f32, f32) {
    multiples(number, [std::f64::consts::SQRT_2, 1.732_050_807_568_877_2])
}

/// Fractions of the multiples of two steps.
fn multiples(number: u32, steps: [f64; 2]) -> (f32, f32) {
    // Rounding to `f32` must not give 1.
    let [x, y] = steps.map(|step| (((f64::from(number) + 0.5) * step).fract() as f32).min(0.999_999));
    (x, y)
}
