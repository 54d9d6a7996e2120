//! The reference arithmetic: one `f32`, by IEEE-754 operations of the CPU or their exact equal.

use std::ops::{Add, BitAnd, BitOr, BitXor, Mul, Shl, Shr};

use super::list::{self, ListFunctions};
use super::{Bits, Bundle, Merge, Real, SQRT_FLOOR, Table, Vec3};

/// The bits of an `f32`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct F32Bits(pub u32);

macro_rules! word_operators {
    ($($Op:ident $op:ident $apply:expr),* $(,)?) => { $(
        impl $Op<u32> for F32Bits {
            type Output = Self;
            #[inline]
            fn $op(self, other: u32) -> Self {
                let apply: fn(u32, u32) -> u32 = $apply;
                Self(apply(self.0, other))
            }
        }
        impl $Op for F32Bits {
            type Output = Self;
            #[inline]
            fn $op(self, other: Self) -> Self {
                self.$op(other.0)
            }
        }
    )* };
}

word_operators![
    Add add u32::wrapping_add,
    Mul mul u32::wrapping_mul,
    BitXor bitxor |a, b| a ^ b,
    BitAnd bitand |a, b| a & b,
    BitOr bitor |a, b| a | b,
    Shl shl u32::wrapping_shl,
    Shr shr u32::wrapping_shr,
];

impl Bits for F32Bits {}

/// `a · b + c` rounded once, on any CPU.
///
/// The product of two `f32` is exact in `f64`; the sum is rounded to odd (Boldo and Melquiond,
/// "Emulation of a FMA and correctly rounded sums: proved algorithms using rounding to odd",
/// IEEE Transactions on Computers 57(4), 2008), which makes the second rounding harmless.
fn fma(a: f32, b: f32, c: f32) -> f32 {
    let product = f64::from(a) * f64::from(b);
    let term = f64::from(c);
    let sum = product + term;
    // Knuth's TwoSum: `error` is the rounding error of `sum`.
    let term_part = sum - product;
    let error = (product - (sum - term_part)) + (term - term_part);
    if error == 0.0 || !sum.is_finite() || sum.to_bits() & 1 == 1 {
        return sum as f32;
    }
    let away = (error > 0.0) == (sum > 0.0);
    let odd = if away { sum.to_bits() + 1 } else { sum.to_bits() - 1 };
    f64::from_bits(odd) as f32
}

/// Selects one of two bundles.
struct SelectMerge(bool);

impl Merge<f32> for SelectMerge {
    #[inline]
    fn number(&mut self, yes: f32, no: f32) -> f32 {
        if self.0 { yes } else { no }
    }

    #[inline]
    fn mask(&mut self, yes: bool, no: bool) -> bool {
        if self.0 { yes } else { no }
    }
}

impl Real for f32 {
    type Mask = bool;
    type Bits = F32Bits;

    #[inline]
    fn constant(self, value: f32) -> Self {
        value
    }

    #[inline]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        fma(self, factor, term)
    }

    #[inline]
    fn sqrt(self) -> Self {
        if self < SQRT_FLOOR { 0.0 } else { f32::sqrt(self) }
    }

    #[inline]
    fn abs(self) -> Self {
        f32::abs(self)
    }

    #[inline]
    fn floor(self) -> Self {
        f32::floor(self)
    }

    #[inline]
    fn min(self, other: Self) -> Self {
        if other < self { other } else { self }
    }

    #[inline]
    fn max(self, other: Self) -> Self {
        if self < other { other } else { self }
    }

    #[inline]
    fn lt(self, other: Self) -> bool {
        self < other
    }

    #[inline]
    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }

    #[inline]
    fn to_bits(self) -> F32Bits {
        F32Bits(f32::to_bits(self))
    }

    #[inline]
    fn from_bits(bits: F32Bits) -> Self {
        f32::from_bits(bits.0)
    }

    #[inline]
    fn word(table: &Table, index: F32Bits) -> F32Bits {
        F32Bits(table.get(index.0.min(table.capacity() as u32 - 1)))
    }

    fn made(table: &Table, missing: F32Bits) -> F32Bits {
        F32Bits(table.make(missing.0))
    }

    fn fold<F: ListFunctions<Self>>(table: &Table, first: F32Bits, p: Vec3<Self>, functions: &F) -> F::Value {
        list::fold(table, first.0, p, functions)
    }

    #[inline]
    fn when<T: Bundle<Self>>(mask: bool, otherwise: T, then: impl FnOnce() -> T) -> T {
        if mask { then().merge(otherwise, &mut SelectMerge(true)) } else { otherwise }
    }

    #[inline]
    fn repeat<T: Bundle<Self>>(limit: u32, state: T, mut step: impl FnMut(T) -> (bool, T)) -> T {
        let mut state = state;
        for _ in 0..limit {
            let (again, next) = step(state);
            state = next;
            if !again {
                break;
            }
        }
        state
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares with a sum in 128-bit integers, scaled: exact by construction.
    fn fused_exactly(a: f32, b: f32, c: f32) -> f32 {
        #[expect(clippy::disallowed_methods, reason = "the C library's fma is the independent witness here")]
        f32::mul_add(a, b, c)
    }

    #[test]
    fn fused_rounds_once() {
        let mut state = 1_u32;
        let mut random = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
            f32::from_bits((word >> 22) ^ word)
        };
        let mut tested = 0;
        while tested < 2_000_000 {
            let (a, b, c) = (random(), random(), random());
            let (got, want) = (fma(a, b, c), fused_exactly(a, b, c));
            if want.is_nan() {
                continue;
            }
            assert_eq!(got.to_bits(), want.to_bits(), "{a:e} * {b:e} + {c:e}");
            tested += 1;
        }
    }

    #[test]
    fn fused_rounds_halfway_cases_and_subnormals_once() {
        let tiny = f32::from_bits(1);
        for (a, b, c) in [
            (1.0 + f32::EPSILON, 1.0 + f32::EPSILON, 1.0),
            (1.0, 1.0, tiny),
            (-1.0, 1.0, tiny),
            (tiny, 0.5, tiny),
            (tiny, 0.5, 0.0),
            (1.5 * f32::MIN_POSITIVE, 0.5, -tiny),
            (f32::MAX, 2.0, -f32::MAX),
        ] {
            assert_eq!(fma(a, b, c).to_bits(), fused_exactly(a, b, c).to_bits(), "{a:e} * {b:e} + {c:e}");
        }
    }

    #[test]
    fn sqrt_is_zero_below_its_floor() {
        assert_eq!(Real::sqrt(-4.0_f32), 0.0);
        assert_eq!(Real::sqrt(1e-29_f32), 0.0);
        assert_eq!(Real::sqrt(2.0_f32), std::f32::consts::SQRT_2);
    }
}
