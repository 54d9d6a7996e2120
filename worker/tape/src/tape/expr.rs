//! Symbolic numbers: arithmetic that records itself.

use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Shl, Shr, Sub};

use math::real::list::ListFunctions;
use math::real::{Bits, Bundle, FunctionKey, Real, Table, Vec3};

use super::recorder::{self, emit, note, repeat, shared, uniform, when};
use super::{Operation, ValueId, ValueType};

/// A number of the tape.
#[derive(Clone, Copy, Debug)]
pub struct Expr(pub(super) ValueId);

/// A condition of the tape.
#[derive(Clone, Copy, Debug)]
pub struct BoolExpr(pub(super) ValueId);

/// An unsigned integer of the tape.
#[derive(Clone, Copy, Debug)]
pub struct U32Expr(pub(super) ValueId);

fn number(operation: Operation, operands: &[ValueId]) -> Expr {
    Expr(emit(ValueType::F32, operation, operands))
}

fn condition(operation: Operation, operands: &[ValueId]) -> BoolExpr {
    BoolExpr(emit(ValueType::Bool, operation, operands))
}

fn word(operation: Operation, operands: &[ValueId]) -> U32Expr {
    U32Expr(emit(ValueType::U32, operation, operands))
}

fn literal(value: f32) -> Expr {
    number(Operation::Constant(value.to_bits()), &[])
}

impl Expr {
    /// A number that is known.
    pub fn literal(value: f32) -> Self {
        literal(value)
    }

    /// Whether both are one value of the tape.
    pub fn is(self, other: Self) -> bool {
        self.0 == other.0
    }
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

number_operators![Add add Add, Sub sub Sub, Mul mul Mul, Div div Div];

impl Neg for Expr {
    type Output = Self;
    fn neg(self) -> Self {
        number(Operation::Neg, &[self.0])
    }
}

impl BitAnd for BoolExpr {
    type Output = Self;
    fn bitand(self, other: Self) -> Self {
        condition(Operation::And, &[self.0, other.0])
    }
}

impl BitOr for BoolExpr {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        condition(Operation::Or, &[self.0, other.0])
    }
}

impl Not for BoolExpr {
    type Output = Self;
    fn not(self) -> Self {
        condition(Operation::Not, &[self.0])
    }
}

macro_rules! word_operators {
    ($($Op:ident<$Other:ty> $op:ident $Operation:ident $id:expr),* $(,)?) => { $(
        impl $Op<$Other> for U32Expr {
            type Output = Self;
            fn $op(self, other: $Other) -> Self {
                let id: fn($Other) -> ValueId = $id;
                word(Operation::$Operation, &[self.0, id(other)])
            }
        }
    )* };
}

fn word_literal(value: u32) -> ValueId {
    emit(ValueType::U32, Operation::Constant(value), &[])
}

word_operators![
    Add<Self> add AddU32 |w| w.0,
    Mul<Self> mul MulU32 |w| w.0,
    BitXor<Self> bitxor Xor |w| w.0,
    Add<u32> add AddU32 word_literal,
    Mul<u32> mul MulU32 word_literal,
    BitXor<u32> bitxor Xor word_literal,
    BitAnd<u32> bitand AndU32 word_literal,
    BitOr<u32> bitor OrU32 word_literal,
    Shl<u32> shl ShiftLeft word_literal,
    Shr<u32> shr ShiftRight word_literal,
];

impl Bits for U32Expr {}

impl Real for Expr {
    type Mask = BoolExpr;
    type Bits = U32Expr;

    fn constant(self, value: f32) -> Self {
        literal(value)
    }

    fn input(self, value: f32) -> Self {
        Self(uniform(ValueType::F32, value.to_bits()))
    }

    fn uniform_bits(self, word: u32) -> U32Expr {
        U32Expr(uniform(ValueType::U32, word))
    }

    fn mul_add(self, factor: Self, term: Self) -> Self {
        number(Operation::Fma, &[self.0, factor.0, term.0])
    }

    fn sqrt(self) -> Self {
        number(Operation::Sqrt, &[self.0])
    }

    fn abs(self) -> Self {
        number(Operation::Abs, &[self.0])
    }

    fn floor(self) -> Self {
        number(Operation::Floor, &[self.0])
    }

    fn min(self, other: Self) -> Self {
        number(Operation::Min, &[self.0, other.0])
    }

    fn max(self, other: Self) -> Self {
        number(Operation::Max, &[self.0, other.0])
    }

    fn lt(self, other: Self) -> BoolExpr {
        condition(Operation::Less, &[self.0, other.0])
    }

    fn select(mask: BoolExpr, yes: Self, no: Self) -> Self {
        number(Operation::Select, &[mask.0, yes.0, no.0])
    }

    fn to_bits(self) -> U32Expr {
        word(Operation::ToBits, &[self.0])
    }

    fn from_bits(bits: U32Expr) -> Self {
        number(Operation::FromBits, &[bits.0])
    }

    fn word(table: &Table, index: U32Expr) -> U32Expr {
        U32Expr(recorder::word(table, index.0))
    }

    fn made(table: &Table, missing: U32Expr) -> U32Expr {
        U32Expr(recorder::made(table, missing.0))
    }

    fn fold<F: ListFunctions<Self>>(table: &Table, first: U32Expr, p: Vec3<Self>, functions: &F) -> F::Value {
        recorder::fold(table, first.0, p, functions)
    }

    fn when<T: Bundle<Self>>(mask: BoolExpr, otherwise: T, then: impl FnOnce() -> T) -> T {
        when(mask, otherwise, then)
    }

    fn repeat<T: Bundle<Self>>(limit: u32, state: T, step: impl FnMut(T) -> (BoolExpr, T)) -> T {
        repeat(limit, false, state, step)
    }

    fn repeat_while_many<T: Bundle<Self>>(limit: u32, state: T, step: impl FnMut(T) -> (BoolExpr, T)) -> T {
        repeat(limit, true, state, step)
    }

    fn call<A: Bundle<Self>, T: Bundle<Self>>(self, key: FunctionKey, arguments: A, body: impl FnOnce(A) -> T) -> T {
        shared(key, arguments, body)
    }

    fn labeled<T>(self, name: &'static str, f: impl FnOnce() -> T) -> T {
        note(name);
        f()
    }
}
