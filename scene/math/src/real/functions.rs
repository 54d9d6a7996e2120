//! The transcendental functions, written once from exact operations.
//!
//! Polynomials and range reductions come from Stephen L. Moshier's Cephes Mathematical Library, single precision
//! (<https://www.netlib.org/cephes/>), evaluated here with fused operations. Each is compiled once and called, hence
//! [`Real::call`]. The errors in the docs of [`Real`] are measured by this module's tests.

use std::f32::consts::{FRAC_2_PI, FRAC_PI_2, FRAC_PI_4, LOG2_E, PI, TAU};

use super::{FunctionKey, Real};

/// Evaluates a polynomial at `x`, highest coefficient first, by Horner's rule.
fn polynomial<R: Real>(x: R, coefficients: &[f32]) -> R {
    let mut sum = x.constant(coefficients[0]);
    for &coefficient in &coefficients[1..] {
        sum = sum.mul_add(x, x.constant(coefficient));
    }
    sum
}

pub(super) fn sin_cos<R: Real>(x: R) -> (R, R) {
    x.call(FunctionKey::new("sin_cos"), x, |x| {
        let quarter = (x * FRAC_2_PI + 0.5).floor();
        // π/2 in three parts; the first two have trailing zeros, so that their products are exact.
        let r = quarter.mul_add(x.constant(-1.570_312_5), x);
        let r = quarter.mul_add(x.constant(-4.837_512_969_970_703e-4), r);
        let r = quarter.mul_add(x.constant(-7.549_789_948_768_648e-8), r);
        rotate_quadrant(quarter, r)
    })
}

pub(super) fn sin_cos_turns<R: Real>(turns: R) -> (R, R) {
    turns.call(FunctionKey::new("sin_cos_turns"), turns, |turns| {
        let quarter = (turns * 4.0 + 0.5).floor();
        // The remainder is exact, and at most an eighth of a turn.
        let rest = quarter.mul_add(turns.constant(-0.25), turns);
        rotate_quadrant(quarter, rest * TAU)
    })
}

/// Sine and cosine of a number of quarter turns plus `r`, which is at most an eighth of a turn.
fn rotate_quadrant<R: Real>(quarter: R, r: R) -> (R, R) {
    let square = r * r;
    let sine =
        (square * r).mul_add(polynomial(square, &[-1.951_529_589_1e-4, 8.332_160_873_6e-3, -1.666_665_461_1e-1]), r);
    let cosine = (square * square).mul_add(
        polynomial(square, &[2.443_315_711_809_948e-5, -1.388_731_625_493_765e-3, 4.166_664_568_298_827e-2]),
        square.mul_add(r.constant(-0.5), r.constant(1.0)),
    );
    let half = (quarter * 0.5).floor();
    let odd = quarter.mul_add(r.constant(1.0), half * -2.0).above(0.5);
    let lower = half.mul_add(r.constant(1.0), (half * 0.5).floor() * -2.0).above(0.5);
    let (s, c) = (R::select(odd, cosine, sine), R::select(odd, -sine, cosine));
    (R::select(lower, -s, s), R::select(lower, -c, c))
}

pub(super) fn acos<R: Real>(x: R) -> R {
    x.call(FunctionKey::new("acos"), x, |x| {
        let size = x.abs().at_most(1.0);
        let large = size.above(0.5);
        let square = R::select(large, (x.constant(1.0) - size) * 0.5, size * size);
        let root = R::select(large, square.sqrt(), size);
        let sine = (square * root).mul_add(
            polynomial(
                square,
                &[4.216_319_904_8e-2, 2.418_131_104_9e-2, 4.547_002_599_8e-2, 7.495_300_268_6e-2, 1.666_675_242_2e-1],
            ),
            root,
        );
        let of_size = R::select(large, sine * 2.0, x.constant(FRAC_PI_2) - sine);
        R::select(x.below(0.0), x.constant(PI) - of_size, of_size)
    })
}

