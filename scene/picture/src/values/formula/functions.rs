//! The functions of formulas. Angles are in degrees, as everywhere in a job.

use std::fmt;
use std::ops::RangeInclusive;

use crate::real::Real;
use crate::sampling::hashed_numbers;
use crate::values::sin_cos_degrees;

/// A function, or an operator.
pub struct Function {
    /// Its name in a formula.
    pub name: &'static str,
    /// Its parameters, for people; an operator has none.
    pub parameters: &'static str,
    /// Its value, described for people.
    pub about: &'static str,
    /// How many arguments it takes.
    pub(crate) arity: RangeInclusive<usize>,
    /// Its value for as many arguments.
    pub(super) apply: fn(&[f32]) -> f32,
}

impl fmt::Debug for Function {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl PartialEq for Function {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

const fn function(
    name: &'static str,
    parameters: &'static str,
    about: &'static str,
    arity: RangeInclusive<usize>,
    apply: fn(&[f32]) -> f32,
) -> Function {
    Function { name, parameters, about, arity, apply }
}

/// Degrees of a radian.
const DEGREES: f32 = 180.0 / std::f32::consts::PI;

/// The functions, in the order of the documentation.
pub static FUNCTIONS: [Function; 28] = [
    function("sin", "degrees", "the sine", 1..=1, |x| sin_cos_degrees(x[0]).0),
    function("cos", "degrees", "the cosine", 1..=1, |x| sin_cos_degrees(x[0]).1),
    function("tan", "degrees", "the tangent", 1..=1, |x| {
        let (sine, cosine) = sin_cos_degrees(x[0]);
        sine / cosine
    }),
    function("asin", "x", "the angle whose sine is x, −90 to 90", 1..=1, |x| 90.0 - arc_cosine(x[0])),
    function("acos", "x", "the angle whose cosine is x, 0 to 180", 1..=1, |x| arc_cosine(x[0])),
    function("atan", "x", "the angle whose tangent is x, −90 to 90", 1..=1, |x| Real::atan2(x[0], 1.0) * DEGREES),
    function("atan2", "y, x", "the angle of the point (x, y), −180 to 180", 2..=2, |x| {
        Real::atan2(x[0], x[1]) * DEGREES
    }),
    function("sqrt", "x", "the square root", 1..=1, |x| if x[0] < 0.0 { f32::NAN } else { Real::sqrt(x[0]) }),
    function("exp", "x", "e to the power of x, which is limited to −87 to 88", 1..=1, |x| Real::exp(x[0])),
    function("ln", "x", "the natural logarithm", 1..=1, |x| if x[0] > 0.0 { Real::ln(x[0]) } else { f32::NAN }),
    function("pow", "x, y", "x to the power of y, as x ^ y", 2..=2, |x| power(x[0], x[1])),
    function("abs", "x", "the absolute value", 1..=1, |x| Real::abs(x[0])),
    function("sign", "x", "−1, 0 or 1", 1..=1, |x| f32::from(i8::from(x[0] > 0.0) - i8::from(x[0] < 0.0))),
    function("floor", "x", "the next lower whole number", 1..=1, |x| Real::floor(x[0])),
    function("ceil", "x", "the next higher whole number", 1..=1, |x| -Real::floor(-x[0])),
    function("round", "x", "the nearest whole number; a half is rounded up", 1..=1, |x| Real::floor(x[0] + 0.5)),
    function("fract", "x", "x − floor(x)", 1..=1, |x| x[0] - Real::floor(x[0])),
    function("mod", "x, y", "x − y·floor(x/y), as x % y", 2..=2, |x| modulo(x[0], x[1])),
    function("min", "a, b, …", "the least", 1..=16, |x| x.iter().copied().fold(x[0], Real::min)),
    function("max", "a, b, …", "the greatest", 1..=16, |x| x.iter().copied().fold(x[0], Real::max)),
    function("clamp", "x, low, high", "x, but at least low and at most high", 3..=3, |x| {
        Real::min(Real::max(x[0], x[1]), x[2])
    }),
    function("mix", "a, b, s", "a + (b − a)·s", 3..=3, |x| mix(x[0], x[1], x[2])),
    function("step", "edge, x", "1 from the edge on, 0 before", 2..=2, |x| f32::from(u8::from(x[1] >= x[0]))),
    function(
        "smoothstep",
        "from, to, x",
        "0 to 1 as x goes from one to the other, with a smooth start and end",
        3..=3,
        |x| smooth(Real::min(Real::max((x[2] - x[0]) / (x[1] - x[0]), 0.0), 1.0)),
    ),
    function("if", "c, a, b", "a if c is not 0, else b; the other one needs no finite value", 3..=3, |x| {
        if x[0] == 0.0 { x[2] } else { x[1] }
    }),
    function(
        "random",
        "k, seed",
        "0 to 1, excluding 1, another for each whole number k; the seed is optional",
        1..=2,
        |x| random(x[0], x.get(1).copied().unwrap_or(0.0)),
    ),
    function(
        "noise",
        "x, seed",
        "smooth random numbers, −1 to 1, another at each whole x; the seed is optional",
        1..=2,
        |x| {
            let seed = x.get(1).copied().unwrap_or(0.0);
            let at = Real::floor(x[0]);
            let share = x[0] - at;
            // Perlin's quintic.
            let share = share * share * share * ((share * 6.0 - 15.0) * share + 10.0);
            mix(random(at, seed), random(at + 1.0, seed), share) * 2.0 - 1.0
        },
    ),
    function("hypot", "x, y", "the length of (x, y)", 2..=2, |x| Real::sqrt(x[0] * x[0] + x[1] * x[1])),
];

/// The function or operator of a name.
pub(super) fn find(name: &str) -> Option<&'static Function> {
    OPERATORS.iter().chain(&FUNCTIONS).find(|function| function.name == name)
}

/// The operators by their symbols in a formula.
static OPERATORS: [Function; 13] = [
    function("negate", "", "", 1..=1, |x| -x[0]),
    function("+", "", "", 2..=2, |x| x[0] + x[1]),
    function("-", "", "", 2..=2, |x| x[0] - x[1]),
    function("*", "", "", 2..=2, |x| x[0] * x[1]),
    function("/", "", "", 2..=2, |x| x[0] / x[1]),
    function("%", "", "", 2..=2, |x| modulo(x[0], x[1])),
    function("^", "", "", 2..=2, |x| power(x[0], x[1])),
    function("<", "", "", 2..=2, |x| f32::from(u8::from(x[0] < x[1]))),
    function("<=", "", "", 2..=2, |x| f32::from(u8::from(x[0] <= x[1]))),
    function(">", "", "", 2..=2, |x| f32::from(u8::from(x[0] > x[1]))),
    function(">=", "", "", 2..=2, |x| f32::from(u8::from(x[0] >= x[1]))),
    function("==", "", "", 2..=2, |x| f32::from(u8::from(x[0] == x[1]))),
    function("!=", "", "", 2..=2, |x| f32::from(u8::from(x[0] != x[1]))),
];

fn arc_cosine(x: f32) -> f32 {
    if Real::abs(x) <= 1.0 { Real::acos(x) * DEGREES } else { f32::NAN }
}

fn modulo(x: f32, y: f32) -> f32 {
    x - y * Real::floor(x / y)
}

fn mix(a: f32, b: f32, share: f32) -> f32 {
    a + (b - a) * share
}

fn smooth(share: f32) -> f32 {
    share * share * (3.0 - 2.0 * share)
}

/// Small whole exponents by multiplication, so that negative bases have powers too.
fn power(x: f32, y: f32) -> f32 {
    if y == Real::floor(y) && Real::abs(y) <= 64.0 {
        let mut product = 1.0;
        for _ in 0..Real::abs(y) as u32 {
            product *= x;
        }
        return if y < 0.0 { 1.0 / product } else { product };
    }
    match x {
        0.0 if y > 0.0 => 0.0,
        x if x > 0.0 => Real::powf(x, y),
        _ => f32::NAN,
    }
}

/// A number from 0 to 1 that follows from the whole part of `k`, and a seed.
fn random(k: f32, seed: f32) -> f32 {
    let word = |number: f32| Real::floor(number) as i64 as u32;
    hashed_numbers(word(seed), word(k), FORMULA_DIMENSION)[0]
}

/// Dimension of the hash that no other random numbers use.
const FORMULA_DIMENSION: u32 = 0x666f_726d;
