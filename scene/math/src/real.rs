//! The number type in which formulas are written.
//!
//! Every formula of a picture is written once, generic over [`Real`], and runs in several arithmetics: `f32` is the
//! reference, [`Interval`] gives bounds, and a recorder makes the tape from which CPUs and GPUs run. All of them must be
//! bit-identical to the reference. So every operation here is defined to the bit: IEEE-754 binary32, rounded to
//! nearest even, fused only where [`Real::mul_add`] is written. No result may depend on the sign of a zero, and no
//! formula may produce a NaN. There is no `if` on a value: use [`Real::select`], [`Real::when`], [`Real::repeat`].

mod bundle;
mod function_key;
mod functions;
mod interval;
pub mod list;
mod reference;
mod table;
mod uniform;
mod vector;

use std::fmt::Debug;
use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Shl, Shr, Sub};

pub use bundle::{Bundle, MaskValue, Merge, bundle};
pub use function_key::FunctionKey;
pub use interval::{Interval, IntervalBits, Tribool};
use list::ListFunctions;
pub use reference::F32Bits;
pub use table::{Division, INDEX_BITS, LENGTH_PLACE, LIST_PLACE, MakeWords, STAND_IN, Table, Words};
pub use uniform::Uniform;
pub use vector::{Vec3, vec3};

/// Below this, [`Real::sqrt`] is 0, so that a GPU may compute a root through its reciprocal.
pub const SQRT_FLOOR: f32 = 1e-28;

/// A condition on a [`Real`].
pub trait Mask: Copy + Debug + BitAnd<Output = Self> + BitOr<Output = Self> + Not<Output = Self> {}

impl<M: Copy + Debug + BitAnd<Output = M> + BitOr<Output = M> + Not<Output = M>> Mask for M {}

/// The 32 bits of a [`Real`], as an unsigned integer; sums and products wrap.
pub trait Bits:
    Copy
    + Debug
    + Add<Output = Self>
    + Mul<Output = Self>
    + BitXor<Output = Self>
    + Add<u32, Output = Self>
    + Mul<u32, Output = Self>
    + BitXor<u32, Output = Self>
    + BitAnd<u32, Output = Self>
    + BitOr<u32, Output = Self>
    + Shl<u32, Output = Self>
    + Shr<u32, Output = Self>
{
}

