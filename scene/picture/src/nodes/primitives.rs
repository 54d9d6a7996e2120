//! Shapes with a closed formula. Unless noted otherwise each is exact: its value is the Euclidean distance to
//! the surface, negative inside.

mod box_variants;
mod cones;
mod curves;
mod cut_spheres;
mod flat_faces;
mod periodic;
mod polygon_sides;
mod polyhedra;
mod prisms;
mod pyramid_face;
mod rings;
mod rounded;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use cones::{CappedCone, Cone, InfiniteCone, RoundCone, SolidAngle};
pub use curves::BezierTube;
pub use cut_spheres::{CutHollowSphere, CutSphere, DeathStar};
pub use flat_faces::{Quad, Triangle};
pub use rings::{CappedTorus, Horseshoe, Link, U};
pub use rounded::{Ellipsoid, RoundedCylinder, Vesica};

pub use box_variants::{BoxFrame, Rhombus};
pub use periodic::{Diamond, Gyroid, SchwarzP};
pub use polygon_sides::PolygonSides;
pub use polyhedra::{Dodecahedron, Icosahedron, Octahedron, Tetrahedron};
pub use prisms::{HexagonalPrism, OctagonalPrism, RegularPyramid};

use self::pyramid_face::PyramidFace;
use super::{Exactness, NodeError, Primitive};
use crate::bounds::Bounds;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Coordinate, Direction, Length, LengthOrZero, Point};

/// A ball around the origin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Sphere {
    /// Radius.
    pub radius: Length,
}

impl Primitive for Sphere {
    const ALIASES: &'static [&'static str] = &["ball"];
    const EXAMPLE: &str = r#"{ "radius": 1 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        p.length() - p.x.uniform(self.radius.get())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let radius = self.radius.in_frame();
        Bounds::symmetric(radius, radius, radius).expanded(isolevel)
    }
}

/// A box around the origin, its edges along the axes.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Box {
    /// Full extents along x, y and z.
    pub size: [Length; 3],
    /// Radius of its rounded edges, inside `size`.
    #[serde(default = "default_round")]
    pub round: LengthOrZero,
}

impl Primitive for Box {
    const ALIASES: &'static [&'static str] = &["cube", "cuboid", "rectangle"];
    const EXAMPLE: &str = r#"{ "size": [1.6, 1, 1.2], "round": 0.1 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let [x, y, z] = &self.size;
        let (half, round) = (0.5, self.round.get());
        let past_face = vec3(
            p.x.abs() - p.x.uniform(x.get() * half - round),
            p.y.abs() - p.x.uniform(y.get() * half - round),
            p.z.abs() - p.x.uniform(z.get() * half - round),
        );
        let outside = past_face.map(|c| c.at_least(0.0)).length();
        let inside = past_face.max_element().at_most(0.0);
        outside + inside - p.x.uniform(round)
    }

    fn validate(&self) -> Option<NodeError> {
        let most = self.size.iter().map(Length::in_frame).fold(f32::MAX, f32::min) / 2.0;
        (self.round.in_frame() > most).then(|| {
            NodeError::new(
                "round",
                format!(
                    "must be at most half the least size, because edges are rounded inward: make round {most} or less"
                ),
            )
        })
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let [x, y, z] = &self.size;
        Bounds::symmetric(x.in_frame() / 2.0, y.in_frame() / 2.0, z.in_frame() / 2.0).expanded(isolevel)
    }
}

/// A half-space: all points behind a plane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Plane {
    /// Direction that the surface faces, of any length.
    pub normal: Direction,
    /// Distance of the surface from the origin, along the normal.
    pub offset: Coordinate,
}

impl Primitive for Plane {
    const ALIASES: &'static [&'static str] = &["floor", "ground"];
    const EXAMPLE: &str = r#"{ "normal": [0.2, 1, 0.1], "offset": -0.2 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        p.dot_uniform(self.normal.unit()) - p.x.uniform(self.offset.get())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let farthest = self.offset.in_frame() + isolevel;
        // Behind a plane perpendicular to an axis, that coordinate is bounded.
        let low = |slope: f32| if slope == -1.0 { -farthest } else { f32::NEG_INFINITY };
        let high = |slope: f32| if slope == 1.0 { farthest } else { f32::INFINITY };
        let normal = self.normal.unit();
        Bounds { min: normal.map(low), max: normal.map(high) }
    }
}

/// A cylinder around the y axis, centered at the origin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Cylinder {
    /// Radius.
    pub radius: Length,
    /// Full height.
    pub height: Length,
}

