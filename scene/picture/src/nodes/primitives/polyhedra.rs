//! Regular polyhedra around the origin, all exact.
//!
//! The mirrors of a polyhedron cut space into equal wedges with their tips at its center. Each wedge contains a
//! corner, the center of an edge and the center of a face, and the surface nearest to a point of a wedge is in that
//! wedge too (H. S. M. Coxeter, "Regular Polytopes", chapter V). So points are folded into one wedge by reflections,
//! as in Mikael Christensen, "Folding space",
//! <http://blog.hvidtfeldts.net/index.php/2011/08/distance-estimated-3d-fractals-iii-folding-space/>, and the distance
//! is that to one face along one of its edges. The order of the mirrors is that of a reduced word of the group's
//! longest element, which takes every wedge to the first.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::Primitive;
use crate::bounds::Bounds;
use crate::real::{FunctionKey, Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Length;

/// A polyhedron of four triangles, with one of them at the bottom and a corner on the +y axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Tetrahedron {
    /// Distance of its corners from the origin.
    pub radius: Length,
}

/// A polyhedron of eight triangles, its corners on the axes.
///
/// As Inigo Quilez's, "Distance functions": <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Octahedron {
    /// Distance of its corners from the origin.
    pub radius: Length,
}

/// A polyhedron of twelve pentagons; the axes pass through the centers of edges.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Dodecahedron {
    /// Distance of its corners from the origin.
    pub radius: Length,
}

/// A polyhedron of twenty triangles; the axes pass through the centers of edges.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Icosahedron {
    /// Distance of its corners from the origin.
    pub radius: Length,
}

/// The golden ratio φ = (1 + √5)/2.
const GOLDEN_RATIO: f32 = 1.618_034;
/// √½.
const ROOT_OF_HALF: f32 = 0.707_106_77;
/// √⅓.
const ROOT_OF_THIRD: f32 = 0.577_350_26;

impl Primitive for Tetrahedron {
    const EXAMPLE: &str = r#"{ "radius": 1.1 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        // The base, relative to its center: its edges are √2/3 of the radius away, and half an edge is √(2/3) of the
        // radius.
        const TO_EDGE: f32 = 0.471_404_52;
        const HALF_EDGE: f32 = 0.816_496_6;
        let p = fold_tetrahedron(p);
        let radius = self.radius.get();
        let before = -p.y - p.x.uniform(radius / 3.0);
        let past_edge = p.z - p.x.uniform(radius * TO_EDGE);
        distance_to_edge(before, past_edge, p.x - p.x.uniform(radius * HALF_EDGE))
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        // The base's corners are 2√2/3 of the radius from the axis.
        let (radius, across) = (self.radius.in_frame(), self.radius.in_frame() * 0.942_809_1);
        Bounds { min: vec3(-across, -radius / 3.0, -across), max: vec3(across, radius, across) }.expanded(isolevel)
    }
}

impl Primitive for Octahedron {
    const EXAMPLE: &str = r#"{ "radius": 1.1 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let (x, y, z) = (p.x.abs(), p.y.abs(), p.z.abs());
        let least = x.min(y).min(z);
        let most = x.max(y).max(z);
        let middle = x.min(y).max(x.max(y).min(z));
        let radius = p.x.uniform(self.radius.get());
        // The nearest edge joins the corners of the two greater coordinates.
        let over = middle + (most - radius);
        let past_edge = (over - least * 2.0) * (ROOT_OF_HALF * ROOT_OF_THIRD);
        let past_end = ((most - middle) - radius) * ROOT_OF_HALF;
        distance_to_edge((over + least) * ROOT_OF_THIRD, past_edge, past_end)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let radius = self.radius.in_frame();
        Bounds::symmetric(radius, radius, radius).expanded(isolevel)
    }
}

