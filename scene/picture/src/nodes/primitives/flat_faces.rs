//! Flat faces between corners, with a thickness: all points within a radius of the face. All are exact.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bounds::Bounds;
use crate::kinds::NodeError;
use crate::nodes::{Precompute, Precomputed, Primitive};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Length, Point};

/// All points within a radius of a triangle.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename = "Triangle", deny_unknown_fields)]
pub struct TriangleParams {
    /// One corner.
    pub a: Point,
    /// The next corner.
    pub b: Point,
    /// The last corner.
    pub c: Point,
    /// Half its thickness, and the radius of its rounded edges.
    pub radius: Length,
}

/// `TriangleParams` with its derived values.
pub type Triangle = Precomputed<TriangleParams>;

impl Precompute for TriangleParams {
    type Derived = ConvexFace<3>;

    fn derive(&self) -> ConvexFace<3> {
        let [a, b, c] = [&self.a, &self.b, &self.c].map(Point::in_frame);
        ConvexFace::new([a, b, c], direction((b - a).cross(c - a)))
    }
}

impl Primitive for Triangle {
    const EXAMPLE: &str = r#"{ "a": [-1, -0.6, 0.3], "b": [0.9, -0.7, 0.1], "c": [0.1, 0.9, -0.4], "radius": 0.1 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.derive().distance(p) - p.x.uniform(self.radius.get())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.derive().bounds().expanded(self.radius.in_frame() + isolevel)
    }
}

/// All points within a radius of a flat face with four corners, in order around it.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename = "Quad", deny_unknown_fields)]
pub struct QuadParams {
    /// One corner.
    pub a: Point,
    /// The second corner.
    pub b: Point,
    /// The third corner, opposite `a`.
    pub c: Point,
    /// The last corner, opposite `b`.
    pub d: Point,
    /// Half its thickness, and the radius of its rounded edges.
    pub radius: Length,
}

/// `QuadParams` with its derived values.
pub type Quad = Precomputed<QuadParams>;

/// Maximum distance of a corner from the plane of the four, as a fraction of the larger diagonal: enough for
/// coordinates rounded to a few digits. The corner is then moved onto that plane.
const FLATNESS: f32 = 1e-3;

impl QuadParams {
    /// Normal of the plane through the centers of its sides, and the height of the corners a and c above it; b and d
    /// are as far below.
    fn plane(&self) -> (Vec3<f32>, f32) {
        let [a, b, c, d] = [&self.a, &self.b, &self.c, &self.d].map(Point::in_frame);
        let normal = direction((c - a).cross(d - b));
        (normal, ((a - b) + (c - d)).dot(normal) * 0.25)
    }

    /// The longer diagonal.
    fn size(&self) -> f32 {
        let [a, b, c, d] = [&self.a, &self.b, &self.c, &self.d].map(Point::in_frame);
        (c - a).length().max((d - b).length())
    }

    /// Error for corners that are not in one plane.
    fn non_planar_error(&self) -> Option<NodeError> {
        let [a, b, c, d] = [&self.a, &self.b, &self.c, &self.d].map(Point::in_frame);
        (self.plane().1.abs() > FLATNESS * self.size()).then(|| {
            let normal = direction((b - a).cross(c - a));
            let Vec3 { x, y, z } = normal.mul_add((a - d).dot(normal), d);
            let message = format!(
                "is not in one plane with a, b and c: put it at [{x}, {y}, {z}], or make two triangles of the four"
            );
            NodeError::new("d", message)
        })
    }

    /// Error for an outline that turns left at one corner and right at another.
    fn non_convex_error(&self) -> Option<NodeError> {
        let corners = [&self.a, &self.b, &self.c, &self.d].map(Point::in_frame);
        let turns = [3, 0, 1, 2].map(|before| {
            let [before, here, after] = [before, before + 1, before + 2].map(|place| corners[place % 4]);
            (here - before).cross(after - here)
        });
        let sharpest = turns.into_iter().fold(turns[0], |a, b| if b.length() > a.length() { b } else { a });
        let least = -FLATNESS * self.size() * self.size();
        let back = turns.into_iter().position(|turn| turn.dot(direction(sharpest)) < least);
        back.map(|corner| {
            NodeError::new(
                ["a", "b", "c", "d"][corner],
                "makes the outline concave: order the corners around a convex face, or make two triangles of them",
            )
        })
    }
}

