//! The text of a formula without its numbers: formulas of one text are one family.
//!
//! A trace is an arithmetic that computes nothing. It lists each operation and its operands, and collects the numbers
//! of the scene.

use std::cell::RefCell;
use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Shl, Shr, Sub};

use crate::real::{Bits, Bundle, Merge, Real, Table};

thread_local! {
    static TRACE: RefCell<Trace> = const { RefCell::new(Trace { text: Vec::new(), numbers: Vec::new(), next: 0 }) };
}

/// A traced formula: the operations, and the numbers of the scene in the order of their use.
#[derive(Debug, Default)]
pub(super) struct Trace {
    pub(super) text: Vec<u32>,
    pub(super) numbers: Vec<u32>,
    next: u32,
}

/// A number, a condition or a word of a trace.
#[derive(Clone, Copy, Debug)]
pub(super) struct Symbol(u32);

#[derive(Clone, Copy, Debug)]
enum Step {
    Argument,
    Constant,
    Number,
    Add,
    Sub,
    Mul,
    Div,
    Neg,
    Fma,
    Sqrt,
    Abs,
    Floor,
    Min,
    Max,
    Less,
    And,
    Or,
    Not,
    Xor,
    Shl,
    Shr,
    Select,
    Bits,
    FromBits,
    When,
    Repeat,
    Merge,
    End,
    Word,
}

fn emit(step: Step, operands: &[u32]) -> Symbol {
    TRACE.with_borrow_mut(|trace| {
        trace.text.push(step as u32);
        trace.text.extend(operands);
        trace.next += 1;
        Symbol(trace.next)
    })
}

/// Traces a formula of `count` arguments.
pub(super) fn trace<const N: usize>(formula: impl FnOnce([Symbol; N])) -> Trace {
    let outer = TRACE.take();
    formula(std::array::from_fn(|_| emit(Step::Argument, &[])));
    TRACE.replace(outer)
}

macro_rules! binary {
    ($($Op:ident $op:ident),*) => { $(
        impl $Op for Symbol {
            type Output = Self;
            fn $op(self, other: Self) -> Self {
                emit(Step::$Op, &[self.0, other.0])
            }
        }
        impl $Op<f32> for Symbol {
            type Output = Self;
            fn $op(self, other: f32) -> Self {
                let other = self.constant(other);
                emit(Step::$Op, &[self.0, other.0])
            }
        }
    )* };
}

binary![Add add, Sub sub, Mul mul, Div div];

macro_rules! bitwise {
    ($($Op:ident $op:ident $Step:ident),*) => { $(
        impl $Op for Symbol {
            type Output = Self;
            fn $op(self, other: Self) -> Self {
                emit(Step::$Step, &[self.0, other.0])
            }
        }
    )* };
}

bitwise![BitAnd bitand And, BitOr bitor Or, BitXor bitxor Xor];

macro_rules! with_word {
    ($($Op:ident $op:ident $Step:ident),*) => { $(
        impl $Op<u32> for Symbol {
            type Output = Self;
            fn $op(self, other: u32) -> Self {
                emit(Step::$Step, &[self.0, u32::MAX, other])
            }
        }
    )* };
}

with_word![Add add Add, Mul mul Mul, BitXor bitxor Xor, BitAnd bitand And, BitOr bitor Or, Shl shl Shl, Shr shr Shr];

impl Neg for Symbol {
    type Output = Self;
    fn neg(self) -> Self {
        emit(Step::Neg, &[self.0])
    }
}

impl Not for Symbol {
    type Output = Self;
    fn not(self) -> Self {
        emit(Step::Not, &[self.0])
    }
}

impl Bits for Symbol {}

struct TraceMerge;

impl Merge<Symbol> for TraceMerge {
    fn number(&mut self, a: Symbol, b: Symbol) -> Symbol {
        emit(Step::Merge, &[a.0, b.0])
    }

    fn mask(&mut self, a: Symbol, b: Symbol) -> Symbol {
        emit(Step::Merge, &[a.0, b.0])
    }
}

impl Real for Symbol {
    type Mask = Self;
    type Bits = Self;

    fn constant(self, value: f32) -> Self {
        emit(Step::Constant, &[value.to_bits()])
    }

    fn input(self, value: f32) -> Self {
        self.uniform_bits(value.to_bits())
    }

    fn uniform_bits(self, word: u32) -> Self {
        TRACE.with_borrow_mut(|trace| trace.numbers.push(word));
        emit(Step::Number, &[])
    }

    fn mul_add(self, factor: Self, term: Self) -> Self {
        emit(Step::Fma, &[self.0, factor.0, term.0])
    }

    fn sqrt(self) -> Self {
        emit(Step::Sqrt, &[self.0])
    }

    fn abs(self) -> Self {
        emit(Step::Abs, &[self.0])
    }

    fn floor(self) -> Self {
        emit(Step::Floor, &[self.0])
    }

    fn min(self, other: Self) -> Self {
        emit(Step::Min, &[self.0, other.0])
    }

    fn max(self, other: Self) -> Self {
        emit(Step::Max, &[self.0, other.0])
    }

    fn lt(self, other: Self) -> Self {
        emit(Step::Less, &[self.0, other.0])
    }

    fn select(mask: Self, yes: Self, no: Self) -> Self {
        emit(Step::Select, &[mask.0, yes.0, no.0])
    }

    fn to_bits(self) -> Self {
        emit(Step::Bits, &[self.0])
    }

    fn from_bits(bits: Self) -> Self {
        emit(Step::FromBits, &[bits.0])
    }

    fn word(_: &Table, index: Self) -> Self {
        emit(Step::Word, &[index.0])
    }

    fn when<T: Bundle<Self>>(mask: Self, otherwise: T, then: impl FnOnce() -> T) -> T {
        emit(Step::When, &[mask.0]);
        let then = then();
        emit(Step::End, &[]);
        then.merge(otherwise, &mut TraceMerge)
    }

    fn repeat<T: Bundle<Self>>(limit: u32, state: T, mut step: impl FnMut(T) -> (Self, T)) -> T {
        emit(Step::Repeat, &[limit]);
        let state = state.merge(state, &mut TraceMerge);
        let (again, next) = step(state);
        emit(Step::End, &[again.0]);
        state.merge(next, &mut TraceMerge)
    }
}
