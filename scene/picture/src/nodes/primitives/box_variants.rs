//! Variants of a box: its twelve edges, and a box over a rhombus.
//!
//! The shapes are Inigo Quilez's, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::{NodeError, Primitive};
use super::default_round;
use crate::bounds::Bounds;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Length, LengthOrZero};

/// The twelve edges of a box, as beams of square section.
///
/// Quilez's three beams, each exact outside; inside, where beams intersect, the distance to the complement of
/// the beams is added here.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct BoxFrame {
    /// Full extents along x, y and z.
    pub size: [Length; 3],
    /// Width of its beams, inside `size`; less than half of the least extent.
    pub thickness: Length,
}

impl Primitive for BoxFrame {
    const EXAMPLE: &str = r#"{ "size": [1.6, 1.2, 1.3], "thickness": 0.16 }"#;
    const MORE_EXAMPLES: &[&str] = &[r#"{ "size": [1.2, 1.8, 1], "thickness": 0.4 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let half = vec3(self.size[0].in_frame(), self.size[1].in_frame(), self.size[2].in_frame()).map(|c| c * 0.5);
        let thickness = p.x.uniform(self.thickness.get());
        // Depth below the box's faces: by symmetry, from the corner where all coordinates are positive. A point is in
        // a beam if two of the three are at most its thickness, and none is below 0.
        let depth = Vec3::uniform(p.x, half) - vec3(p.x.abs(), p.y.abs(), p.z.abs());
        let past_face = depth.map(|c| (-c).at_least(0.0));
        let past_beam = depth.map(|c| (c - thickness).at_least(0.0));
        // Squares of each coordinate's distance from a beam's length and from its section.
        let (length, section) = (squares(past_face), squares(past_face + past_beam));
        let to_x = length.x + (section.y + section.z);
        let to_y = length.y + (section.z + section.x);
        let to_z = length.z + (section.x + section.y);
        let outside = to_x.min(to_y).min(to_z);
        // Points of the box outside the beams are deeper than the thickness in two coordinates.
        let left = squares(depth.map(|c| (thickness - c).at_least(0.0)));
        let to_opening = (left.x + left.y).min(left.y + left.z).min(left.z + left.x);
        let is_outside = outside.above(0.0);
        let root = R::select(is_outside, outside, to_opening).sqrt();
        let to_face = depth.x.min(depth.y).min(depth.z).at_least(0.0);
        R::select(is_outside, root, -root.min(to_face))
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let [x, y, z] = &self.size;
        Bounds::symmetric(x.in_frame() / 2.0, y.in_frame() / 2.0, z.in_frame() / 2.0).expanded(isolevel)
    }

    fn validate(&self) -> Option<NodeError> {
        let least = self.size.iter().fold(f32::INFINITY, |least, extent| least.min(extent.in_frame()));
        (self.thickness.in_frame() * 2.0 >= least).then(|| {
            let half = least / 2.0;
            NodeError::new(
                "thickness",
                format!("must be less than half of each size, or nothing is open: make thickness less than {half}"),
            )
        })
    }
}

/// A box whose plan, seen along y, is a rhombus with its corners on the x and z axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Rhombus {
    /// Full diagonals of the rhombus, along x and z.
    pub diagonals: [Length; 2],
    /// Full height along y.
    pub height: Length,
    /// Radius of its rounded edges, inside the diagonals and the height; less than half of each.
    #[serde(default = "default_round")]
    pub round: LengthOrZero,
}

impl Primitive for Rhombus {
    const EXAMPLE: &str = r#"{ "diagonals": [2, 1.2], "height": 0.7, "round": 0.06 }"#;
    const MORE_EXAMPLES: &[&str] = &[r#"{ "diagonals": [0.9, 1.9], "height": 0.5 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let round = self.round.in_frame();
        let (x, z) = (self.diagonals[0].in_frame() * 0.5 - round, self.diagonals[1].in_frame() * 0.5 - round);
        let edge = Real::sqrt(x * x + z * z).max(1e-14);
        let (along_x, along_z) = (p.x.uniform(x / edge), p.x.uniform(z / edge));
        // By symmetry, the edge from the corner on +x to the corner on +z.
        let from_corner = p.x.abs() - p.x.uniform(x);
        let side = p.z.abs();
        let past_side = from_corner.mul_add(along_z, side * along_x);
        let along = side.mul_add(along_z, -(from_corner * along_x));
        let past_corner = along - along.at_least(0.0).min(p.x.uniform(edge));
        let past_cap = p.y.abs() - p.x.uniform(self.height.get() * 0.5 - round);
        let outside =
            past_side.at_least(0.0).square_add(past_cap.at_least(0.0).square_add(past_corner.square())).sqrt();
        outside + past_side.max(past_cap).at_most(0.0) - p.x.uniform(round)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let [x, z] = &self.diagonals;
        Bounds::symmetric(x.in_frame() / 2.0, self.height.in_frame() / 2.0, z.in_frame() / 2.0).expanded(isolevel)
    }

    fn validate(&self) -> Option<NodeError> {
        let [x, z] = &self.diagonals;
        let half = x.in_frame().min(z.in_frame()).min(self.height.in_frame()) / 2.0;
        (self.round.in_frame() >= half).then(|| {
            NodeError::new(
                "round",
                format!("must be less than half of the diagonals and of the height: make round less than {half}"),
            )
        })
    }
}

fn squares<R: Real>(v: Vec3<R>) -> Vec3<R> {
    vec3(v.x.square(), v.y.square(), v.z.square())
}
