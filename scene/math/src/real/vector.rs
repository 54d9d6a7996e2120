//! Vectors of three numbers.

use std::ops::{Add, Mul, Neg, Sub};

use super::{Real, Uniform};

/// A point, a direction or a color.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vec3<R> {
    /// To the right, or red.
    pub x: R,
    /// Up, or green.
    pub y: R,
    /// Toward the viewer, or blue.
    pub z: R,
}

/// A vector of three numbers.
pub const fn vec3<R>(x: R, y: R, z: R) -> Vec3<R> {
    Vec3 { x, y, z }
}

impl<R: Real> Vec3<R> {
    /// A vector of the scene in every lane of numbers like `like`.
    pub fn uniform(like: R, vector: impl Into<Vec3<Uniform>>) -> Self {
        let vector = vector.into();
        vec3(like.uniform(vector.x), like.uniform(vector.y), like.uniform(vector.z))
    }

    /// Applies `f` to each coordinate.
    pub fn map(self, mut f: impl FnMut(R) -> R) -> Self {
        vec3(f(self.x), f(self.y), f(self.z))
    }

    /// Scalar product, fused from z to x.
    pub fn dot(self, other: Self) -> R {
        self.x.mul_add(other.x, self.y.mul_add(other.y, self.z * other.z))
    }

    /// Scalar product with a vector of the scene.
    pub fn dot_uniform(self, other: impl Into<Vec3<Uniform>>) -> R {
        self.dot(Self::uniform(self.x, other))
    }

    /// Vector product.
    pub fn cross(self, other: Self) -> Self {
        vec3(
            self.y.mul_add(other.z, -(self.z * other.y)),
            self.z.mul_add(other.x, -(self.x * other.z)),
            self.x.mul_add(other.y, -(self.y * other.x)),
        )
    }

    /// Square of the Euclidean length.
    pub fn length_squared(self) -> R {
        self.x.square_add(self.y.square_add(self.z.square()))
    }

    /// Euclidean length.
    pub fn length(self) -> R {
        self.length_squared().sqrt()
    }

    /// The vector of length 1 in this direction; nearly 0 for a vector shorter than 10⁻¹⁴.
    pub fn normalize(self) -> Self {
        self * (self.x.constant(1.0) / self.length().at_least(1e-14))
    }

    /// `self · factor + term`, fused by coordinate: a point along a ray.
    pub fn mul_add(self, factor: R, term: Self) -> Self {
        vec3(self.x.mul_add(factor, term.x), self.y.mul_add(factor, term.y), self.z.mul_add(factor, term.z))
    }

    /// The mean of the coordinates.
    pub fn mean(self) -> R {
        (self.x + self.y + self.z) * (1.0 / 3.0)
    }

    /// Each coordinate times the other vector's, for example light through a filter.
    pub fn mul_elementwise(self, other: Self) -> Self {
        vec3(self.x * other.x, self.y * other.y, self.z * other.z)
    }

    /// `self` times `factor` plus `term`, element by element, fused.
    pub fn mul_add_elementwise(self, factor: Self, term: Self) -> Self {
        vec3(self.x.mul_add(factor.x, term.x), self.y.mul_add(factor.y, term.y), self.z.mul_add(factor.z, term.z))
    }

    /// The greatest coordinate.
    pub fn max_element(self) -> R {
        self.x.max(self.y).max(self.z)
    }

    /// The least coordinate.
    pub fn min_element(self) -> R {
        self.x.min(self.y).min(self.z)
    }

    /// `yes` where `mask` is true, else `no`.
    pub fn select(mask: R::Mask, yes: Self, no: Self) -> Self {
        vec3(R::select(mask, yes.x, no.x), R::select(mask, yes.y, no.y), R::select(mask, yes.z, no.z))
    }
}

impl<R> From<Vec3<R>> for [R; 3] {
    fn from(vector: Vec3<R>) -> Self {
        [vector.x, vector.y, vector.z]
    }
}

impl<R: Real> Add for Vec3<R> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        vec3(self.x + other.x, self.y + other.y, self.z + other.z)
    }
}

impl<R: Real> Sub for Vec3<R> {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        vec3(self.x - other.x, self.y - other.y, self.z - other.z)
    }
}

impl<R: Real> Neg for Vec3<R> {
    type Output = Self;
    fn neg(self) -> Self {
        vec3(-self.x, -self.y, -self.z)
    }
}

impl<R: Real> Mul<R> for Vec3<R> {
    type Output = Self;
    fn mul(self, factor: R) -> Self {
        vec3(self.x * factor, self.y * factor, self.z * factor)
    }
}
