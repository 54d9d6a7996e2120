//! A shape together with its image in a plane.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::cached::Cached;
use super::nearest_copy::{ChildBounds, RepeatedChild, sample_nearest};
use crate::bounds::Bounds;
use crate::kinds::Exactness;
use crate::nodes::carried::way_between;
use crate::nodes::transforms::around_child;
use crate::nodes::{Child, Node, Sdf, SdfValue};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Coordinate, Direction};

/// A shape together with its mirror image in a plane. The shape may be on either side of the plane, or across it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Mirror {
    /// A direction at right angles to the plane, of any length.
    pub normal: Direction,
    /// Offset of the plane from the origin along the normal.
    #[serde(default = "default_offset")]
    pub offset: Coordinate,
    /// The shape.
    pub child: Child,
    /// Values derived from the fields above.
    #[serde(skip)]
    #[schemars(skip)]
    sides: Cached<MirrorSides>,
}

/// Sides of the plane that the shape occupies.
#[derive(Clone, Debug)]
struct MirrorSides {
    /// Side of the center of its bounds: −1 or 1.
    main: f32,
    /// Whether its bounds are entirely on that side and do not touch the plane.
    is_one_sided: bool,
    held: ChildBounds,
}

impl Mirror {
    fn sides(&self) -> &MirrorSides {
        self.sides.get(|| {
            let held = ChildBounds::new(&self.child);
            let bounds = held.bounds;
            let normal = self.normal.unit();
            let half = (bounds.max - bounds.min) * 0.5;
            let middle = Vec3::dot(normal, (bounds.max + bounds.min) * 0.5) - self.offset.in_frame();
            let reach = Vec3::dot(normal.map(f32::abs), half);
            // A box that touches the plane counts as crossing it, and so does one that rounding
            // cannot distinguish from it.
            let is_apart = middle.abs() > reach * (1.0 + 1e-6);
            MirrorSides { main: if middle < 0.0 { -1.0 } else { 1.0 }, is_one_sided: is_apart, held }
        })
    }
}

impl Mirror {
    fn height<R: Real>(&self, p: Vec3<R>) -> R {
        height(p, self.normal.unit(), self.offset.in_frame())
    }

    fn image<R: Real>(&self, p: Vec3<R>) -> Vec3<R> {
        Vec3::uniform(p.x, self.normal.unit()).mul_add(self.height(p) * -2.0, p)
    }
}

impl Sdf for Mirror {
    const EXAMPLE: &'static str = r#"{ "normal": [1, 0, 0], "child": {
        "capsule": { "a": [0.9, -0.7, 0], "b": [-0.2, 0.6, 0], "radius": 0.25 }
    } }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "normal": [1, 2, 0], "offset": -0.1, "child": {
            "translate": { "by": [-0.5, -0.4, 0], "child": { "box": { "size": [0.5, 0.3, 0.9] } } }
        } }"#,
        r#"{ "normal": [0, 0, 1], "child": { "mirror": { "normal": [1, 0, 0], "child": {
            "translate": { "by": [0.6, 0, 0.5], "child": { "torus": { "radius": 0.3, "tube": 0.1 } } }
        } } } }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let MirrorSides { main, is_one_sided: is_apart, ref held } = *self.sides();
        let original = RepeatedChild::new(&self.child, held);
        // Along the normal on the side of the shape: the mirror image of a point there is farther away.
        let normal = self.normal.unit() * main;
        let offset = self.offset.in_frame() * main;
        let copies = p.x.uniform(if is_apart { 1.0 } else { 2.0 });
        let folded = Vec3::uniform(p.x, normal).mul_add(height(p, normal, offset).at_most(0.0) * -2.0, p);
        let (_, _, nearest) =
            R::repeat(2, (p.x.constant(1.0), folded, RepeatedChild::start(p)), |(looked_at, place, nearest)| {
                let nearest = original.nearer(place, nearest);
                let image = Vec3::uniform(p.x, normal).mul_add(height(place, normal, offset) * -2.0, place);
                (looked_at.lt(copies), (looked_at + 1.0, image, nearest))
            });
        sample_nearest(nearest, sample)
    }

    around_child!();

    /// An image moves as a mirror image does, also if the plane moves.
    fn way_from_child<R: Real>(&self, next: &Self, [p, q]: [Vec3<R>; 2], way: Option<Vec3<R>>) -> Option<Vec3<R>> {
        let is_animated = self.normal.is_animated() || self.offset.is_animated();
        let of_image = way_between(q, way, is_animated, [&|q| self.image(q), &|q| next.image(q)])?;
        let is_image = (self.height(p) * self.height(q)).below(0.0);
        let zero = p.x.constant(0.0);
        let of_original = way.unwrap_or(vec3(zero, zero, zero));
        Some(Vec3::select(is_image, of_image, of_original))
    }

    fn own_exactness(&self) -> Exactness {
        let child = self.child.exactness();
        if self.sides().is_one_sided { child } else { child.max(Exactness::Bound) }
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (child, normal) = (self.child.bounds(isolevel), self.normal.unit());
        let column = |axis: Vec3<f32>, along: f32| axis - normal * (2.0 * along);
        let image = child.rotated([
            column(vec3(1.0, 0.0, 0.0), normal.x),
            column(vec3(0.0, 1.0, 0.0), normal.y),
            column(vec3(0.0, 0.0, 1.0), normal.z),
        ]);
        child.union(image.translated(normal * (2.0 * self.offset.in_frame())))
    }

    fn child_evaluations(&self) -> f32 {
        2.0
    }
}

/// Height of a point above a plane.
fn height<R: Real>(p: Vec3<R>, normal: Vec3<f32>, offset: f32) -> R {
    p.dot_uniform(normal) - p.x.uniform(offset)
}

fn default_offset() -> Coordinate {
    Coordinate::new(0.0).expect("0 is in range")
}
