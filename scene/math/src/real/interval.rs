//! Interval arithmetic: contains every value that a formula has in a box of space.
//!
//! Rounding to nearest is monotonic, so the ends computed in `f32` contain every `f32` that the same
//! operation gives inside; the polynomials of the transcendentals are not monotonic, so their intervals are
//! widened.

use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Shl, Shr, Sub};

use super::reference::F32Bits;
use super::{Bits, Bundle, Merge, Real, Table};

/// All numbers from `low` to `high`, both included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Minimum.
    pub low: f32,
    /// Maximum.
    pub high: f32,
}

/// Truth value of a condition over a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tribool {
    /// True everywhere.
    True,
    /// False everywhere.
    False,
    /// True at some points and false at others, or unknown.
    Unknown,
}

/// The bits of an interval: known if it is a single number.
#[derive(Clone, Copy, Debug)]
pub struct IntervalBits(Option<F32Bits>);

impl Interval {
    const ALL: Self = Self { low: f32::NEG_INFINITY, high: f32::INFINITY };

    /// The interval between two numbers.
    pub fn new(low: f32, high: f32) -> Self {
        Self { low, high }
    }

    /// Whether `value` is inside.
    pub fn contains(self, value: f32) -> bool {
        self.low <= value && value <= self.high
    }

    fn hull(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// The hull of some values; infinite if one is undefined.
    fn hull_of<const N: usize>(values: [f32; N]) -> Self {
        if values.iter().any(|value| value.is_nan()) {
            return Self::ALL;
        }
        let hull = |hull: Self, value: f32| hull.hull(Self::new(value, value));
        values.into_iter().fold(Self::new(f32::INFINITY, f32::NEG_INFINITY), hull)
    }

    /// Interval widened by the error of a transcendental function.
    fn with_error(self) -> Self {
        const ERROR: f32 = 32.0 * f32::EPSILON;
        let wide = |end: f32| end.abs() * ERROR + f32::MIN_POSITIVE;
        Self { low: self.low - wide(self.low), high: self.high + wide(self.high) }
    }
}

impl Not for Tribool {
    type Output = Self;
    fn not(self) -> Self {
        match self {
            Self::True => Self::False,
            Self::False => Self::True,
            Self::Unknown => Self::Unknown,
        }
    }
}

impl BitAnd for Tribool {
    type Output = Self;
    fn bitand(self, other: Self) -> Self {
        match (self, other) {
            (Self::False, _) | (_, Self::False) => Self::False,
            (Self::True, Self::True) => Self::True,
            (Self::Unknown, Self::True | Self::Unknown) | (Self::True, Self::Unknown) => Self::Unknown,
        }
    }
}

impl BitOr for Tribool {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        !(!self & !other)
    }
}

impl Add for Interval {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self::hull_of([self.low + other.low, self.high + other.high])
    }
}

impl Sub for Interval {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self::hull_of([self.low - other.high, self.high - other.low])
    }
}

impl Mul for Interval {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self::hull_of([self.low * other.low, self.low * other.high, self.high * other.low, self.high * other.high])
    }
}

impl Div for Interval {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        if other.contains(0.0) {
            return Self::ALL;
        }
        Self::hull_of([self.low / other.low, self.low / other.high, self.high / other.low, self.high / other.high])
    }
}

impl Neg for Interval {
    type Output = Self;
    fn neg(self) -> Self {
        Self { low: -self.high, high: -self.low }
    }
}

macro_rules! with_known {
    ($($Op:ident $op:ident),*) => { $(
        impl $Op<f32> for Interval {
            type Output = Self;
            fn $op(self, other: f32) -> Self {
                self.$op(Self::new(other, other))
            }
        }
    )* };
}

with_known![Add add, Sub sub, Mul mul, Div div];

macro_rules! bit_operators {
    ($($Op:ident $op:ident),*) => { $(
        impl $Op for IntervalBits {
            type Output = Self;
            fn $op(self, other: Self) -> Self {
                Self(self.0.zip(other.0).map(|(a, b)| a.$op(b)))
            }
        }
        impl $Op<u32> for IntervalBits {
            type Output = Self;
            fn $op(self, other: u32) -> Self {
                Self(self.0.map(|word| word.$op(other)))
            }
        }
    )* };
}

bit_operators![Add add, Mul mul, BitXor bitxor, BitAnd bitand, BitOr bitor, Shl shl, Shr shr];

impl Bits for IntervalBits {}

/// Merges two bundles into one that contains both.
struct HullMerge;

impl Merge<Interval> for HullMerge {
    fn number(&mut self, a: Interval, b: Interval) -> Interval {
        a.hull(b)
    }