impl Primitive for Dodecahedron {
    const EXAMPLE: &str = r#"{ "radius": 1.1 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        // A corner is along (1, 0, φ²), a face's center along (0, 1, φ).
        const TO_EDGE: f32 = 0.934_172_4;
        const HALF_EDGE: f32 = 0.356_822_1;
        const NORMAL: (f32, f32) = (0.525_731_1, 0.850_650_8);
        let p = fold_icosahedron(p);
        let radius = self.radius.get();
        let from_edge = p.z - p.x.uniform(radius * TO_EDGE);
        distance_to_face(NORMAL, p.y, from_edge, p.x - p.x.uniform(radius * HALF_EDGE))
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        // The centers of edges on the axes have the greatest coordinate of all corners.
        let reach = self.radius.in_frame() * 0.934_172_4;
        Bounds::symmetric(reach, reach, reach).expanded(isolevel)
    }
}

impl Primitive for Icosahedron {
    const EXAMPLE: &str = r#"{ "radius": 1.1 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        // A corner is along (0, 1, φ), a face's center along (1, 0, φ²).
        const TO_EDGE: f32 = 0.850_650_8;
        const HALF_EDGE: f32 = 0.525_731_1;
        const NORMAL: (f32, f32) = (0.356_822_1, 0.934_172_4);
        let p = fold_icosahedron(p);
        let radius = self.radius.get();
        let from_edge = p.z - p.x.uniform(radius * TO_EDGE);
        distance_to_face(NORMAL, p.x, from_edge, p.y - p.x.uniform(radius * HALF_EDGE))
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        // The centers of edges on the axes have the greatest coordinate of all corners.
        let reach = self.radius.in_frame() * 0.850_650_8;
        Bounds::symmetric(reach, reach, reach).expanded(isolevel)
    }
}

/// Distance to a face, given the point's offset from the center of the face's edge: `across` and `up`, in which
/// `normal` is the face's normal; `past_end` is its distance beyond the edge's end.
fn distance_to_face<R: Real>(normal: (f32, f32), across: R, up: R, past_end: R) -> R {
    let (normal_across, normal_up) = (up.constant(normal.0), up.constant(normal.1));
    let before = across.mul_add(normal_across, up * normal_up);
    let past_edge = up.mul_add(normal_across, -(across * normal_up));
    distance_to_edge(before, past_edge, past_end)
}

/// Distance to a face: `before` its plane if the point projects into it, else to its edge or corner.
fn distance_to_edge<R: Real>(before: R, past_edge: R, past_end: R) -> R {
    let to_edge = before.square_add(past_edge.square_add(past_end.at_least(0.0).square())).sqrt();
    R::select(past_edge.above(0.0), to_edge, before)
}

/// Reflects points behind a plane through the origin to its front.
fn mirror<R: Real>(p: (R, R), normal: (f32, f32)) -> (R, R) {
    let (a, b) = p;
    let behind = a.mul_add(a.constant(normal.0), b * normal.1).at_most(0.0);
    (behind.mul_add(a.constant(-2.0 * normal.0), a), behind.mul_add(a.constant(-2.0 * normal.1), b))
}

/// Folds space into the wedge of the bottom face, with its edge across +z, and the end of that edge at +x.
fn fold_tetrahedron<R: Real>(p: Vec3<R>) -> Vec3<R> {
    // Mirrors: x = 0, one through the y axis and the end of the edge, one through the full edge.
    const THROUGH_END: (f32, f32) = (-0.5, 0.866_025_4);
    const THROUGH_EDGE: (f32, f32) = (-0.816_496_6, -ROOT_OF_THIRD);
    let (x, z) = mirror((p.x.abs(), p.z), THROUGH_END);
    let x = x.abs();
    let (y, z) = mirror((p.y, z), THROUGH_EDGE);
    let (x, z) = mirror((x, z), THROUGH_END);
    vec3(x.abs(), y, z)
}

