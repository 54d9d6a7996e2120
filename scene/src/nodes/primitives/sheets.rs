//! Sheets between corners, with a thickness: all points within a radius of a flat face. All are exact.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bounds::Bounds;
use crate::nodes::{NodeFault, Primitive};
use crate::real::{Real, Vec3};
use crate::values::{Length, Point};

/// All points within a radius of a triangle.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Triangle {
    /// One corner.
    pub a: Point,
    /// The next corner.
    pub b: Point,
    /// The last corner.
    pub c: Point,
    /// Half its thickness, and the radius of its rounded edges.
    pub radius: Length,
}

impl Triangle {
    fn face(&self) -> Face<3> {
        let corners = [self.a, self.b, self.c].map(Point::get);
        let [a, b, c] = corners;
        Face { corners, normal: direction((b - a).cross(c - a)) }
    }
}

impl Primitive for Triangle {
    const EXAMPLE: &str = r#"{ "a": [-1, -0.6, 0.3], "b": [0.9, -0.7, 0.1], "c": [0.1, 0.9, -0.4], "radius": 0.1 }"#;

    const MORE: &[&str] = &[r#"{ "a": [-0.8, 0, 0], "b": [0.8, 0, 0], "c": [0.4, 0, 0], "radius": 0.3 }"#];

    #[inline(always)]
    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.face().distance(p) - p.x.given(self.radius.get())
    }

    fn bounds(&self, level: f32) -> Bounds {
        self.face().bounds().widened(self.radius.get() + level)
    }
}

/// All points within a radius of a flat face of four corners, given in the order in which one walks around it.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Quad {
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

/// How far a corner may lie off the plane of the four, as a part of the larger diagonal: no more than
/// what rounding coordinates to a few digits does. It is then put on that plane.
const FLATNESS: f32 = 1e-3;

impl Quad {
    /// The normal of the plane through the middles of its sides, and how far above it the corners
    /// a and c lie; b and d lie as far below.
    fn plane(&self) -> (Vec3<f32>, f32) {
        let [a, b, c, d] = [self.a, self.b, self.c, self.d].map(Point::get);
        let normal = direction((c - a).cross(d - b));
        (normal, ((a - b) + (c - d)).dot(normal) * 0.25)
    }

    fn face(&self) -> Face<4> {
        let (normal, above) = self.plane();
        let mut corners = [self.a, self.b, self.c, self.d].map(Point::get);
        for (corner, side) in corners.iter_mut().zip([-1.0, 1.0, -1.0, 1.0]) {
            *corner = normal.mul_add(side * above, *corner);
        }
        Face { corners, normal }
    }
}

impl Primitive for Quad {
    const EXAMPLE: &str = r#"{
        "a": [-1, -0.6, 0.4], "b": [0.8, -0.6, 0.4], "c": [0.6, 0.6, -0.4], "d": [-0.6, 0.6, -0.4], "radius": 0.1
    }"#;

    #[inline(always)]
    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.face().distance(p) - p.x.given(self.radius.get())
    }

    fn fault(&self) -> Option<NodeFault> {
        let (normal, above) = self.plane();
        let [a, b, c, d] = [self.a, self.b, self.c, self.d].map(Point::get);
        let size = (c - a).length().max((d - b).length());
        if above.abs() > FLATNESS * size {
            // Moving one corner along the normal moves the middle plane, too.
            let moved = normal.mul_add(4.0 * above, d);
            return Some(NodeFault::new(
                "d",
                format!(
                    "is not in one plane with a, b and c: put it at [{}, {}, {}], or make two triangles of the four",
                    moved.x, moved.y, moved.z
                ),
            ));
        }
        let corners = [a, b, c, d];
        let turns_back = (0..4).find(|&index| {
            let [before, here, after] = [index, index + 1, index + 2].map(|place| corners[place % 4]);
            (here - before).cross(after - here).dot(normal) < -FLATNESS * size * size
        });
        turns_back.map(|index| {
            let place = ["b", "c", "d", "a"][index];
            NodeFault::new(
                place,
                "makes the outline turn back: order the corners around a convex face, or make two triangles of them",
            )
        })
    }

    fn bounds(&self, level: f32) -> Bounds {
        self.face().bounds().widened(self.radius.get() + level)
    }
}

/// A flat convex face, its corners in order around the normal.
struct Face<const N: usize> {
    corners: [Vec3<f32>; N],
    /// Of length 1; 0 if the corners are in a line.
    normal: Vec3<f32>,
}

impl<const N: usize> Face<N> {
    /// The distance to the face: to its plane where it is straight above or below, else to its nearest edge.
    #[inline(always)]
    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let height = (p - Vec3::given(p.x, self.corners[0])).dot_known(self.normal);
        // How far inside of the nearest side of the outline, seen along the normal.
        let mut inside = p.x.splat(f32::MAX);
        let mut to_edge = p.x.splat(f32::MAX);
        for index in 0..N {
            let corner = self.corners[index];
            let edge = self.corners[(index + 1) % N] - corner;
            let from_corner = p - Vec3::given(p.x, corner);
            inside = inside.min(from_corner.dot_known(self.normal.cross(direction(edge))));
            let share =
                from_corner.dot_known(edge * (1.0 / edge.length_squared().max(1e-20))).at_least(0.0).at_most(1.0);
            let nearest = Vec3::given(p.x, -edge).mul_add(share, from_corner);
            to_edge = to_edge.min(nearest.length_squared());
        }
        R::select(inside.above(0.0), height.square(), to_edge).sqrt()
    }

    fn bounds(&self) -> Bounds {
        let boxes = self.corners.map(|corner| Bounds { low: corner, high: corner });
        boxes.into_iter().fold(boxes[0], Bounds::hull)
    }
}

/// The vector of length 1 in a direction; 0 for none.
fn direction(vector: Vec3<f32>) -> Vec3<f32> {
    // Scaled first, so that no square vanishes.
    let largest = vector.map(f32::abs).max_element();
    let scaled = vector * (1.0 / largest.max(f32::MIN_POSITIVE));
    if largest > 0.0 { scaled.normalize() } else { vector }
}
