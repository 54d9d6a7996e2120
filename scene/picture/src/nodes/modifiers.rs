//! Modifiers of a shape other than its position.

mod bend;
pub(super) mod cached;
mod elongation;
mod mirror;
mod nearest_copy;
mod polar_repeat;
mod repeat;
mod taper;
mod thickness;
mod twist;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use bend::Bend;
pub use elongation::{Elongate, Stretch};
pub use mirror::Mirror;
pub use polar_repeat::PolarRepeat;
pub use repeat::{CopyCount, Repeat};
pub use taper::Taper;
pub use thickness::{Onion, Round};
pub use twist::Twist;

use super::cut::Cut;
use super::transforms::around_child;
use super::{Child, Node, Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::materials::MaterialRef;
use crate::real::{Real, Vec3};
use crate::seek::Seek;

/// Gives a shape its own material; the innermost `paint` is visible.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Paint {
    /// The material: a name from `materials`, or one in place.
    pub material: MaterialRef,
    /// The shape.
    pub child: Child,
}

impl Node {
    /// A shape with a material of its own.
    pub fn painted(material: MaterialRef, child: Self) -> Self {
        Self::Paint(Paint { material, child: Box::new(child) })
    }

    /// Material of all of its shape, if it names one.
    pub fn material(&self) -> Option<&MaterialRef> {
        if let Self::Paint(paint) = self { Some(&paint.material) } else { None }
    }
}

impl Sdf for Paint {
    const EXAMPLE: &str = r##"{
        "material": { "diffuse": { "kd": "#d9481c" } },
        "child": { "sphere": { "radius": 1 } }
    }"##;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let child: V = sample(0, p);
        child.paint(self.material.slot(), p)
    }

    fn materials(&self) -> Vec<(Option<usize>, &MaterialRef)> {
        vec![(None, &self.material)]
    }

    fn materials_mut(&mut self) -> Vec<(Option<usize>, &mut MaterialRef)> {
        vec![(None, &mut self.material)]
    }

    around_child!();

    fn cut(&self) -> Cut<'_> {
        Cut::Child(&self.child)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.child.bounds(isolevel)
    }
}
