//! Gardner's noise: the product of two sums of sine waves that shift each other's phases.
//!
//! Geoffrey Y. Gardner, "Visual simulation of clouds", SIGGRAPH 1985, <https://doi.org/10.1145/325334.325248>:
//!
//! ```text
//! T = k·Σ[C_i·sin(FX_i·X + PX_i) + T0]·Σ[C_i·sin(FY_i·Y + PY_i) + T0]
//! PX_i = π/2·sin(½·FY_{i−1}·Y) + π·sin(½·FX_i·Z)      FX_{i+1} = 2·FX_i, FY_{i+1} = 2·FY_i
//! PY_i = π/2·sin(½·FX_{i−1}·X) + π·sin(½·FX_i·Z)      C_{i+1} = 0.707·C_i
//! ```
//!
//! The first wave is one unit long; T0 is such that no sum is below 0, and k such that T reaches 1.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use super::lattice::float_in_1_2;
use crate::real::{FunctionKey, Real, Vec3, vec3};

/// Minimum and maximum number of waves in a sum.
pub(super) const MIN_WAVES: u32 = 3;
pub(super) const MAX_WAVES: u32 = 8;

/// Weight of a wave relative to the previous one.
const WAVE_GAIN: f32 = 0.707;

/// Sine and cosine of an angle.
type SinCos<R> = (R, R);

/// Sine and cosine of an angle in full turns.
fn sin_cos_of_turns<R: Real>(turns: R) -> SinCos<R> {
    ((turns - (turns + 0.5).floor()) * TAU).sin_cos()
}

/// Sine and cosine of twice the angle.
fn double_angle<R: Real>((sine, cosine): SinCos<R>) -> SinCos<R> {
    let product = sine * cosine;
    (product + product, cosine.mul_add(cosine, -(sine * sine)))
}

/// The sine of the wave's own angle plus its phase: π/2·`across` + π·`along`.
fn wave<R: Real>(own: SinCos<R>, across: R, along: R) -> R {
    let phase = across.mul_add(across.constant(FRAC_PI_2), along * PI);
    let (sine, cosine) = phase.sin_cos();
    own.0.mul_add(cosine, own.1 * sine)
}

/// Weights of the waves, which sum to 1.
fn weights(waves: u32) -> impl Iterator<Item = f32> {
    let weights = (0..waves).scan(1.0_f32, |next, _| Some(std::mem::replace(next, *next * WAVE_GAIN)));
    let sum: f32 = weights.clone().sum();
    weights.map(move |weight| weight / sum)
}

/// Gardner's noise with this number of waves, 0 to 1.
pub(super) fn gardner<R: Real>(p: Vec3<R>, seed: R, waves: u32) -> R {
    let word = seed.to_bits() * 0x9e37_79b1;
    let phases = vec3(float_in_1_2(word), float_in_1_2(word << 7), float_in_1_2(word << 14));
    // All waves together repeat after four units of x and y and two of z.
    let p = phases.mul_add(p.x.constant(4.0), p);
    let (mut x_low, mut y_low, mut z) =
        (sin_cos_of_turns(p.x * 0.25), sin_cos_of_turns(p.y * 0.25), sin_cos_of_turns(p.z * 0.5));
    let (mut x_middle, mut y_middle) = (double_angle(x_low), double_angle(y_low));
    let (mut x_sum, mut y_sum) = (seed.constant(1.0), seed.constant(1.0));
    for weight in weights(waves) {
        let (x, y) = (double_angle(x_middle), double_angle(y_middle));
        let (across_x, across_y) = p.x.call(
            FunctionKey::new("gardner_wave"),
            ((x, y_low.0), (y, x_low.0), z.0),
            |((x, y_low), (y, x_low), z)| (wave(x, y_low, z), wave(y, x_low, z)),
        );
        x_sum = across_x.mul_add(seed.constant(weight), x_sum);
        y_sum = across_y.mul_add(seed.constant(weight), y_sum);
        (x_low, x_middle, y_low, y_middle, z) = (x_middle, x, y_middle, y, double_angle(z));
    }
    x_sum * y_sum * 0.25
}

/// Maximum slope for each number of waves, per unit.
///
/// With X, X′ the two sums over their weights wᵢ plus 1, and Y, Y′ the sums of wᵢ·fᵢ·|cos θᵢ| for the frequencies fᵢ,
/// T = X·X′/4, and the parts of 4·∇T along the axes are at most X′·Y + π/8·X·Y′, π/8·X′·Y + X·Y′ and π/2·(X′·Y +
/// X·Y′). The length of that vector is convex in (X, Y) and in (X′, Y′), so it is greatest where both are extreme
/// points of the set of (Σ wᵢ·sin θᵢ, Σ wᵢ·fᵢ·cos θᵢ): a curve. A test searches that curve for both.
const LIPSCHITZ: [f32; (MAX_WAVES - MIN_WAVES + 1) as usize] = [15.72, 22.87, 33.39, 48.81, 71.34, 104.13];

/// Lipschitz factor, per unit.
pub(super) fn lipschitz(waves: u32) -> f32 {
    LIPSCHITZ[(waves - MIN_WAVES) as usize]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The extreme point in the direction (1, `slope`).
    fn extreme(waves: u32, slope: f32) -> (f32, f32) {
        let mut frequency = TAU;
        weights(waves).fold((1.0, 0.0), |(x, y), weight| {
            let (along, across) = (weight, weight * frequency * slope);
            let length = (along * along + across * across).sqrt();
            let next = (x + weight * along / length, y + weight * frequency * across / length);
            frequency *= 2.0;
            next
        })
    }

    #[test]
    fn products_of_sums_stay_within_the_lipschitz_factor() {
        for waves in MIN_WAVES..=MAX_WAVES {
            let curve: Vec<_> = (0..400)
                .scan(1e-5_f32, |slope, _| Some(std::mem::replace(slope, *slope * 1.05)))
                .map(|slope| extreme(waves, slope))
                .collect();
            let slope = |(x, y): (f32, f32), (u, v): (f32, f32)| {
                let (p, q) = (u * y, x * v);
                let parts = vec3(p + PI / 8.0 * q, PI / 8.0 * p + q, FRAC_PI_2 * (p + q));
                parts.length() / 4.0
            };
            let steepest = curve.iter().flat_map(|&a| curve.iter().map(move |&b| slope(a, b))).fold(0.0, f32::max);
            let said = lipschitz(waves);
            assert!((0.99..0.999_9).contains(&(steepest / said)), "{waves} waves: {steepest}, expected {said}");
        }
    }
}
