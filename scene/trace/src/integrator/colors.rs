//! Lists of colors whose length is part of the structure of a picture's formulas: those that no picture asks for add no
//! number to them.

use std::ops::{Add, Mul};

use crate::real::{Bundle, Merge, Real, Vec3, vec3};

/// Up to `MAX` colors, as many as a picture asks for.
#[derive(Clone, Copy, Debug)]
pub struct Colors<R, const MAX: usize>([Option<Vec3<R>>; MAX]);

impl<R: Real, const MAX: usize> Bundle<R> for Colors<R, MAX> {
    fn merge(self, other: Self, how: &mut impl Merge<R>) -> Self {
        self.zip(other, |own, other| own.merge(other, how))
    }
}

impl<R: Real, const MAX: usize> Colors<R, MAX> {
    /// None.
    pub fn none() -> Self {
        Self([None; MAX])
    }

    /// As many as are asked for, of these.
    pub(super) fn of(colors: impl IntoIterator<Item = Vec3<R>>) -> Self {
        let mut all = Self::none();
        all.0.iter_mut().zip(colors).for_each(|(own, color)| *own = Some(color));
        all
    }

    /// Red, green and blue of each.
    pub fn numbers(self) -> Vec<R> {
        self.0.into_iter().flatten().flat_map(<[R; 3]>::from).collect()
    }

    /// The colors with these numbers, red, green and blue of each.
    pub(super) fn from_numbers(numbers: &[R]) -> Self {
        Self::of(numbers.as_chunks().0.iter().map(|&[red, green, blue]| vec3(red, green, blue)))
    }

    /// With light added to the color in this place.
    pub(super) fn with(mut self, light: Vec3<R>, place: usize) -> Self {
        if let Some(own) = &mut self.0[place] {
            *own = *own + light;
        }
        self
    }

    /// With light added to the color whose place is a number; `None` if there are none.
    pub(super) fn with_chosen(mut self, light: Vec3<R>, place: Option<R>) -> Self {
        let Some(place) = place else { return self };
        for (index, own) in self.0.iter_mut().enumerate() {
            let is_own = (place - index as f32).abs().below(0.5);
            *own = own.map(|own| Vec3::select(is_own, own + light, own));
        }
        self
    }

    /// One of two, by a condition.
    pub(super) fn select(mask: R::Mask, yes: Self, no: Self) -> Self {
        yes.zip(no, |yes, no| Vec3::select(mask, yes, no))
    }

    fn zip(self, other: Self, mut both: impl FnMut(Vec3<R>, Vec3<R>) -> Vec3<R>) -> Self {
        let mut others = other.0.into_iter();
        Self(self.0.map(|own| own.zip(others.next().flatten()).map(|(own, other)| both(own, other))))
    }
}

impl<R: Real, const MAX: usize> Add for Colors<R, MAX> {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        self.zip(other, |own, other| own + other)
    }
}

impl<R: Real, const MAX: usize> Mul<R> for Colors<R, MAX> {
    type Output = Self;

    fn mul(self, factor: R) -> Self {
        Self(self.0.map(|own| own.map(|own| own * factor)))
    }
}