pub(super) fn atan2<R: Real>(y: R, x: R) -> R {
    x.call(FunctionKey::new("atan2"), (y, x), |(y, x)| {
        let (across, along) = (y.abs(), x.abs());
        let steep = along.lt(across);
        let ratio = along.min(across) / along.max(across).at_least(f32::MIN_POSITIVE);
        // Above tan(π/8), measure from π/4.
        let far = ratio.above(0.414_213_57);
        let r = R::select(far, (ratio - 1.0) / (ratio + 1.0), ratio);
        let square = r * r;
        let part = (square * r).mul_add(
            polynomial(square, &[8.053_744_495_38e-2, -1.387_768_560_32e-1, 1.997_771_064_78e-1, -3.333_294_915_39e-1]),
            r,
        );
        let angle = R::select(far, part + FRAC_PI_4, part);
        let angle = R::select(steep, x.constant(FRAC_PI_2) - angle, angle);
        let angle = R::select(x.below(0.0), x.constant(PI) - angle, angle);
        R::select(y.below(0.0), -angle, angle)
    })
}

pub(super) fn exp<R: Real>(x: R) -> R {
    x.call(FunctionKey::new("exp"), x, |x| {
        let x = x.at_least(-87.0).at_most(88.0);
        let power = (x * LOG2_E + 0.5).floor();
        // ln 2 in two parts.
        let r = power.mul_add(x.constant(-0.693_359_375), x);
        let r = power.mul_add(x.constant(2.121_944_4e-4), r);
        let tail = polynomial(
            r,
            &[1.987_569_15e-4, 1.398_199_950_7e-3, 8.333_451_907_3e-3, 4.166_579_589_4e-2, 1.666_666_545_9e-1, 0.5],
        );
        let fraction = (r * r).mul_add(tail, r) + 1.0;
        // 2^power: its biased exponent, counted in the low bits of a 24-bit number, shifted into position.
        let scale = R::from_bits((power + (8_388_608.0 + 127.0)).to_bits() << 23);
        fraction * scale
    })
}

pub(super) fn ln<R: Real>(x: R) -> R {
    x.call(FunctionKey::new("ln"), x, |x| ln_hi_lo(x).0)
}

pub(super) fn powf<R: Real>(x: R, exponent: R) -> R {
    x.call(FunctionKey::new("powf"), (x, exponent), |(x, exponent)| {
        let (high, low) = ln_hi_lo(x);
        let product = high * exponent;
        let lost = low.mul_add(exponent, high.mul_add(exponent, -product));
        let power = exp(product);
        power.mul_add(lost, power)
    })
}

/// The logarithm as a sum of two numbers, the second much smaller.
fn ln_hi_lo<R: Real>(x: R) -> (R, R) {
    let bits = x.at_least(f32::MIN_POSITIVE).to_bits();
    let exponent = R::from_bits((bits >> 23) | 0x4b00_0000) - (8_388_608.0 + 126.0);
    let mantissa = R::from_bits((bits & 0x007f_ffff) | 0x3f00_0000);
    let low = mantissa.below(std::f32::consts::FRAC_1_SQRT_2);
    let exponent = R::select(low, exponent - 1.0, exponent);
    let r = R::select(low, mantissa + mantissa, mantissa) - 1.0;
    let square = r * r;
    let tail = polynomial(
        r,
        &[
            7.037_683_629_2e-2,
            -1.151_461_031e-1,
            1.167_699_874e-1,
            -1.242_014_084_6e-1,
            1.424_932_278_7e-1,
            -1.666_805_766_5e-1,
            2.000_071_476_5e-1,
            -2.499_999_399_3e-1,
            3.333_333_117_4e-1,
        ],
    );
    let tail = (square * r).mul_add(tail, exponent * -2.121_944_4e-4);
    let fraction = r + square.mul_add(x.constant(-0.5), tail);
    // The first product is exact; the rounding error of the sum is stored (Dekker's Fast2Sum).
    let whole = exponent * 0.693_359_375;
    let sum = whole + fraction;
    (sum, (whole - sum) + fraction)
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "the errors are measured against std's functions in f64")]
mod tests {
    use super::*;

