//! Thicker and hollow shapes: surfaces at a constant distance from a shape's surface.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bounds::Bounds;
use crate::kinds::Exactness;
use crate::nodes::transforms::around_child;
use crate::nodes::{Child, Node, Sdf, SdfValue};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Length, LengthOrZero};

/// A shape grown by a radius on all sides, its outer edges rounded by it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Round {
    /// Growth on all sides, in scene units.
    pub radius: LengthOrZero,
    /// The shape.
    pub child: Child,
}

/// A shape's surface as a wall, hollow inside.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Onion {
    /// Full thickness of the wall, half of it on either side of the shape's surface.
    pub thickness: Length,
    /// The shape.
    pub child: Child,
}

/// A surface at a constant distance from another. The value stays below the distance inside a concave edge.
macro_rules! at_a_distance {
    ($self:ident, $grown:expr) => {
        around_child!();

        fn own_exactness(&self) -> Exactness {
            self.child.exactness().max(Exactness::Bound)
        }

        fn bounds(&$self, isolevel: f32) -> Bounds {
            $self.child.bounds(isolevel + $grown)
        }
    };
}

impl Sdf for Round {
    const ALIASES: &'static [&'static str] = &["bevel"];
    const EXAMPLE: &'static str = r#"{ "radius": 0.2, "child": { "pyramid": { "height": 0.9 } } }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let child: V = sample(0, p);
        let distance = child.distance() - p.x.uniform(self.radius.get());
        child.with_distance(distance)
    }

    at_a_distance!(self, self.radius.in_frame());
}

impl Sdf for Onion {
    const ALIASES: &'static [&'static str] = &["hollow", "shell"];
    const EXAMPLE: &'static str = r#"{ "thickness": 0.12, "child": { "difference": { "of": [
        { "sphere": { "radius": 1 } },
        { "translate": { "by": [0.3, 1, 0.7], "child": { "box": { "size": [1.8, 1.4, 1.4] } } } }
    ] } } }"#;
    const MORE_EXAMPLES: &'static [&'static str] =
        &[r#"{ "thickness": 0.1, "child": { "onion": { "thickness": 0.3, "child": {
        "torus": { "radius": 0.7, "tube": 0.3 }
    } } } }"#];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let child: V = sample(0, p);
        let distance = child.distance().abs() - p.x.uniform(0.5 * self.thickness.get());
        child.with_distance(distance)
    }

    at_a_distance!(self, 0.5 * self.thickness.in_frame());
}