/// A number: one value, a vector of values, a range of values, or a symbol for a value.
pub trait Real:
    Copy
    + 'static
    + Debug
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Add<f32, Output = Self>
    + Sub<f32, Output = Self>
    + Mul<f32, Output = Self>
    + Div<f32, Output = Self>
{
    /// A condition.
    type Mask: Mask;
    /// The bits of a number.
    type Bits: Bits;

    /// `value` in every lane of a number like this one.
    fn constant(self, value: f32) -> Self;

    /// `value`, a number of the scene, in every lane. It is an input of a compiled formula, whereas a `constant` is
    /// part of its code.
    fn uniform(self, value: impl Into<Uniform>) -> Self {
        self.input(value.into().0)
    }

    /// Makes a number like this one from the value of a [`Uniform`].
    fn input(self, value: f32) -> Self {
        self.constant(value)
    }

    /// `word`, an input like [`Real::uniform`].
    #[expect(clippy::erasing_op, reason = "lanes of 0 are made of other lanes")]
    fn uniform_bits(self, word: u32) -> Self::Bits {
        (self.to_bits() & 0) ^ word
    }

    /// `self · factor + term`, rounded once.
    fn mul_add(self, factor: Self, term: Self) -> Self;
    /// Square root, correctly rounded; 0 below [`SQRT_FLOOR`] and for negative numbers.
    fn sqrt(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// Largest integer not above this number.
    fn floor(self) -> Self;
    /// The lesser of two.
    fn min(self, other: Self) -> Self;
    /// The greater of two.
    fn max(self, other: Self) -> Self;

    /// Mask of lanes in which this number is less than `other`.
    fn lt(self, other: Self) -> Self::Mask;
    /// `yes` where `mask` is true, else `no`.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;

    /// The bits of this number.
    fn to_bits(self) -> Self::Bits;
    /// The number with these bits.
    fn from_bits(bits: Self::Bits) -> Self;

    /// The word of a table at an index; its last word if it is shorter.
    fn word(table: &Table, index: Self::Bits) -> Self::Bits;

    /// The word in place of one that says that its contents do not exist yet, see [`Words::make`].
    fn made(table: &Table, missing: Self::Bits) -> Self::Bits {
        let _ = table;
        missing
    }

    /// The value of the list that begins at a word, at a point.
    ///
    /// # Panics
    /// If this arithmetic neither computes values nor records: those are for functions of lists.
    fn fold<F: ListFunctions<Self>>(table: &Table, first: Self::Bits, p: Vec3<Self>, functions: &F) -> F::Value {
        let _ = (table, first, p, functions);
        panic!("a function of a list folds no list");
    }

    /// `then` where `mask` is true, `otherwise` elsewhere. `then` is skipped if no lane needs it.
    fn when<T: Bundle<Self>>(mask: Self::Mask, otherwise: T, then: impl FnOnce() -> T) -> T;

    /// Runs `step` at least once and at most `limit` times (at least 1), while the mask that it returns with the next
    /// state is true.
    fn repeat<T: Bundle<Self>>(limit: u32, state: T, step: impl FnMut(T) -> (Self::Mask, T)) -> T;

    /// Like [`Real::repeat`], but may stop early where few lanes still go on. The mask is part of the state, by which the
    /// caller lets those go on later, so that others need not wait for them. No result may depend on where it stops.
    fn repeat_while_many<T: Bundle<Self>>(limit: u32, state: T, step: impl FnMut(T) -> (Self::Mask, T)) -> T {
        Self::repeat(limit, state, step)
    }

    /// Calls a function that a formula uses in several places. All numbers that differ from call to call are in
    /// `arguments`, and `body` captures only the scene: tests check that one key has one body.
    fn call<A: Bundle<Self>, T: Bundle<Self>>(self, key: FunctionKey, arguments: A, body: impl FnOnce(A) -> T) -> T {
        let _ = key;
        body(arguments)
    }

    /// Runs `f`, the formula of a node of this name.
    fn labeled<T>(self, name: &'static str, f: impl FnOnce() -> T) -> T {
        let _ = name;
        f()
    }

    /// The number multiplied by itself.
    fn square(self) -> Self {
        self * self
    }

    /// The square of this plus `term`, rounded once.
    fn square_add(self, term: Self) -> Self {
        self.mul_add(self, term)
    }

    /// The greater of this and a constant.
    fn at_least(self, low: f32) -> Self {
        self.max(self.constant(low))
    }

    /// The lesser of this and a constant.
    fn at_most(self, high: f32) -> Self {
        self.min(self.constant(high))
    }

    /// Mask of lanes in which this is less than a constant.
    fn below(self, bound: f32) -> Self::Mask {
        self.lt(self.constant(bound))
    }

    /// Mask of lanes in which this is greater than a constant.
    fn above(self, bound: f32) -> Self::Mask {
        self.constant(bound).lt(self)
    }

    /// Sine of an angle in radians, for |x| ≤ 10⁵. Largest error measured for |x| ≤ 10⁴: 1.6 ulp of 1.
    fn sin(self) -> Self {
        functions::sin_cos(self).0
    }

    /// Cosine of an angle in radians, for |x| ≤ 10⁵. Largest error measured for |x| ≤ 10⁴: 1.6 ulp of 1.
    fn cos(self) -> Self {
        functions::sin_cos(self).1
    }

    /// Sine and cosine of one angle, cheaper than both separately.
    fn sin_cos(self) -> (Self, Self) {
        functions::sin_cos(self)
    }

    /// Sine and cosine of an angle in full turns, of any size, so that periodic functions stay accurate far from the
    /// origin. Largest error measured: 0.9 ulp of 1.
    fn sin_cos_turns(self) -> (Self, Self) {
        functions::sin_cos_turns(self)
    }

    /// Arc cosine in radians, for x in −1..1; x is clamped to that range.
    fn acos(self) -> Self {
        functions::acos(self)
    }

    /// The angle in radians, −π..π, of the point (`x`, self); 0 at the origin.
    fn atan2(self, x: Self) -> Self {
        functions::atan2(self, x)
    }

    /// e to the power of this, for −87..88; the exponent is clamped to that range.
    fn exp(self) -> Self {
        functions::exp(self)
    }

    /// Natural logarithm of a normal number above 0; anything less is taken as 2⁻¹²⁶.
    fn ln(self) -> Self {
        functions::ln(self)
    }

    /// This number, at least 2⁻¹²⁶, to the power `exponent`: exp(exponent · ln x).
    fn powf(self, exponent: Self) -> Self {
        functions::powf(self, exponent)
    }
}