/// Folds space into the wedge between (0, 0, 1), (0, 1, φ) and (1, 0, φ²).
fn fold_icosahedron<R: Real>(p: Vec3<R>) -> Vec3<R> {
    p.x.call(FunctionKey::new("fold_icosahedron"), p, |p: Vec3<R>| {
        // Mirrors: x = 0, y = 0, and the plane through the wedge's corners off the z axis. z = 0 is a mirror of
        // the group too: with it, three rounds suffice instead of five.
        let p = mirror_icosahedron(vec3(p.x.abs(), p.y.abs(), p.z.abs()));
        let p = mirror_icosahedron(vec3(p.x.abs(), p.y.abs(), p.z));
        mirror_icosahedron(vec3(p.x.abs(), p.y.abs(), p.z))
    })
}

fn mirror_icosahedron<R: Real>(p: Vec3<R>) -> Vec3<R> {
    const NORMAL: Vec3<f32> = vec3(-0.5 * GOLDEN_RATIO, -0.5, 0.5 / GOLDEN_RATIO);
    let like = p.x;
    let twice = like
        .mul_add(like.constant(-2.0 * NORMAL.x), p.y.mul_add(like.constant(-2.0 * NORMAL.y), p.z * (-2.0 * NORMAL.z)));
    let behind = twice.at_least(0.0);
    vec3(
        behind.mul_add(like.constant(NORMAL.x), p.x),
        behind.mul_add(like.constant(NORMAL.y), p.y),
        behind.mul_add(like.constant(NORMAL.z), p.z),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotated(step: u16) -> Vec3<f32> {
        let turn = |speed: f32| Real::sin(speed * f32::from(step));
        vec3(turn(1.3), turn(2.1), turn(0.7))
    }

    #[test]
    fn every_point_is_folded_into_the_wedge() {
        for step in 0..20_000 {
            let p = rotated(step);
            let folded = fold_icosahedron(p);
            assert!((folded.length() - p.length()).abs() < 2e-6, "{p:?} to {folded:?}");
            let beside = folded.z - GOLDEN_RATIO * (GOLDEN_RATIO * folded.x + folded.y);
            assert!(folded.x.min(folded.y).min(beside) > -4e-6, "{p:?} to {folded:?}");
            let folded = fold_tetrahedron(p);
            assert!((folded.length() - p.length()).abs() < 2e-6, "{p:?} to {folded:?}");
            let (end, edge) = (folded.z * 3.0_f32.sqrt() - folded.x, -folded.y * 2.0_f32.sqrt() - folded.z);
            assert!(folded.x.min(end).min(edge) > -4e-6, "{p:?} to {folded:?}");
        }
    }

    #[test]
    fn corners_and_face_centers_match_coxeter() {
        let radius = || Length::new(1.0).expect("a length");
        let (icosahedron, dodecahedron) = (Icosahedron { radius: radius() }, Dodecahedron { radius: radius() });
        let tetrahedron = Tetrahedron { radius: radius() };
        for (x, y, z) in [(0.0, 1.0, GOLDEN_RATIO), (1.0, -GOLDEN_RATIO, 0.0), (-GOLDEN_RATIO, 0.0, 1.0)] {
            let axis = vec3(x, y, z).normalize();
            assert!((icosahedron.distance(axis + axis) - 1.0).abs() < 1e-6);
            // The inscribed ball of a dodecahedron has √((5 + 2√5)/15) of the radius.
            assert!((dodecahedron.distance(axis) - (1.0 - 0.794_654_5)).abs() < 1e-6);
        }
        let corner = vec3(ROOT_OF_THIRD, -ROOT_OF_THIRD, ROOT_OF_THIRD);
        assert!((dodecahedron.distance(corner + corner) - 1.0).abs() < 1e-6);
        assert!((icosahedron.distance(vec3(0.0, 0.0, 0.0)) + 0.794_654_5).abs() < 1e-6);
        assert!((tetrahedron.distance(vec3(0.0, 0.0, 0.0)) + 1.0 / 3.0).abs() < 1e-6);
        assert!((tetrahedron.distance(vec3(0.0, 3.0, 0.0)) - 2.0).abs() < 1e-6);
    }
}
