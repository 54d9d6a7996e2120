//! Several numbers and conditions that change together: the state of a loop, or the result of a branch.

use super::{Real, Vec3};

/// Merges two values into one.
pub trait Merge<R: Real> {
    /// Merges two numbers.
    fn number(&mut self, a: R, b: R) -> R;
    /// Merges two conditions.
    fn mask(&mut self, a: R::Mask, b: R::Mask) -> R::Mask;
}

/// Any struct of numbers and conditions.
pub trait Bundle<R: Real>: Copy + 'static {
    /// Merges two bundles field by field, in a fixed order.
    fn merge(self, other: Self, how: &mut impl Merge<R>) -> Self;
}

/// A condition as part of a [`Bundle`].
#[derive(Clone, Copy, Debug)]
pub struct MaskValue<R: Real>(pub R::Mask);

impl<R: Real> Bundle<R> for R {
    fn merge(self, other: Self, how: &mut impl Merge<R>) -> Self {
        how.number(self, other)
    }
}

impl<R: Real> Bundle<R> for MaskValue<R> {
    fn merge(self, other: Self, how: &mut impl Merge<R>) -> Self {
        Self(how.mask(self.0, other.0))
    }
}

/// Implements [`Bundle`] for a struct whose fields are bundles.
#[macro_export]
macro_rules! bundle {
    ($Struct:ident { $($field:ident),+ }) => {
        impl<R: $crate::real::Real> $crate::real::Bundle<R> for $Struct<R> {
            fn merge(self, other: Self, how: &mut impl $crate::real::Merge<R>) -> Self {
                Self { $($field: self.$field.merge(other.$field, how)),+ }
            }
        }
    };
}

pub use bundle;

bundle!(Vec3 { x, y, z });

/// An option that depends on the scene's structure: merged values are both present or both absent.
impl<R: Real, T: Bundle<R>> Bundle<R> for Option<T> {
    fn merge(self, other: Self, how: &mut impl Merge<R>) -> Self {
        match (self, other) {
            (Some(a), Some(b)) => Some(a.merge(b, how)),
            (alone, _) => alone,
        }
    }
}

macro_rules! tuples {
    ($(($($Part:ident $index:tt),+)),+ $(,)?) => { $(
        impl<R: Real, $($Part: Bundle<R>),+> Bundle<R> for ($($Part,)+) {
            fn merge(self, other: Self, how: &mut impl Merge<R>) -> Self {
                ($(self.$index.merge(other.$index, how),)+)
            }
        }
    )+ };
}

tuples![(A 0, B 1), (A 0, B 1, C 2), (A 0, B 1, C 2, D 3), (A 0, B 1, C 2, D 3, E 4), (A 0, B 1, C 2, D 3, E 4, F 5)];
