//! Vector arithmetic: [`scene::real::Real`] on the CPU's vector registers.
//!
//! A [`Lanes`] is several registers wide, so that a node's overhead is shared. Every operation gives each
//! lane the bits of the scalar reference.

use std::cell::Cell;
use std::fmt;
use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Shl, Shr, Sub};

use fearless_simd::Level;
use fearless_simd::prelude::*;
use scene::real::{Bits, Bundle, Merge, Real, SQRT_FLOOR};

use crate::interrupt;

thread_local! {
    /// Active lanes of the running code: those that entered the innermost `when` or are still in the
    /// innermost `repeat`. An inner loop ignores the others.
    static ACTIVE_LANES: Cell<u64> = const { Cell::new(u64::MAX) };
}

/// Sets the active lanes until it is dropped.
struct ActiveLanesGuard {
    outer: u64,
}

impl ActiveLanesGuard {
    #[inline(always)]
    fn enter() -> Self {
        Self { outer: ACTIVE_LANES.get() }
    }

    #[inline(always)]
    #[expect(clippy::unused_self, reason = "lanes are set only while a guard exists to reset them")]
    fn set(&self, lanes: u64) {
        ACTIVE_LANES.set(lanes);
    }
}

impl Drop for ActiveLanesGuard {
    #[inline(always)]
    fn drop(&mut self) {
        ACTIVE_LANES.set(self.outer);
    }
}

/// `N` registers of numbers.
#[derive(Clone, Copy)]
pub struct Lanes<S: Simd, const N: usize>([S::f32s; N]);

/// Condition for each lane.
#[derive(Clone, Copy)]
pub struct LaneMask<S: Simd, const N: usize>([S::mask32s; N]);

/// Bits of each lane.
#[derive(Clone, Copy)]
pub struct LaneBits<S: Simd, const N: usize>([S::u32s; N]);

impl<S: Simd, const N: usize> Lanes<S, N> {
    /// Number of lanes.
    pub const COUNT: usize = <S::f32s as SimdBase<S>>::LEN * N;
    const ALL: u64 = u64::MAX >> (64 - Self::COUNT);

    /// Values of `f` for each lane.
    #[inline(always)]
    pub fn from_fn(token: S, f: impl Fn(usize) -> f32) -> Self {
        let mut registers = [S::f32s::splat(token, 0.0); N];
        for (n, register) in registers.iter_mut().enumerate() {
            for (lane, number) in register.as_mut_slice().iter_mut().enumerate() {
                *number = f(n * <S::f32s as SimdBase<S>>::LEN + lane);
            }
        }
        Self(registers)
    }

    /// Loads as many numbers as there are lanes.
    #[inline(always)]
    pub fn load(token: S, numbers: &[f32]) -> Self {
        let length = <S::f32s as SimdBase<S>>::LEN;
        let mut registers = [S::f32s::splat(token, 0.0); N];
        for (n, register) in registers.iter_mut().enumerate() {
            *register = S::f32s::from_slice(token, &numbers[n * length..(n + 1) * length]);
        }
        Self(registers)
    }

    /// Stores as many numbers as there are lanes.
    #[inline(always)]
    pub fn store(&self, numbers: &mut [f32]) {
        let length = <S::f32s as SimdBase<S>>::LEN;
        for (register, numbers) in self.0.iter().zip(numbers.chunks_exact_mut(length)) {
            register.store_slice(numbers);
        }
    }

    /// Proof token that this CPU has the instructions.
    #[inline(always)]
    pub fn token(&self) -> S {
        self.0[0].token()
    }
}

impl<S: Simd, const N: usize> LaneMask<S, N> {
    #[inline(always)]
    fn to_bits(self) -> u64 {
        let length = <S::f32s as SimdBase<S>>::LEN;
        let mut bits = 0;
        for n in 0..N {
            bits |= self.0[n].to_bitmask() << (n * length);
        }
        bits
    }

    /// Mask with these bits.
    #[inline(always)]
    fn with_bits(mut self, bits: u64) -> Self {
        let length = <S::f32s as SimdBase<S>>::LEN;
        let token = self.0[0].token();
        for n in 0..N {
            self.0[n] = S::mask32s::from_bitmask(token, bits >> (n * length));
        }
        self
    }
}

