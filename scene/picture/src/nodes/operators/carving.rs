//! Patterns carved into a shape where another surface passes through it, and interpolation between two
//! shapes.
//!
//! functions", <http://mercury.sexy/hg_sdf/>. The pattern's material is visible where it changes the shape.
//! functions", <http://mercury.sexy/hg_sdf/>. The pattern's material is seen where it changes the shape.

use std::f32::consts::FRAC_1_SQRT_2;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::seams::around_joined;
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::nodes::value::indicator;
use crate::nodes::{Node, Sdf, SdfValue};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Fraction, Length};

/// A shape with a V-shaped line cut into it where the pattern's surface intersects its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Engrave {
    /// The shape, then the pattern.
    #[schemars(length(min = 2, max = 2))]
    pub of: Vec<Node>,
    /// Depth of the line, and half its width.
    pub depth: Length,
}

/// A shape with a rectangular channel cut into it where the pattern's surface intersects its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Groove {
    /// The shape, then the pattern.
    #[schemars(length(min = 2, max = 2))]
    pub of: Vec<Node>,
    /// Depth of the channel.
    pub depth: Length,
    /// Full width of the channel.
    pub width: Length,
}

/// A shape with a rectangular ridge on it where the pattern's surface intersects its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Tongue {
    /// The shape, then the pattern.
    #[schemars(length(min = 2, max = 2))]
    pub of: Vec<Node>,
    /// Height of the ridge.
    pub height: Length,
    /// Full width of the ridge.
    pub width: Length,
}

/// A shape between two others: their distances are interpolated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Morph {
    /// The first shape, then the last shape.
    #[schemars(length(min = 2, max = 2))]
    pub of: Vec<Node>,
    /// Position between the first shape, at 0, and the second, at 1.
    pub amount: Fraction,
}

/// Error for a list that does not have two shapes; an empty one is reported elsewhere.
fn require_two(of: &[Node], name: &str, what: &str) -> Option<NodeError> {
    let count = of.len();
    let shapes = if count == 1 { "shape" } else { "shapes" };
    let fault = || NodeError::new("of", format!("has {count} {shapes}: {name} takes exactly 2, {what}"));
    (count != 2).then(fault)
}

impl Sdf for Engrave {
    const EXAMPLE: &'static str = r#"{ "depth": 0.08, "of": [
        { "sphere": { "radius": 1 } },
        { "infinite_cylinder": { "radius": 0.5 } }
    ] }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let (shape, pattern): (V, V) = (sample(0, p), sample(1, p));
        let uncut = shape.distance();
        let cut = (uncut + uncut.uniform(self.depth.get()) - pattern.distance().abs()) * FRAC_1_SQRT_2;
        shape.blend(pattern, uncut.max(cut), || indicator(uncut, uncut.lt(cut)))
    }

    around_joined!();

    fn validate(&self) -> Option<NodeError> {
        require_two(&self.of, "engrave", "the shape and the pattern")
    }

    fn lipschitz(&self) -> f32 {
        // The cut is (a + depth − |b|)/√2: it changes by at most (La + Lb)/√2.
        let [a, b] = [0, 1].map(|index: usize| self.of[index].lipschitz());
        a.max((a + b) * FRAC_1_SQRT_2)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.of[0].bounds(isolevel)
    }
}

impl Sdf for Groove {
    const EXAMPLE: &'static str = r#"{ "depth": 0.1, "width": 0.15, "of": [
        { "box": { "size": [1.6, 1.6, 1.6], "round": 0.2 } },
        { "sphere": { "radius": 1 } }
    ] }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let (shape, pattern): (V, V) = (sample(0, p), sample(1, p));
        let uncut = shape.distance();
        let wall = uncut.uniform(0.5 * self.width.get()) - pattern.distance().abs();
        let cut = wall.min(uncut + uncut.uniform(self.depth.get()));
        shape.blend(pattern, uncut.max(cut), || indicator(uncut, uncut.lt(cut)))
    }

    around_joined!();

    fn validate(&self) -> Option<NodeError> {
        require_two(&self.of, "groove", "the shape and the pattern")
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.of[0].bounds(isolevel)
    }
}

impl Sdf for Tongue {
    const EXAMPLE: &'static str = r#"{ "height": 0.1, "width": 0.15, "of": [
        { "sphere": { "radius": 0.9 } },
        { "infinite_cylinder": { "radius": 0.5 } }
    ] }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let (shape, pattern): (V, V) = (sample(0, p), sample(1, p));
        let bare = shape.distance();
        let wall = pattern.distance().abs() - bare.uniform(0.5 * self.width.get());
        let ridge = wall.max(bare - bare.uniform(self.height.get()));
        shape.blend(pattern, bare.min(ridge), || indicator(bare, ridge.lt(bare)))
    }

    around_joined!();

    fn validate(&self) -> Option<NodeError> {
        require_two(&self.of, "tongue", "the shape and the pattern")
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.of[0].bounds(isolevel + self.height.in_frame())
    }
}

impl Sdf for Morph {
    const EXAMPLE: &'static str = r#"{ "amount": 0.5, "of": [
        { "box": { "size": [1.5, 1.5, 1.5] } },
        { "torus": { "radius": 0.8, "tube": 0.3 } }
    ] }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let (first, second): (V, V) = (sample(0, p), sample(1, p));
        let (start, end) = (first.distance(), second.distance());
        let amount = start.uniform(self.amount.get());
        let distance = end.mul_add(amount, start * start.uniform(1.0 - self.amount.get()));
        first.blend(second, distance, || amount)
    }

    around_joined!();

    fn validate(&self) -> Option<NodeError> {
        require_two(&self.of, "morph", "the shape to start from and the shape to end at")
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        // A mean is never less than the lesser.
        self.of[0].bounds(isolevel).union(self.of[1].bounds(isolevel))
    }
}