    /// Largest error of `f` over `points`, in units of the last place of the true value, or of `floor` if
    /// that is larger.
    fn largest_error(points: impl Iterator<Item = f32>, f: impl Fn(f32) -> (f32, f64), floor: f64) -> f64 {
        points
            .map(|x| {
                let (got, want) = f(x);
                let size = want.abs().max(floor);
                let ulp = 2_f64.powi((size.log2().floor() as i32).max(-126) - 23);
                (f64::from(got) - want).abs() / ulp
            })
            .fold(0.0, f64::max)
    }

    fn between(low: f32, high: f32) -> impl Iterator<Item = f32> {
        const STEPS: u32 = 1 << 20;
        (0..=STEPS).map(move |i| {
            (f64::from(low) + (f64::from(high) - f64::from(low)) * f64::from(i) / f64::from(STEPS)) as f32
        })
    }

    fn check(name: &str, error: f64, bound: f64) {
        println!("{name}: {error:.2} ulp");
        assert!(error <= bound, "{name} is off by {error} ulp, its doc states {bound}");
    }

    #[test]
    fn measured_errors_match_the_docs() {
        let wide = || between(-1e4, 1e4).chain(between(-7.0, 7.0));
        check("sin", largest_error(wide(), |x| (Real::sin(x), f64::from(x).sin()), 1.0), SIN_ULP);
        check("cos", largest_error(wide(), |x| (Real::cos(x), f64::from(x).cos()), 1.0), SIN_ULP);
        let turns = || between(-1e3, 1e3).chain(between(-1.0, 1.0));
        let angle = |x: f32| f64::from(x) * std::f64::consts::TAU;
        check("sin of turns", largest_error(turns(), |x| (x.sin_cos_turns().0, angle(x).sin()), 1.0), TURNS_ULP);
        check("cos of turns", largest_error(turns(), |x| (x.sin_cos_turns().1, angle(x).cos()), 1.0), TURNS_ULP);
        check("acos", largest_error(between(-1.0, 1.0), |x| (Real::acos(x), f64::from(x).acos()), 0.0), ACOS_ULP);
        check("exp", largest_error(between(-87.0, 88.0), |x| (Real::exp(x), f64::from(x).exp()), 0.0), EXP_ULP);
        let small = (1..0x7f80).map(|i| f32::from_bits(i << 16)).filter(|x| x.is_normal());
        let positive = between(0.0, 4.0).skip(1).chain(small);
        check("ln", largest_error(positive, |x| (Real::ln(x), f64::from(x).ln()), 0.0), LN_ULP);
        let turn = |angle: f32| {
            let (y, x) = (f64::from(angle).sin() as f32 * 3.0, f64::from(angle).cos() as f32 * 3.0);
            (Real::atan2(y, x), f64::from(y).atan2(f64::from(x)))
        };
        check("atan2", largest_error(between(-PI, PI), turn, 0.0), ATAN2_ULP);
        let power = |x: f32| (Real::powf(x, 7.0), f64::from(x).powi(7));
        check("powf", largest_error(between(0.01, 2.0), power, 0.0), POWF_ULP);
    }

    const SIN_ULP: f64 = 0.8;
    const TURNS_ULP: f64 = 0.9;
    const ACOS_ULP: f64 = 1.3;
    const EXP_ULP: f64 = 1.0;
    const LN_ULP: f64 = 0.9;
    const ATAN2_ULP: f64 = 3.1;
    const POWF_ULP: f64 = 4.0;

    #[test]
    fn edges_are_defined() {
        assert_eq!(Real::atan2(0.0_f32, 0.0), 0.0);
        assert_eq!(Real::acos(2.0_f32), 0.0);
        assert_eq!(Real::exp(-1e9_f32), Real::exp(-87.0_f32));
        assert_eq!(Real::ln(-1.0_f32), Real::ln(f32::MIN_POSITIVE));
        assert_eq!(Real::ln(1.0_f32), 0.0);
    }
}
