//! Transforms of a shape: translated, scaled. An exact distance remains exact.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::carried::carries_child;
use super::cut::Cut;
use super::{Child, Node, Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Point, ScaleFactor};

/// A translated shape.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Translate {
    /// Offset, in scene units.
    pub by: Point,
    /// The shape.
    pub child: Child,
}

impl Node {
    /// A shape moved by an offset.
    pub(crate) fn translated(by: Point, child: Self) -> Self {
        Self::Translate(Translate { by, child: Box::new(child) })
    }
}

/// Scales a shape uniformly.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Scale {
    /// Scale factor.
    pub by: ScaleFactor,
    /// The shape.
    pub child: Child,
}

macro_rules! around_child {
    () => {
        fn children(&self) -> &[Node] {
            std::slice::from_ref(&self.child)
        }

        fn children_mut(&mut self) -> &mut [Node] {
            std::slice::from_mut(&mut self.child)
        }
    };
}

pub(super) use around_child;

impl Sdf for Translate {
    const ALIASES: &'static [&'static str] = &["move", "transform"];
    const EXAMPLE: &str = r#"{ "by": [0.6, 0.3, 0], "child": { "box": { "size": [1, 1, 1] } } }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        sample(0, self.to_child(p))
    }

    around_child!();

    fn cut(&self) -> Cut<'_> {
        Cut::Child(&self.child)
    }

    fn to_child<R: Real>(&self, p: Vec3<R>) -> Vec3<R> {
        p - Vec3::uniform(p.x, self.by.get())
    }

    fn bounds_from_child(&self, child: Bounds) -> Bounds {
        child.translated(self.by.in_frame())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.bounds_from_child(self.child.bounds(isolevel))
    }

    carries_child!(|self| self.by.is_animated());

    fn is_placement_animated(&self) -> bool {
        self.by.is_animated()
    }
}

impl Translate {
    fn outward<R: Real>(&self, q: Vec3<R>) -> Vec3<R> {
        q + Vec3::uniform(q.x, self.by.get())
    }
}

impl Scale {
    fn outward<R: Real>(&self, q: Vec3<R>) -> Vec3<R> {
        q * q.x.uniform(self.by.get())
    }
}

impl Sdf for Scale {
    const ALIASES: &'static [&'static str] = &["resize"];
    const EXAMPLE: &str = r#"{ "by": 1.4, "child": { "torus": { "radius": 0.6, "tube": 0.2 } } }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let by = self.by.get();
        let child: V = sample(0, p * p.x.uniform(1.0 / by));
        let distance = child.distance() * p.x.uniform(by);
        child.with_distance(distance)
    }

    around_child!();

    carries_child!(|self| self.by.is_animated());

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.child.bounds(isolevel / self.by.in_frame()).scaled(self.by.in_frame())
    }
}