impl Precompute for QuadParams {
    type Derived = ConvexFace<4>;

    fn derive(&self) -> ConvexFace<4> {
        let (normal, above) = self.plane();
        let mut corners = [&self.a, &self.b, &self.c, &self.d].map(Point::in_frame);
        for (corner, side) in corners.iter_mut().zip([-1.0, 1.0, -1.0, 1.0]) {
            *corner = normal.mul_add(side * above, *corner);
        }
        ConvexFace::new(corners, normal)
    }
}

impl Primitive for Quad {
    const EXAMPLE: &str = r#"{
        "a": [-1, -0.6, 0.4], "b": [0.8, -0.6, 0.4], "c": [0.6, 0.6, -0.4], "d": [-0.6, 0.6, -0.4], "radius": 0.1
    }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.derive().distance(p) - p.x.uniform(self.radius.get())
    }

    fn validate(&self) -> Option<NodeError> {
        self.non_planar_error().or_else(|| self.non_convex_error())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.derive().bounds().expanded(self.radius.in_frame() + isolevel)
    }
}

/// A flat convex face, its corners in order around the normal.
#[derive(Clone, Debug)]
pub struct ConvexFace<const N: usize> {
    /// Normal of length 1; 0 if the corners are on a line.
    normal: Vec3<f32>,
    sides: [FaceEdge; N],
}

/// A side of a face.
#[derive(Clone, Copy, Debug)]
struct FaceEdge {
    start: Vec3<f32>,
    /// From its end back to its start.
    back: Vec3<f32>,
    /// The vector to its end over the square of its length.
    over_square: Vec3<f32>,
    /// Direction of length 1, in the face's plane, toward the inside of the face.
    inwards: Vec3<f32>,
}

impl<const N: usize> ConvexFace<N> {
    fn new(corners: [Vec3<f32>; N], normal: Vec3<f32>) -> Self {
        let side = |index: usize| {
            let start = corners[index];
            let way = corners[(index + 1) % N] - start;
            let over_square = way * (1.0 / way.length_squared().max(1e-20));
            FaceEdge { start, back: -way, over_square, inwards: normal.cross(direction(way)) }
        };
        Self { normal, sides: std::array::from_fn(side) }
    }

    /// Distance to the face: to its plane if the point projects into the face, else to its nearest side.
    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let height = (p - Vec3::uniform(p.x, self.sides[0].start)).dot_uniform(self.normal);
        // Depth inside the nearest side, seen along the normal.
        let mut inside = p.x.constant(f32::MAX);
        let mut to_side = p.x.constant(f32::MAX);
        for side in &self.sides {
            let from_start = p - Vec3::uniform(p.x, side.start);
            inside = inside.min(from_start.dot_uniform(side.inwards));
            let share = from_start.dot_uniform(side.over_square).at_least(0.0).at_most(1.0);
            let nearest = Vec3::uniform(p.x, side.back).mul_add(share, from_start);
            to_side = to_side.min(nearest.length_squared());
        }
        R::select(inside.above(0.0), height.square(), to_side).sqrt()
    }

    fn bounds(&self) -> Bounds {
        let boxes = self.sides.map(|side| Bounds { min: side.start, max: side.start });
        boxes.into_iter().fold(boxes[0], Bounds::union)
    }
}

/// Vector of length 1 in a direction; 0 for the zero vector.
fn direction(vector: Vec3<f32>) -> Vec3<f32> {
    // Scaled first, so that no square underflows.
    let largest = vector.map(f32::abs).max_element();
    let scaled = vector * (1.0 / largest.max(f32::MIN_POSITIVE));
    if largest > 0.0 { scaled.normalize() } else { vector }
}