    fn mask(&mut self, a: Tribool, b: Tribool) -> Tribool {
        if a == b { a } else { Tribool::Unknown }
    }
}

impl Real for Interval {
    type Mask = Tribool;
    type Bits = IntervalBits;

    fn constant(self, value: f32) -> Self {
        Self::new(value, value)
    }

    fn mul_add(self, factor: Self, term: Self) -> Self {
        let corner = |a: f32, b: f32| [Real::mul_add(a, b, term.low), Real::mul_add(a, b, term.high)];
        let [a, b] = corner(self.low, factor.low);
        let [c, d] = corner(self.low, factor.high);
        let [e, f] = corner(self.high, factor.low);
        let [g, h] = corner(self.high, factor.high);
        Self::hull_of([a, b, c, d, e, f, g, h])
    }

    fn sqrt(self) -> Self {
        Self::new(Real::sqrt(self.low), Real::sqrt(self.high))
    }

    fn abs(self) -> Self {
        if self.low >= 0.0 {
            self
        } else if self.high <= 0.0 {
            -self
        } else {
            Self::new(0.0, self.high.max(-self.low))
        }
    }

    fn floor(self) -> Self {
        Self::new(self.low.floor(), self.high.floor())
    }

    fn min(self, other: Self) -> Self {
        Self::new(self.low.min(other.low), self.high.min(other.high))
    }

    fn max(self, other: Self) -> Self {
        Self::new(self.low.max(other.low), self.high.max(other.high))
    }

    fn lt(self, other: Self) -> Tribool {
        if self.high < other.low {
            Tribool::True
        } else if self.low >= other.high {
            Tribool::False
        } else {
            Tribool::Unknown
        }
    }

    fn select(mask: Tribool, yes: Self, no: Self) -> Self {
        match mask {
            Tribool::True => yes,
            Tribool::False => no,
            Tribool::Unknown => yes.hull(no),
        }
    }

    fn to_bits(self) -> IntervalBits {
        IntervalBits((self.low.to_bits() == self.high.to_bits()).then(|| F32Bits(self.low.to_bits())))
    }

    fn from_bits(bits: IntervalBits) -> Self {
        bits.0.map_or(Self::ALL, |word| Self::hull_of([f32::from_bits(word.0)]))
    }

    fn word(table: &Table, index: IntervalBits) -> IntervalBits {
        IntervalBits(index.0.map(|index| f32::word(table, index)))
    }

    fn square(self) -> Self {
        let size = self.abs();
        Self::new(size.low * size.low, size.high * size.high)
    }

    fn square_add(self, term: Self) -> Self {
        let size = self.abs();
        Self::new(Real::mul_add(size.low, size.low, term.low), Real::mul_add(size.high, size.high, term.high))
    }

    fn sin_cos(self) -> (Self, Self) {
        let all = Self::new(-1.0, 1.0).with_error();
        (all, all)
    }

    fn sin_cos_turns(self) -> (Self, Self) {
        self.sin_cos()
    }

    fn sin(self) -> Self {
        self.sin_cos().0
    }

    fn cos(self) -> Self {
        self.sin_cos().1
    }

    fn acos(self) -> Self {
        Self::hull_of([Real::acos(self.high), Real::acos(self.low)]).with_error()
    }

    fn atan2(self, _: Self) -> Self {
        Self::new(-std::f32::consts::PI, std::f32::consts::PI).with_error()
    }

    fn exp(self) -> Self {
        Self::hull_of([Real::exp(self.low), Real::exp(self.high)]).with_error()
    }

    fn ln(self) -> Self {
        Self::hull_of([Real::ln(self.low), Real::ln(self.high)]).with_error()
    }

    fn powf(self, exponent: Self) -> Self {
        (self.ln() * exponent).exp().with_error()
    }

    fn when<T: Bundle<Self>>(mask: Tribool, otherwise: T, then: impl FnOnce() -> T) -> T {
        match mask {
            Tribool::True => then(),
            Tribool::False => otherwise,
            Tribool::Unknown => then().merge(otherwise, &mut HullMerge),
        }
    }

    fn repeat<T: Bundle<Self>>(limit: u32, state: T, mut step: impl FnMut(T) -> (Tribool, T)) -> T {
        let mut state = state;
        let mut stopped: Option<T> = None;
        for _ in 0..limit {
            let (again, next) = step(state);
            state = next;
            match again {
                Tribool::True => {}
                Tribool::False => break,
                // Some points stop here, others continue: store the hull of the stopped ones.
                Tribool::Unknown => stopped = Some(stopped.map_or(state, |ends| ends.merge(state, &mut HullMerge))),
            }
        }
        stopped.map_or(state, |ends| ends.merge(state, &mut HullMerge))
    }
}