macro_rules! registerwise {
    ($Type:ident: $($Op:ident $op:ident),*) => { $(
        impl<S: Simd, const N: usize> $Op for $Type<S, N> {
            type Output = Self;
            #[inline(always)]
            fn $op(mut self, other: Self) -> Self {
                for n in 0..N {
                    self.0[n] = self.0[n].$op(other.0[n]);
                }
                self
            }
        }
    )* };
}

registerwise![Lanes: Add add, Sub sub, Mul mul, Div div];
registerwise![LaneMask: BitAnd bitand, BitOr bitor];
registerwise![LaneBits: Add add, Mul mul, BitXor bitxor];

macro_rules! with_known {
    ($Type:ident, $known:ty, $register:ident: $($Op:ident $op:ident),*) => { $(
        impl<S: Simd, const N: usize> $Op<$known> for $Type<S, N> {
            type Output = Self;
            #[inline(always)]
            fn $op(mut self, known: $known) -> Self {
                let known = S::$register::splat(self.0[0].token(), known);
                for n in 0..N {
                    self.0[n] = self.0[n].$op(known);
                }
                self
            }
        }
    )* };
}

with_known![Lanes, f32, f32s: Add add, Sub sub, Mul mul, Div div];
with_known![LaneBits, u32, u32s: Add add, Mul mul, BitXor bitxor, BitAnd bitand, BitOr bitor];

macro_rules! shifts {
    ($($Op:ident $op:ident),*) => { $(
        impl<S: Simd, const N: usize> $Op<u32> for LaneBits<S, N> {
            type Output = Self;
            #[inline(always)]
            fn $op(mut self, places: u32) -> Self {
                for n in 0..N {
                    self.0[n] = self.0[n].$op(places);
                }
                self
            }
        }
    )* };
}

shifts![Shl shl, Shr shr];

impl<S: Simd, const N: usize> Bits for LaneBits<S, N> {}

impl<S: Simd, const N: usize> Not for LaneMask<S, N> {
    type Output = Self;
    #[inline(always)]
    fn not(mut self) -> Self {
        for n in 0..N {
            self.0[n] = !self.0[n];
        }
        self
    }
}

impl<S: Simd, const N: usize> Neg for Lanes<S, N> {
    type Output = Self;
    #[inline(always)]
    fn neg(mut self) -> Self {
        for n in 0..N {
            self.0[n] = -self.0[n];
        }
        self
    }
}

impl<S: Simd, const N: usize> fmt::Debug for Lanes<S, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.0.iter().flat_map(SimdBase::as_slice)).finish()
    }
}

impl<S: Simd, const N: usize> fmt::Debug for LaneMask<S, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:b}", self.to_bits())
    }
}

impl<S: Simd, const N: usize> fmt::Debug for LaneBits<S, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.0.iter().flat_map(SimdBase::as_slice)).finish()
    }
}

/// Whether fused operations take many instructions at this level; constant at compile time.
#[inline(always)]
fn lacks_fma<S: Simd>(token: S) -> bool {
    match token.level() {
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        Level::Sse2(_) | Level::Sse4_2(_) => true,
        Level::Fallback(_) => true,
        _ => false,
    }
}

/// Fused operation as a call, because inlining its many instructions into every formula would be too much code.
#[inline(never)]
fn software_fma<S: Simd, const N: usize>(mut a: Lanes<S, N>, b: Lanes<S, N>, c: Lanes<S, N>) -> Lanes<S, N> {
    a.token().vectorize(
        #[inline(always)]
        || {
            for n in 0..N {
                a.0[n] = a.0[n].mul_add_precise(b.0[n], c.0[n]);
            }
            a
        },
    )
}

/// Selects the first bundle's parts where the mask is set.
struct SelectMerge<S: Simd, const N: usize>(LaneMask<S, N>);

impl<S: Simd, const N: usize> Merge<Lanes<S, N>> for SelectMerge<S, N> {
    #[inline(always)]
    fn number(&mut self, yes: Lanes<S, N>, no: Lanes<S, N>) -> Lanes<S, N> {
        Real::select(self.0, yes, no)
    }

    #[inline(always)]
    fn mask(&mut self, yes: LaneMask<S, N>, no: LaneMask<S, N>) -> LaneMask<S, N> {
        (self.0 & yes) | (!self.0 & no)
    }
}

