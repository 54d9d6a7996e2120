//! Operations on batches. They are inlined into functions with more instructions than the build assumes.

use scene::real::{Real, SQRT_FLOOR};

use crate::tape::Operation;

/// Lanes of a batch: enough to share the cost of a step, few enough that neighboring pixels remain similar.
pub(crate) const LANES: usize = 64;

/// One value of a batch. A mask is all ones or all zeros in each lane. Vectors that cross lines of the cache are slow.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Batch(pub(super) [u32; LANES]);

#[inline(always)]
pub(super) fn apply<const HAS_FMA: bool>(operation: Operation, to: &mut Batch, a: &Batch, b: &Batch, c: &Batch) {
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
                let [a, b, c] = [a.0[lane], b.0[lane], c.0[lane]].map(f32::from_bits);
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
        Operation::ShiftLeft => words(to, a, a, |a, _| a.wrapping_shl(b.0[0])),
        Operation::ShiftRight => words(to, a, a, |a, _| a.wrapping_shr(b.0[0])),
        Operation::Constant(_)
        | Operation::Uniform(_)
        | Operation::Argument
        | Operation::CallResult
        | Operation::Variable
        | Operation::ToBits
        | Operation::FromBits => unreachable!("{operation:?} is not a step"),
    }
}

#[inline(always)]
fn words(to: &mut Batch, a: &Batch, b: &Batch, operation: impl Fn(u32, u32) -> u32) {
    for lane in 0..LANES {
        to.0[lane] = operation(a.0[lane], b.0[lane]);
    }
}

#[inline(always)]
fn two(to: &mut Batch, a: &Batch, b: &Batch, operation: impl Fn(f32, f32) -> f32) {
    words(to, a, b, |a, b| operation(f32::from_bits(a), f32::from_bits(b)).to_bits());
}

#[inline(always)]
fn one(to: &mut Batch, a: &Batch, operation: impl Fn(f32) -> f32) {
    words(to, a, a, |a, _| operation(f32::from_bits(a)).to_bits());
}

/// `yes` in the lanes of the mask, `no` in the others.
#[inline(always)]
pub(super) fn select(to: &mut Batch, mask: &Batch, yes: &Batch, no: &Batch) {
    for lane in 0..LANES {
        to.0[lane] = (mask.0[lane] & yes.0[lane]) | (!mask.0[lane] & no.0[lane]);
    }
}