impl Primitive for Cylinder {
    const ALIASES: &'static [&'static str] = &["capped_cylinder"];
    const EXAMPLE: &str = r#"{ "radius": 0.7, "height": 1.6 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let past_side = p.x.square_add(p.z.square()).sqrt() - p.x.uniform(self.radius.get());
        let past_cap = p.y.abs() - p.x.uniform(self.height.get() / 2.0);
        let (side, cap) = (past_side.at_least(0.0), past_cap.at_least(0.0));
        side.square_add(cap.square()).sqrt() + past_side.max(past_cap).at_most(0.0)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let radius = self.radius.in_frame();
        Bounds::symmetric(radius, self.height.in_frame() / 2.0, radius).expanded(isolevel)
    }
}

/// A cylinder around the y axis, infinitely long.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct InfiniteCylinder {
    /// Radius.
    pub radius: Length,
}

impl Primitive for InfiniteCylinder {
    const ALIASES: &'static [&'static str] = &["tube"];
    const EXAMPLE: &str = r#"{ "radius": 0.6 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        p.x.square_add(p.z.square()).sqrt() - p.x.uniform(self.radius.get())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let radius = self.radius.in_frame();
        Bounds::symmetric(radius, f32::INFINITY, radius).expanded(isolevel)
    }
}

/// A prism along z over an equilateral triangle that points up: base at y = −height/2, apex at y = height.
///
/// A bound: the distance to the nearest face's plane, as in Robles, Lee, Yin and Dhar,
/// "Procedural Rendering with Ray Marching".
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct TriangularPrism {
    /// Radius of the triangle's circumcircle.
    pub height: Length,
    /// Full length along z.
    pub length: Length,
}

impl Primitive for TriangularPrism {
    const EXAMPLE: &str = r#"{ "height": 0.8, "length": 1.6 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        const COS_30: f32 = 0.866_025_4;
        let past_end = p.z.abs() - p.x.uniform(self.length.get() / 2.0);
        let slope = p.x.abs() * COS_30 + p.y * 0.5;
        past_end.max(slope.max(-p.y) - p.x.uniform(self.height.get() / 2.0))
    }

    fn exactness(&self) -> Exactness {
        Exactness::Bound
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        // At a larger isolevel, the triangle is a larger one; its apex is its farthest corner.
        let apex = self.height.in_frame() + 2.0 * isolevel;
        Bounds::symmetric(apex, apex, self.length.in_frame() / 2.0 + isolevel)
    }
}

/// A pyramid over a rectangle on y = 0, its apex at y = height.
///
/// The distance to the slanted faces is Inigo Quilez's, "Distance functions":
/// <https://iquilezles.org/articles/distfunctions/>; the base is added here.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Pyramid {
    /// Height of its apex.
    pub height: Length,
    /// Full extents of its base along x and z; the unit square when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base: Option<[Length; 2]>,
}

impl Primitive for Pyramid {
    const EXAMPLE: &str = r#"{ "height": 0.9 }"#;
    const MORE_EXAMPLES: &[&str] = &[r#"{ "height": 0.7, "base": [1.8, 0.9] }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        if let Some(base) = &self.base {
            return rectangular_pyramid(p, base.each_ref().map(Length::in_frame), self.height.in_frame());
        }
        let slant = self.height.get() * self.height.get() + 0.25;
        let (over_slant, over_base) = (p.x.uniform(1.0 / slant), p.x.uniform(1.0 / (slant + 0.25)));
        let (height, slant) = (p.x.uniform(self.height.get()), p.x.uniform(slant));
        // By symmetry, the face toward +x; its base edge runs along z at x = 0.
        let (x, z) = (p.x.abs(), p.z.abs());
        let (x, z) = (x.max(z) - 0.5, x.min(z) - 0.5);
        // Along the edge, up the face, and out of it; the latter two times √slant.
        let (along, up, out) = (z, p.y * height - x * 0.5, x * height + p.y * 0.5);
        let past_edge = along.at_least(0.0);
        let to_base_edge = past_edge.square() * slant + up.square();
        let share = ((up - z * 0.5) * over_base).at_least(0.0).at_most(1.0);
        let to_slant_edge = (along + share * 0.5).square() * slant + (up - share * slant).square();
        let over_face = up.min(-along * slant - up * 0.5).above(0.0);
        let beside = R::select(over_face, p.y.constant(0.0), to_base_edge.min(to_slant_edge));
        let to_face = (beside + out.square()) * over_slant;
        let to_base = x.at_least(0.0).square_add(z.at_least(0.0).square_add(p.y.square()));
        let distance = to_face.min(to_base).sqrt();
        R::select(out.max(-p.y).below(0.0), -distance, distance)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let [x, z] = self.base.as_ref().map_or([0.5; 2], |base| base.each_ref().map(|extent| extent.in_frame() / 2.0));
        Bounds { min: vec3(-x, 0.0, -z), max: vec3(x, self.height.in_frame(), z) }.expanded(isolevel)
    }
}