impl<S: Simd, const N: usize> Real for Lanes<S, N> {
    type Mask = LaneMask<S, N>;
    type Bits = LaneBits<S, N>;

    #[inline(always)]
    fn constant(self, value: f32) -> Self {
        Self([S::f32s::splat(self.token(), value); N])
    }

    #[inline(always)]
    fn mul_add(mut self, factor: Self, term: Self) -> Self {
        if lacks_fma(self.token()) {
            return software_fma(self, factor, term);
        }
        for n in 0..N {
            self.0[n] = self.0[n].mul_add_precise(factor.0[n], term.0[n]);
        }
        self
    }

    #[inline(always)]
    fn sqrt(mut self) -> Self {
        let zero = S::f32s::splat(self.token(), 0.0);
        let floor = S::f32s::splat(self.token(), SQRT_FLOOR);
        for n in 0..N {
            self.0[n] = self.0[n].simd_lt(floor).select(zero, self.0[n].sqrt());
        }
        self
    }

    #[inline(always)]
    fn abs(mut self) -> Self {
        for n in 0..N {
            self.0[n] = self.0[n].abs();
        }
        self
    }

    #[inline(always)]
    fn floor(mut self) -> Self {
        for n in 0..N {
            self.0[n] = self.0[n].floor();
        }
        self
    }

    // Without NaN, and because no result depends on a zero's sign, every platform's minimum and maximum agree
    // with the reference's.
    #[inline(always)]
    fn min(mut self, other: Self) -> Self {
        for n in 0..N {
            self.0[n] = self.0[n].min(other.0[n]);
        }
        self
    }

    #[inline(always)]
    fn max(mut self, other: Self) -> Self {
        for n in 0..N {
            self.0[n] = self.0[n].max(other.0[n]);
        }
        self
    }

    #[inline(always)]
    fn lt(self, other: Self) -> LaneMask<S, N> {
        let mut mask = LaneMask([S::mask32s::splat(self.token(), false); N]);
        for n in 0..N {
            mask.0[n] = self.0[n].simd_lt(other.0[n]);
        }
        mask
    }

    #[inline(always)]
    fn select(mask: LaneMask<S, N>, mut yes: Self, no: Self) -> Self {
        for n in 0..N {
            yes.0[n] = mask.0[n].select(yes.0[n], no.0[n]);
        }
        yes
    }

    #[inline(always)]
    fn to_bits(self) -> LaneBits<S, N> {
        let mut bits = LaneBits([S::u32s::splat(self.token(), 0); N]);
        for n in 0..N {
            bits.0[n] = self.0[n].bitcast();
        }
        bits
    }

    #[inline(always)]
    fn from_bits(bits: LaneBits<S, N>) -> Self {
        let mut numbers = Self([S::f32s::splat(bits.0[0].token(), 0.0); N]);
        for n in 0..N {
            numbers.0[n] = bits.0[n].bitcast();
        }
        numbers
    }

    #[inline(always)]
    fn vectorize<T>(self, f: impl FnOnce() -> T) -> T {
        self.token().vectorize(f)
    }

    #[inline(always)]
    fn labeled<T>(self, _: &'static str, f: impl FnOnce() -> T) -> T {
        // One evaluation of a scene may take for ever, because copies can have copies.
        interrupt::check();
        self.vectorize(f)
    }

    #[inline(always)]
    fn when<T: Bundle<Self>>(mask: LaneMask<S, N>, otherwise: T, then: impl FnOnce() -> T) -> T {
        let live = ActiveLanesGuard::enter();
        let entering = mask.to_bits() & live.outer;
        if entering == 0 {
            return otherwise;
        }
        live.set(entering);
        then().merge(otherwise, &mut SelectMerge(mask))
    }

    #[inline(always)]
    fn repeat<T: Bundle<Self>>(limit: u32, state: T, mut step: impl FnMut(T) -> (LaneMask<S, N>, T)) -> T {
        let live = ActiveLanesGuard::enter();
        let mut state = state;
        let mut going = live.outer & Self::ALL;
        for _ in 0..limit {
            interrupt::check();
            live.set(going);
            let (again, next) = step(state);
            state = if going == Self::ALL { next } else { next.merge(state, &mut SelectMerge(again.with_bits(going))) };
            going &= again.to_bits();
            if going == 0 {
                break;
            }
        }
        state
    }
}
