//! Numbers of a scene on their way into a formula.

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::{Vec3, vec3};

/// A number of a scene, perhaps of one frame. It can be computed with, and only [`Real::uniform`](super::Real::uniform)
/// takes it. So no code branches on the value of the frame that a formula is recorded in, and all frames share its
/// program.
///
/// ```compile_fail
/// let radius = math::real::Uniform::from(2.0);
/// assert!(radius > 1.0);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Uniform(pub(super) f32);

impl From<f32> for Uniform {
    fn from(value: f32) -> Self {
        Self(value)
    }
}

impl From<Vec3<f32>> for Vec3<Uniform> {
    fn from(value: Vec3<f32>) -> Self {
        vec3(Uniform(value.x), Uniform(value.y), Uniform(value.z))
    }
}

impl Neg for Uniform {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

macro_rules! arithmetic {
    ($($Operation:ident $method:ident),*) => { $(
        impl<T: Into<Self>> $Operation<T> for Uniform {
            type Output = Self;
            fn $method(self, other: T) -> Self {
                Self(self.0.$method(other.into().0))
            }
        }

        impl $Operation<Uniform> for f32 {
            type Output = Uniform;
            fn $method(self, other: Uniform) -> Uniform {
                Uniform(self.$method(other.0))
            }
        }
    )* };
}

arithmetic!(Add add, Sub sub, Mul mul, Div div);
