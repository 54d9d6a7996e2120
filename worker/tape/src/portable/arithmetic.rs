//! Operations on batches. They are inlined into functions with more instructions than the build assumes.

use math::real::{Real, SQRT_FLOOR, Words};

use crate::tape::Operation;

/// Lanes of a batch: enough to share the cost of a step, few enough that neighboring pixels remain similar.
pub(crate) const LANES: usize = 256;

/// One value of a batch. A mask is all ones or all zeros in each lane. Vectors that cross lines of the cache are slow.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Batch(pub(super) [u32; LANES]);

/// Operand of an operation.
pub(super) trait Operand: Copy {
    fn at(self, lane: usize) -> u32;
}

impl Operand for &Batch {
    #[inline(always)]
    fn at(self, lane: usize) -> u32 {
        self.0[lane]
    }
}

/// The same number in all lanes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Splat(pub(super) u32);

impl Operand for Splat {
    #[inline(always)]
    fn at(self, _lane: usize) -> u32 {
        self.0
    }
}

#[inline(always)]
pub(super) fn apply<const HAS_FMA: bool>(
    operation: Operation,
    to: &mut Batch,
    a: impl Operand,
    b: impl Operand,
    c: impl Operand,
) {
    match operation {
        Operation::Add => two(to, a, b, |a, b| a + b),
        Operation::Sub => two(to, a, b, |a, b| a - b),
        Operation::Mul => two(to, a, b, |a, b| a * b),
        Operation::Div => two(to, a, b, |a, b| a / b),
        Operation::Min => two(to, a, b, |a, b| if b < a { b } else { a }),
        Operation::Max => two(to, a, b, |a, b| if a < b { b } else { a }),
        Operation::Neg => one(to, a, |a| -a),
        Operation::Abs => one(to, a, f32::abs),
        Operation::Floor => one(to, a, f32::floor),
        Operation::Sqrt => one(to, a, |a| if a < SQRT_FLOOR { 0.0 } else { a.sqrt() }),
        Operation::Fma => {
            for lane in 0..LANES {
                let [a, b, c] = [a.at(lane), b.at(lane), c.at(lane)].map(f32::from_bits);
                #[expect(clippy::disallowed_methods, reason = "with the instruction it rounds once")]
                let fused = if HAS_FMA { a.mul_add(b, c) } else { Real::mul_add(a, b, c) };
                to.0[lane] = fused.to_bits();
            }
        }
        Operation::Less => words(to, a, b, |a, b| if f32::from_bits(a) < f32::from_bits(b) { u32::MAX } else { 0 }),
        Operation::Select => select(to, a, b, c),
        Operation::And | Operation::AndU32 => words(to, a, b, |a, b| a & b),
        Operation::Or | Operation::OrU32 => words(to, a, b, |a, b| a | b),
        Operation::Not => words(to, a, a, |a, _| !a),
        Operation::Xor => words(to, a, b, |a, b| a ^ b),
        Operation::AddU32 => words(to, a, b, u32::wrapping_add),
        Operation::MulU32 => words(to, a, b, u32::wrapping_mul),
        Operation::ShiftLeft => words(to, a, a, |a, _| a.wrapping_shl(b.at(0))),
        Operation::ShiftRight => words(to, a, a, |a, _| a.wrapping_shr(b.at(0))),
        Operation::Constant(_)
        | Operation::Uniform(_)
        | Operation::Row(_)
        | Operation::Argument
        | Operation::CallResult
        | Operation::Variable
        | Operation::ToBits
        | Operation::FromBits
        | Operation::Word
        | Operation::Made => unreachable!("{operation:?} is not a step"),
    }
}

/// Words of a table at indices, or the word at `last` where an index is beyond it.
#[inline(always)]
pub(super) fn gather(to: &mut Batch, table: &Words, indices: &Batch, last: impl Operand) {
    for lane in 0..LANES {
        to.0[lane] = table.get(indices.0[lane].min(last.at(lane)));
    }
}

#[inline(always)]
fn words(to: &mut Batch, a: impl Operand, b: impl Operand, operation: impl Fn(u32, u32) -> u32) {
    for lane in 0..LANES {
        to.0[lane] = operation(a.at(lane), b.at(lane));
    }
}

#[inline(always)]
fn two(to: &mut Batch, a: impl Operand, b: impl Operand, operation: impl Fn(f32, f32) -> f32) {
    words(to, a, b, |a, b| operation(f32::from_bits(a), f32::from_bits(b)).to_bits());
}

#[inline(always)]
fn one(to: &mut Batch, a: impl Operand, operation: impl Fn(f32) -> f32) {
    words(to, a, a, |a, _| operation(f32::from_bits(a)).to_bits());
}

/// `yes` in the lanes of the mask, `no` in the others.
#[inline(always)]
fn select(to: &mut Batch, mask: impl Operand, yes: impl Operand, no: impl Operand) {
    for lane in 0..LANES {
        to.0[lane] = (mask.at(lane) & yes.at(lane)) | (!mask.at(lane) & no.at(lane));
    }
}
