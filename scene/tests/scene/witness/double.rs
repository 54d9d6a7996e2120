//! Double precision arithmetic for a witness: every formula of a scene runs in it.

use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Neg, Shl, Shr, Sub};

use scene::real::{Bits, Bundle, Merge, Real};

/// The bits of a number in single precision.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Word(u32);

macro_rules! word_operators {
    ($($Op:ident $op:ident $apply:expr),* $(,)?) => { $(
        impl $Op<u32> for Word {
            type Output = Self;
            fn $op(self, other: u32) -> Self {
                let apply: fn(u32, u32) -> u32 = $apply;
                Self(apply(self.0, other))
            }
        }
        impl $Op for Word {
            type Output = Self;
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

impl Bits for Word {}

/// A number in double precision.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Double(pub(crate) f64);

macro_rules! operators {
    ($($Op:ident $op:ident),*) => { $(
        impl $Op for Double {
            type Output = Self;
            fn $op(self, other: Self) -> Self {
                Self($Op::$op(self.0, other.0))
            }
        }
        impl $Op<f32> for Double {
            type Output = Self;
            fn $op(self, other: f32) -> Self {
                Self($Op::$op(self.0, f64::from(other)))
            }
        }
    )* };
}

operators![Add add, Sub sub, Mul mul, Div div];

impl Neg for Double {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

/// Selects one of two bundles.
struct Pick(bool);

impl Merge<Double> for Pick {
    fn number(&mut self, yes: Double, no: Double) -> Double {
        if self.0 { yes } else { no }
    }

    fn mask(&mut self, yes: bool, no: bool) -> bool {
        if self.0 { yes } else { no }
    }
}

impl Real for Double {
    type Mask = bool;
    type Bits = Word;

    fn constant(self, value: f32) -> Self {
        Self(f64::from(value))
    }

    fn word(table: &scene::real::Table, index: Word) -> Word {
        Word(table.get(index.0))
    }

    fn mul_add(self, factor: Self, term: Self) -> Self {
        Self(self.0 * factor.0 + term.0)
    }

    fn sqrt(self) -> Self {
        Self(self.0.max(0.0).sqrt())
    }

    fn abs(self) -> Self {
        Self(self.0.abs())
    }

    fn floor(self) -> Self {
        Self(self.0.floor())
    }

    fn min(self, other: Self) -> Self {
        Self(self.0.min(other.0))
    }

    fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0))
    }

    fn lt(self, other: Self) -> bool {
        self.0 < other.0
    }

    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }

    /// Hashes use the bits of integers, which single precision can represent.
    fn to_bits(self) -> Word {
        Word((self.0 as f32).to_bits())
    }

    fn from_bits(bits: Word) -> Self {
        Self(f64::from(f32::from_bits(bits.0)))
    }

    fn when<T: Bundle<Self>>(mask: bool, otherwise: T, then: impl FnOnce() -> T) -> T {
        if mask { then().merge(otherwise, &mut Pick(true)) } else { otherwise }
    }

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

    fn sin(self) -> Self {
        Self(self.0.sin())
    }

    fn cos(self) -> Self {
        Self(self.0.cos())
    }

    fn sin_cos(self) -> (Self, Self) {
        (self.sin(), self.cos())
    }

    fn sin_cos_turns(self) -> (Self, Self) {
        Self(self.0.fract() * std::f64::consts::TAU).sin_cos()
    }

    fn acos(self) -> Self {
        Self(self.0.clamp(-1.0, 1.0).acos())
    }

    fn atan2(self, x: Self) -> Self {
        Self(self.0.atan2(x.0))
    }

    fn exp(self) -> Self {
        Self(self.0.clamp(-87.0, 88.0).exp())
    }

    fn ln(self) -> Self {
        Self(self.0.max(f64::from(f32::MIN_POSITIVE)).ln())
    }

    fn powf(self, exponent: Self) -> Self {
        Self((exponent.0 * self.ln().0).exp())
    }
}
