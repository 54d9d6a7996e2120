//! Shapes joined with a shaped seam: beveled, stepped or with columns.
//!
//! Mercury, "`hg_sdf`: a GLSL library for building signed distance functions",
//! <http://mercury.sexy/hg_sdf/>. Each seam is a function of the two distances alone. Intersection and difference are
//! unions of the shapes' complements.
//!
//! Across the seam the second shape's weight changes linearly from 0 to 1.

use std::f32::consts::{FRAC_1_SQRT_2, SQRT_2};

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use super::fold_children;
use crate::bounds::Bounds;
use crate::kinds::Exactness;
use crate::nodes::{Node, Sdf, SdfValue};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Length, integer_in_range};

/// Maximum number of steps or columns of a seam.
const MAX_SEAM_STEPS: u32 = 64;

/// Kind of combination.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum SeamKind {
    /// The points inside any of the shapes.
    Union,
    /// The points inside all of the shapes.
    Intersection,
    /// The first shape without the others.
    Difference,
}

/// Shapes joined with a flat bevel along the seam.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Chamfer {
    /// Kind of combination.
    pub kind: SeamKind,
    /// The shapes, one or more, combined from the left.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Distance from the seam at which the bevel starts, on either surface.
    pub size: Length,
}

/// Shapes joined with a flight of steps along the seam.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Stairs {
    /// Kind of combination.
    pub kind: SeamKind,
    /// The shapes, one or more, combined from the left.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Distance from the seam at which the steps start, on either surface.
    pub size: Length,
    /// Number of edges that protrude between the two surfaces.
    #[serde(deserialize_with = "seam_steps")]
    #[schemars(range(min = 1, max = MAX_SEAM_STEPS))]
    pub steps: u32,
}

/// Shapes joined with a row of round columns along the seam.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Columns {
    /// Kind of combination.
    pub kind: SeamKind,
    /// The shapes, one or more, combined from the left.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Distance from the seam at which the columns start, on either surface.
    pub size: Length,
    /// Number of columns side by side.
    #[serde(deserialize_with = "seam_steps")]
    #[schemars(range(min = 1, max = MAX_SEAM_STEPS))]
    pub columns: u32,
}

impl SeamKind {
    /// Combines two shapes by the seam of a union, which is a function of two distances.
    fn combine<R: Real, V: SdfValue<R>>(self, a: V, b: V, size: &Length, seam: impl FnOnce(R, R) -> R) -> V {
        let (da, db) = match self {
            Self::Union => (a.distance(), b.distance()),
            Self::Intersection => (-a.distance(), -b.distance()),
            Self::Difference => (-a.distance(), b.distance()),
        };
        let outside = seam(da, db);
        let distance = match self {
            Self::Union => outside,
            Self::Intersection | Self::Difference => -outside,
        };
        a.blend(b, distance, || {
            let share = (da - db).mul_add(da.uniform(0.5 / size.get()), da.constant(0.5));
            share.at_least(0.0).at_most(1.0)
        })
    }

    /// Box that contains every point whose value is at most `isolevel`, for shapes folded from the left. Where a
    /// union's value is at most `isolevel`, the lesser of two distances is at most `reach` of it. The other kinds are
    /// never less than the shapes that they cut from.
    fn bounds(self, of: &[Node], isolevel: f32, reach: impl Fn(f32) -> f32) -> Bounds {
        let first = &of[0];
        match self {
            Self::Union => {
                let isolevel = of[1..].iter().fold(isolevel, |isolevel, _| reach(isolevel));
                of.iter().map(|shape| shape.bounds(isolevel)).fold(first.bounds(isolevel), Bounds::union)
            }
            Self::Intersection => {
                of.iter().map(|shape| shape.bounds(isolevel)).fold(first.bounds(isolevel), Bounds::intersection)
            }
            Self::Difference => first.bounds(isolevel),
        }
    }
}

/// The Lipschitz factor of shapes folded from the left, from a function of two factors.
fn folded_lipschitz(of: &[Node], both: impl Fn(f32, f32) -> f32) -> f32 {
    of.iter().map(Node::lipschitz).reduce(|a, b| a.max(b).max(both(a, b))).unwrap_or(1.0)
}

macro_rules! around_joined {
    () => {
        fn has_child_list(&self) -> bool {
            true
        }

        fn own_exactness(&self) -> Exactness {
            self.of.iter().map(Node::exactness).fold(Exactness::Bound, Exactness::max)
        }

        fn children(&self) -> &[Node] {
            &self.of
        }

        fn children_mut(&mut self) -> &mut [Node] {
            &mut self.of
        }
    };
}

pub(super) use around_joined;

impl Sdf for Chamfer {
    const EXAMPLE: &'static str = r#"{ "kind": "union", "size": 0.25, "of": [
        { "box": { "size": [1.7, 0.7, 1.7] } },
        { "cylinder": { "radius": 0.45, "height": 2.2 } }
    ] }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "kind": "intersection", "size": 0.2, "of": [
            { "box": { "size": [1.6, 1.6, 1.6] } },
            { "sphere": { "radius": 1 } }
        ] }"#,
        r#"{ "kind": "difference", "size": 0.2, "of": [
            { "box": { "size": [1.6, 1.6, 1.6] } },
            { "cylinder": { "radius": 0.4, "height": 2 } }
        ] }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let size = self.size.get();
        fold_children(&self.of, p, sample, |a, b| {
            self.kind.combine(a, b, &self.size, |a: R, b: R| a.min(b).min((a + b - a.uniform(size)) * FRAC_1_SQRT_2))
        })
    }

    around_joined!();

    fn lipschitz(&self) -> f32 {
        // The bevel is (a + b − size)/√2: it changes by at most (La + Lb)/√2, where both surfaces are parallel.
        folded_lipschitz(&self.of, |a, b| (a + b) * FRAC_1_SQRT_2)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        // On the bevel a + b ≤ size + √2 isolevel, so the lesser is at most half of that.
        let reach = |isolevel: f32| isolevel.max(self.size.in_frame() * 0.5 + isolevel * FRAC_1_SQRT_2);
        self.kind.bounds(&self.of, isolevel, reach)
    }
}