/// Distance to a pyramid over a rectangle of these full extents along x and z.
fn rectangular_pyramid<R: Real>(p: Vec3<R>, base: [f32; 2], height: f32) -> R {
    let [half_x, half_z] = base.map(|extent| extent * 0.5);
    let (x, z) = (p.x.abs(), p.z.abs());
    let (to_side, past_side) = PyramidFace::new(half_x, half_z, height).distance_and_depth(x, z, p.y);
    let (to_front, past_front) = PyramidFace::new(half_z, half_x, height).distance_and_depth(z, x, p.y);
    let (past_x, past_z) = ((x - p.x.uniform(half_x)).at_least(0.0), (z - p.x.uniform(half_z)).at_least(0.0));
    let to_base = past_x.square_add(past_z.square_add(p.y.square()));
    let distance = to_side.min(to_front).min(to_base).sqrt();
    R::select(past_side.max(past_front).max(-p.y).below(0.0), -distance, distance)
}

/// A ring around the y axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Torus {
    /// Radius of the circle at the center of the tube.
    pub radius: Length,
    /// Radius of the tube.
    pub tube: Length,
}

impl Primitive for Torus {
    const ALIASES: &'static [&'static str] = &["donut", "doughnut", "ring"];
    const EXAMPLE: &str = r#"{ "radius": 0.8, "tube": 0.3 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let off_circle = p.x.square_add(p.z.square()).sqrt() - p.x.uniform(self.radius.get());
        off_circle.square_add(p.y.square()).sqrt() - p.x.uniform(self.tube.get())
    }

    fn validate(&self) -> Option<NodeError> {
        closed_hole_error("tube", self.tube.in_frame(), "radius", self.radius.in_frame())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (across, up) = (self.radius.in_frame() + self.tube.in_frame(), self.tube.in_frame());
        Bounds::symmetric(across, up, across).expanded(isolevel)
    }
}

/// All points within a radius of the segment between two points.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Capsule {
    /// One end of the segment.
    pub a: Point,
    /// The other end.
    pub b: Point,
    /// The radius.
    pub radius: Length,
}

impl Primitive for Capsule {
    const ALIASES: &'static [&'static str] = &["pill"];
    const EXAMPLE: &str = r#"{ "a": [-0.7, -0.4, 0], "b": [0.7, 0.5, 0.2], "radius": 0.4 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let (a, b) = (self.a.in_frame(), self.b.in_frame());
        let axis = vec3(b.x - a.x, b.y - a.y, b.z - a.z);
        // If both ends coincide, the shape is a ball: every point of a zero axis is the same.
        let axis_over_square = scaled(axis, 1.0 / axis.length_squared().max(1e-20));
        let from_a = p - Vec3::uniform(p.x, a);
        let share = from_a.dot_uniform(axis_over_square).at_least(0.0).at_most(1.0);
        let nearest = Vec3::uniform(p.x, vec3(-axis.x, -axis.y, -axis.z)).mul_add(share, from_a);
        nearest.length() - p.x.uniform(self.radius.get())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (a, b) = (self.a.in_frame(), self.b.in_frame());
        Bounds { min: a, max: a }.union(Bounds { min: b, max: b }).expanded(self.radius.in_frame() + isolevel)
    }
}

/// Distance of a point from the y axis.
fn distance_from_y_axis<R: Real>(p: Vec3<R>) -> R {
    hypot(p.x, p.z)
}

/// The length of a vector in the plane.
fn hypot<R: Real>(x: R, y: R) -> R {
    x.square_add(y.square()).sqrt()
}

/// Error for a ring so thick that its hole closes: `thick` must be less than `limit`.
fn closed_hole_error(place: &str, thick: f32, limit_name: &str, limit: f32) -> Option<NodeError> {
    (thick >= limit).then(|| {
        NodeError::new(
            place,
            format!("must be less than {limit_name}, or the ring has no hole: make {place} less than {limit}"),
        )
    })
}

fn scaled(v: Vec3<f32>, factor: f32) -> Vec3<f32> {
    vec3(v.x * factor, v.y * factor, v.z * factor)
}

fn default_round() -> LengthOrZero {
    LengthOrZero::new(0.0).expect("0 is in range")
}
