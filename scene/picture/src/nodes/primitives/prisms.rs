//! Prisms and pyramids over a regular polygon, around the y axis.
//!
//! Mirrors through the axis fold space into the wedge between the center of one edge and a corner next to it. The
//! surface nearest to a point of the wedge is in the wedge too, so the distance to that one face is the distance. The
//! folding is that of Inigo Quilez's prisms, "Distance functions", <https://iquilezles.org/articles/distfunctions/>,
//! for any number of sides.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::Primitive;
use super::polygon_sides::PolygonSides;
use super::pyramid_face::PyramidFace;
use crate::bounds::Bounds;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Length;

/// A prism of six sides along y, centered at the origin, two of its sides across the z axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct HexagonalPrism {
    /// Distance of its corners from the axis.
    pub radius: Length,
    /// Full height.
    pub height: Length,
}

/// A prism of eight sides along y, centered at the origin, four of its sides across the x and z axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct OctagonalPrism {
    /// Distance of its corners from the axis.
    pub radius: Length,
    /// Full height.
    pub height: Length,
}

/// A pyramid over a regular polygon on y = 0, one edge of it across the +z axis, its apex at y = height.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct RegularPyramid {
    /// Number of sides of its base, 3 to 64.
    pub sides: PolygonSides,
    /// Distance of the base's corners from the axis.
    pub radius: Length,
    /// Height of its apex.
    pub height: Length,
}

impl Primitive for HexagonalPrism {
    const EXAMPLE: &str = r#"{ "radius": 0.8, "height": 1.4 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        prism(p, &PolygonSides::HEXAGON, &self.radius, &self.height)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        Bounds::symmetric(self.radius.in_frame(), self.height.in_frame() / 2.0, self.radius.in_frame())
            .expanded(isolevel)
    }
}

impl Primitive for OctagonalPrism {
    const EXAMPLE: &str = r#"{ "radius": 0.9, "height": 1 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        prism(p, &PolygonSides::OCTAGON, &self.radius, &self.height)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        Bounds::symmetric(self.radius.in_frame(), self.height.in_frame() / 2.0, self.radius.in_frame())
            .expanded(isolevel)
    }
}

impl Primitive for RegularPyramid {
    const EXAMPLE: &str = r#"{ "sides": 5, "radius": 0.9, "height": 1.1 }"#;
    const MORE_EXAMPLES: &[&str] =
        &[r#"{ "sides": 3, "radius": 1, "height": 0.6 }"#, r#"{ "sides": 12, "radius": 0.6, "height": 1.2 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let (along, out) = self.sides.fold(p.x, p.z);
        let (inradius, half_edge) = self.sides.inradius_and_half_edge(self.radius.in_frame());
        let slope = PyramidFace::new(inradius, half_edge, self.height.in_frame());
        let past_edge = (along - p.x.uniform(half_edge)).at_least(0.0);
        let to_base = (out - p.x.uniform(inradius)).at_least(0.0).square_add(past_edge.square_add(p.y.square()));
        let (to_slope, past_slope) = slope.distance_and_depth(out, along, p.y);
        let distance = to_slope.min(to_base).sqrt();
        R::select(past_slope.max(-p.y).below(0.0), -distance, distance)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (radius, height) = (self.radius.in_frame(), self.height.in_frame());
        Bounds { min: vec3(-radius, 0.0, -radius), max: vec3(radius, height, radius) }.expanded(isolevel)
    }
}

/// Distance to a prism over a regular polygon.
fn prism<R: Real>(p: Vec3<R>, sides: &PolygonSides, radius: &Length, height: &Length) -> R {
    let (along, out) = sides.fold(p.x, p.z);
    let (inradius, half_edge) = sides.inradius_and_half_edge(radius.in_frame());
    let past_edge = (along - p.x.uniform(half_edge)).at_least(0.0);
    let past_side = out - p.x.uniform(inradius);
    let past_cap = p.y.abs() - p.x.uniform(height.get() * 0.5);
    let outside = past_side.at_least(0.0).square_add(past_cap.at_least(0.0).square_add(past_edge.square())).sqrt();
    outside + past_side.max(past_cap).at_most(0.0)
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use super::*;

    #[test]
    fn a_corner_and_an_edge_center_are_on_the_pyramid() {
        for sides in (3..=64).filter_map(PolygonSides::new) {
            let radius = Length::new(0.7).expect("a length");
            let pyramid = RegularPyramid { sides, radius: radius.clone(), height: radius };
            for side in 0..sides.get() {
                let (x, z) = Real::sin_cos(PI * (2 * side + 1) as f32 / sides.get() as f32);
                let corner = pyramid.distance(vec3(x * 0.7, 0.0, z * 0.7));
                assert!(corner.abs() < 1e-6, "{sides:?}: a corner is {corner} away");
                let past_corner = pyramid.distance(vec3(x, 0.0, z));
                assert!((past_corner - 0.3).abs() < 1e-6, "{sides:?}: {past_corner}");
            }
        }
    }
}