impl Sdf for Stairs {
    const EXAMPLE: &'static str = r#"{ "kind": "union", "size": 0.5, "steps": 3, "of": [
        { "translate": { "by": [0, -0.6, 0], "child": { "box": { "size": [2, 0.4, 1.8] } } } },
        { "box": { "size": [0.5, 1.8, 0.5] } }
    ] }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "kind": "intersection", "size": 0.3, "steps": 1, "of": [
            { "box": { "size": [1.6, 1.6, 1.6] } },
            { "infinite_cylinder": { "radius": 0.8 } }
        ] }"#,
        r#"{ "kind": "difference", "size": 0.4, "steps": 4, "of": [
            { "box": { "size": [1.7, 1.5, 1.7] } },
            { "translate": { "by": [0, 0.75, 0], "child": { "sphere": { "radius": 0.5 } } } }
        ] }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let size = self.size.in_frame();
        let step = size / (self.steps + 1) as f32;
        fold_children(&self.of, p, sample, |a, b| {
            self.kind.combine(a, b, &self.size, |a: R, b: R| {
                let past = b - a.uniform(size);
                let along = past - a + a.uniform(step);
                let step_number = (along * a.uniform(0.5 / step)).floor();
                let on_step = step_number.mul_add(a.uniform(-2.0 * step), along);
                let steps = (past + a + (on_step - a.uniform(step)).abs()) * 0.5;
                a.min(b).min(steps)
            })
        })
    }

    // With the zigzag's slope of ±1 the steps are ½(b + a ± (b − a)): they change like a or like b, so the greatest
    // factor of the shapes is the factor of the result.
    around_joined!();

    fn bounds(&self, isolevel: f32) -> Bounds {
        // On the steps ½(a + b − size) ≤ isolevel, so the lesser is at most isolevel + size/2.
        let reach = |isolevel: f32| isolevel + self.size.in_frame() * 0.5;
        self.kind.bounds(&self.of, isolevel, reach)
    }
}

impl Columns {
    /// A column's radius, and the distance of its center from the seam along the diagonal.
    fn column_layout(&self) -> (f32, f32) {
        let (size, count) = (self.size.in_frame(), self.columns as f32);
        match self.kind {
            SeamKind::Union => {
                let radius = size * SQRT_2 / (2.0 * count + SQRT_2);
                (radius, size * FRAC_1_SQRT_2 - radius * SQRT_2)
            }
            SeamKind::Intersection | SeamKind::Difference => {
                let radius = size * SQRT_2 / (2.0 * (count - 1.0) + SQRT_2);
                (radius, (size + radius) * FRAC_1_SQRT_2)
            }
        }
    }
}

impl Sdf for Columns {
    const EXAMPLE: &'static str = r#"{ "kind": "union", "size": 0.5, "columns": 3, "of": [
        { "translate": { "by": [0, -0.6, 0], "child": { "box": { "size": [2, 0.4, 1.8] } } } },
        { "cylinder": { "radius": 0.3, "height": 1.9 } }
    ] }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "kind": "intersection", "size": 0.3, "columns": 2, "of": [
            { "box": { "size": [1.6, 1.6, 1.6] } },
            { "infinite_cylinder": { "radius": 0.8 } }
        ] }"#,
        r#"{ "kind": "difference", "size": 0.4, "columns": 3, "of": [
            { "box": { "size": [1.7, 1.5, 1.7] } },
            { "cylinder": { "radius": 0.4, "height": 2 } }
        ] }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let (radius, depth) = self.column_layout();
        // The row is centered on the diagonal, with a column there if their number is odd.
        let start = if self.columns % 2 == 1 { 0.5 } else { 0.0 };
        fold_children(&self.of, p, sample, |a, b| {
            self.kind.combine(a, b, &self.size, |a: R, b: R| {
                let across = (a + b).mul_add(a.constant(FRAC_1_SQRT_2), a.uniform(-depth));
                let along = (b - a) * FRAC_1_SQRT_2;
                let number = (along.mul_add(a.uniform(0.5 / radius), a.constant(start))).floor() + (0.5 - start);
                let beside = number.mul_add(a.uniform(-2.0 * radius), along);
                let column = across.square_add(beside.square()).sqrt() - a.uniform(radius);
                let row = match self.kind {
                    SeamKind::Union => across.min(column),
                    SeamKind::Intersection | SeamKind::Difference => across.max(-column),
                };
                a.min(b).min(row)
            })
        })
    }

    around_joined!();

    fn lipschitz(&self) -> f32 {
        // In the plane of the two distances every value is at most a Euclidean distance, so it changes by at most
        // √(La² + Lb²).
        folded_lipschitz(&self.of, |a, b| Real::sqrt(a * a + b * b))
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        // No column extends farther than a bevel of the same size, a + b ≤ size + √2 isolevel.
        let reach = |isolevel: f32| isolevel.max(self.size.in_frame() * 0.5 + isolevel * FRAC_1_SQRT_2);
        self.kind.bounds(&self.of, isolevel, reach)
    }
}

fn seam_steps<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 1, MAX_SEAM_STEPS, "across the seam")
}
