//! Gardner's noise: the product of two sums of sine waves that bend each other.
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

use super::lattice::one_to_two;
use crate::real::{Real, Vec3, vec3};

/// Fewest and most waves in a sum.
pub(super) const FEWEST_WAVES: u32 = 3;
pub(super) const MOST_WAVES: u32 = 8;

/// The weight of a wave over that of the one before.
const FADING: f32 = 0.707;

/// Sine and cosine of an angle.
type Turn<R> = (R, R);

/// Sine and cosine of so many whole turns.
#[inline(always)]
fn turned<R: Real>(turns: R) -> Turn<R> {
    ((turns - (turns + 0.5).floor()) * TAU).sin_cos()
}

/// Those of twice the angle.
#[inline(always)]
fn twice<R: Real>((sine, cosine): Turn<R>) -> Turn<R> {
    let product = sine * cosine;
    (product + product, cosine.mul_add(cosine, -(sine * sine)))
}

/// The sine of the wave's own angle plus its phase: π/2·`across` + π·`along`.
#[inline(always)]
fn wave<R: Real>(own: Turn<R>, across: R, along: R) -> R {
    let phase = across.mul_add(across.splat(FRAC_PI_2), along * PI);
    let (sine, cosine) = phase.sin_cos();
    own.0.mul_add(cosine, own.1 * sine)
}

/// The weights of the waves, together 1.
fn weights(waves: u32) -> impl Iterator<Item = f32> {
    let weights = (0..waves).scan(1.0_f32, |next, _| Some(std::mem::replace(next, *next * FADING)));
    let sum: f32 = weights.clone().sum();
    weights.map(move |weight| weight / sum)
}

/// Gardner's noise of so many waves, 0 to 1.
#[inline(always)]
pub(super) fn gardner<R: Real>(p: Vec3<R>, seed: R, waves: u32) -> R {
    let word = seed.to_bits() * 0x9e37_79b1;
    let phases = vec3(one_to_two(word), one_to_two(word << 7), one_to_two(word << 14));
    // All waves together repeat after four units of x and y and two of z.
    let p = phases.mul_add(p.x.splat(4.0), p);
    let (mut x_low, mut y_low, mut z) = (turned(p.x * 0.25), turned(p.y * 0.25), turned(p.z * 0.5));
    let (mut x_middle, mut y_middle) = (twice(x_low), twice(y_low));
    let (mut x_sum, mut y_sum) = (seed.splat(1.0), seed.splat(1.0));
    for weight in weights(waves) {
        let (x, y) = (twice(x_middle), twice(y_middle));
        let (across_x, across_y) = p.x.shared(
            "gardner_wave",
            ((x, y_low.0), (y, x_low.0), z.0),
            #[inline(always)]
            |((x, y_low), (y, x_low), z)| (wave(x, y_low, z), wave(y, x_low, z)),
        );
        x_sum = across_x.mul_add(seed.splat(weight), x_sum);
        y_sum = across_y.mul_add(seed.splat(weight), y_sum);
        (x_low, x_middle, y_low, y_middle, z) = (x_middle, x, y_middle, y, twice(z));
    }
    x_sum * y_sum * 0.25
}

/// How fast it may change, per unit. With Σ, Σ′ the two sums over their weights, each 1 ± 1, T = Σ·Σ′/4; the
/// gradient of a wave is its frequency f times at most |(1, π/8, π/2)|, so |∇T| ≤ (2·|∇Σ| + 2·|∇Σ′|)/4 ≤ Σ wᵢ·fᵢ·1.9031.
pub(super) fn lipschitz(waves: u32) -> f32 {
    let mut frequency = TAU;
    weights(waves).fold(0.0, |sum, weight| {
        let slope = weight * frequency * 1.9031;
        frequency *= 2.0;
        sum + slope
    })
}
