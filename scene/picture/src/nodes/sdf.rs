//! The interface of a node without children.

use super::{Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::real::{Real, Vec3};

/// Cost of noise at a point, in evaluations of a simple node.
pub(super) const NOISE_COST: f32 = 20.0;
/// Cost of a fractal.
pub(super) const FRACTAL_COST: f32 = 32.0;

/// Node without children, described by its distance alone.
pub trait Primitive {
    /// Names that other tools and common usage give it, to suggest its own.
    const ALIASES: &'static [&'static str] = &[];

    /// A small valid value, as a user would write it.
    const EXAMPLE: &'static str;

    /// Further values that exercise other branches of the formula.
    const MORE_EXAMPLES: &'static [&'static str] = &[];

    /// The signed distance from `p` to the surface, negative inside.
    fn distance<R: Real>(&self, p: Vec3<R>) -> R;

    /// Box that contains every point whose distance is at most `isolevel`, which is at least 0.
    fn bounds(&self, isolevel: f32) -> Bounds;

    /// A Lipschitz factor L: |d(p) − d(q)| ≤ L · |p − q|.
    fn lipschitz(&self) -> f32 {
        1.0
    }

    /// Relation of its value to the true distance.
    fn exactness(&self) -> Exactness {
        Exactness::Exact
    }

    /// Whether its surface has fine detail at every scale, see [`Sdf::is_fine`].
    fn is_fine(&self) -> bool {
        false
    }

    /// Error in its numbers taken together, if any; each number alone is in range.
    fn validate(&self) -> Option<NodeError> {
        None
    }
}

impl<P: Primitive> Sdf for P {
    const ALIASES: &'static [&'static str] = <P as Primitive>::ALIASES;
    const EXAMPLE: &'static str = <P as Primitive>::EXAMPLE;
    const MORE_EXAMPLES: &'static [&'static str] = <P as Primitive>::MORE_EXAMPLES;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, _: &impl Fn(usize, Vec3<R>) -> V) -> V {
        V::new(self.distance(p))
    }

    fn lipschitz(&self) -> f32 {
        Primitive::lipschitz(self)
    }

    fn own_exactness(&self) -> Exactness {
        Primitive::exactness(self)
    }

    fn is_fine(&self) -> bool {
        Primitive::is_fine(self)
    }

    fn validate(&self) -> Option<NodeError> {
        Primitive::validate(self)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        Primitive::bounds(self, isolevel)
    }
}
