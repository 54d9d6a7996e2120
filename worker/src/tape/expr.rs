//! Symbols: the arithmetic that writes itself down.

use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Shl, Shr, Sub};

use scene::real::{Bits, Bundle, Real};

use super::recorder::{define, note, parameter, repeat, shared, when};
use super::{Id, Kind, Operation};

/// A number of the tape.
#[derive(Clone, Copy, Debug)]
pub struct Expr(pub(super) Id);

/// A condition of the tape.
#[derive(Clone, Copy, Debug)]
pub struct Condition(pub(super) Id);

/// A word of the tape.
#[derive(Clone, Copy, Debug)]
pub struct Word(pub(super) Id);

fn number(operation: Operation, operands: &[Id]) -> Expr {
    Expr(define(Kind::Number, operation, operands))
}

fn condition(operation: Operation, operands: &[Id]) -> Condition {
    Condition(define(Kind::Condition, operation, operands))
}

fn word(operation: Operation, operands: &[Id]) -> Word {
    Word(define(Kind::Word, operation, operands))
}

fn literal(value: f32) -> Expr {
    number(Operation::Literal(value.to_bits()), &[])
}

macro_rules! number_operators {
    ($($Op:ident $op:ident $Operation:ident),*) => { $(
        impl $Op for Expr {
            type Output = Self;
            fn $op(self, other: Self) -> Self {
                number(Operation::$Operation, &[self.0, other.0])
            }
        }
        impl $Op<f32> for Expr {
            type Output = Self;
            fn $op(self, other: f32) -> Self {
                self.$op(literal(other))
            }
        }
    )* };
}

number_operators![Add add Add, Sub sub Subtract, Mul mul Multiply, Div div Divide];

impl Neg for Expr {
    type Output = Self;
    fn neg(self) -> Self {
        number(Operation::Negate, &[self.0])
    }
}

impl BitAnd for Condition {
    type Output = Self;
    fn bitand(self, other: Self) -> Self {
        condition(Operation::And, &[self.0, other.0])
    }
}

impl BitOr for Condition {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        condition(Operation::Or, &[self.0, other.0])
    }
}

impl Not for Condition {
    type Output = Self;
    fn not(self) -> Self {
        condition(Operation::Not, &[self.0])
    }
}

macro_rules! word_operators {
    ($($Op:ident<$Other:ty> $op:ident $Operation:ident $id:expr),* $(,)?) => { $(
        impl $Op<$Other> for Word {
            type Output = Self;
            fn $op(self, other: $Other) -> Self {
                let id: fn($Other) -> Id = $id;
                word(Operation::$Operation, &[self.0, id(other)])
            }
        }
    )* };
}

fn word_literal(value: u32) -> Id {
    define(Kind::Word, Operation::Literal(value), &[])
}

word_operators![
    Add<Self> add AddWords |w| w.0,
    Mul<Self> mul MultiplyWords |w| w.0,
    BitXor<Self> bitxor Xor |w| w.0,
    Add<u32> add AddWords word_literal,
    Mul<u32> mul MultiplyWords word_literal,
    BitXor<u32> bitxor Xor word_literal,
    BitAnd<u32> bitand AndWords word_literal,
    BitOr<u32> bitor OrWords word_literal,
    Shl<u32> shl ShiftUp word_literal,
    Shr<u32> shr ShiftDown word_literal,
];

impl Bits for Word {}

impl Real for Expr {
    type Mask = Condition;
    type Bits = Word;

    fn constant(self, value: f32) -> Self {
        literal(value)
    }

    fn uniform(self, value: f32) -> Self {
        Self(parameter(Kind::Number, value.to_bits()))
    }

    fn uniform_bits(self, word: u32) -> Word {
        Word(parameter(Kind::Word, word))
    }

    fn mul_add(self, factor: Self, term: Self) -> Self {
        number(Operation::MultiplyAdd, &[self.0, factor.0, term.0])
    }

    fn sqrt(self) -> Self {
        number(Operation::Root, &[self.0])
    }

    fn abs(self) -> Self {
        number(Operation::Absolute, &[self.0])
    }

    fn floor(self) -> Self {
        number(Operation::Floor, &[self.0])
    }

    fn min(self, other: Self) -> Self {
        number(Operation::Least, &[self.0, other.0])
    }

    fn max(self, other: Self) -> Self {
        number(Operation::Greatest, &[self.0, other.0])
    }

    fn lt(self, other: Self) -> Condition {
        condition(Operation::Less, &[self.0, other.0])
    }

    fn select(mask: Condition, yes: Self, no: Self) -> Self {
        number(Operation::Select, &[mask.0, yes.0, no.0])
    }

    fn to_bits(self) -> Word {
        word(Operation::ToBits, &[self.0])
    }

    fn from_bits(bits: Word) -> Self {
        number(Operation::FromBits, &[bits.0])
    }

    fn when<T: Bundle<Self>>(mask: Condition, otherwise: T, then: impl FnOnce() -> T) -> T {
        when(mask, otherwise, then)
    }

    fn repeat<T: Bundle<Self>>(limit: u32, state: T, step: impl FnMut(T) -> (Condition, T)) -> T {
        repeat(limit, state, step)
    }

    fn call<A: Bundle<Self>, T: Bundle<Self>>(self, name: &'static str, arguments: A, step: impl FnOnce(A) -> T) -> T {
        shared(name, arguments, step)
    }

    fn labeled<T>(self, name: &'static str, f: impl FnOnce() -> T) -> T {
        note(name);
        f()
    }
}
