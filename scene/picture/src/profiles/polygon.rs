//! A polygon of any points.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};

use super::edge::Edge;
use super::{Bounds2, Point2, ProfileSdf};
use crate::kinds::NodeError;
use crate::real::Real;
use crate::seek::{FrameTime, Seek, SeekError};

/// Minimum number of points of a polygon.
const MIN_POINTS: usize = 3;
/// Maximum number of points of a polygon.
const MAX_POINTS: usize = 256;
/// A squared distance greater than any, but finite.
const MISS_DISTANCE: f32 = 1e30;

/// A polygon with these corners, in either orientation. It need not be convex.
///
/// Inigo Quilez, "2D distance functions": <https://iquilezles.org/articles/distfunctions2d/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Polygon {
    /// Its 3 to 256 corners, in order around the polygon.
    pub points: PolygonVertices,
}

/// The corners of a polygon, and the edges between them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<Point2>", into = "Vec<Point2>")]
pub struct PolygonVertices {
    spots: Vec<Point2>,
    edges: Vec<Edge>,
}

/// Error returned for an invalid number of corners.
#[derive(Debug, thiserror::Error)]
#[error("has {0} points: a polygon needs {MIN_POINTS} to {MAX_POINTS}")]
pub struct VertexCountError(usize);

impl TryFrom<Vec<Point2>> for PolygonVertices {
    type Error = VertexCountError;

    fn try_from(spots: Vec<Point2>) -> Result<Self, VertexCountError> {
        if !(MIN_POINTS..=MAX_POINTS).contains(&spots.len()) {
            return Err(VertexCountError(spots.len()));
        }
        Ok(Self { edges: edges(&spots), spots })
    }
}

fn edges(spots: &[Point2]) -> Vec<Edge> {
    let ends = spots.iter().zip(spots.iter().cycle().skip(1));
    ends.map(|(from, to)| Edge::new(from.in_frame(), to.in_frame())).collect()
}

impl Seek for PolygonVertices {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        let Self { spots, edges: between } = self;
        let is_animated = spots.seek(clock)?;
        if is_animated {
            *between = edges(spots);
        }
        Ok(is_animated)
    }
}

impl From<PolygonVertices> for Vec<Point2> {
    fn from(points: PolygonVertices) -> Self {
        points.spots
    }
}

impl JsonSchema for PolygonVertices {
    fn schema_name() -> Cow<'static, str> {
        "PolygonVertices".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let spot = generator.subschema_for::<Point2>();
        json_schema!({
            "type": "array", "items": spot, "minItems": MIN_POINTS, "maxItems": MAX_POINTS,
            "description": "The corners of a polygon, in the order of a walk around it."
        })
    }
}

impl ProfileSdf for Polygon {
    const EXAMPLE: &str = r#"{ "points": [[-0.9, -0.8], [0.9, -0.8], [0.9, -0.3], [0.3, -0.3], [0.3, 0.9], [-0.3, 0.9], [-0.3, -0.3], [-0.9, -0.3]] }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "points": [[0, 1], [1, -0.2], [0.1, 0.2], [-0.8, -0.9], [-0.5, 0.3]] }"#,
        r#"{ "points": [[0.2, -0.6], [0.9, 0.1], [0.7, 0.8]] }"#,
    ];

    fn distance<R: Real>(&self, x: R, y: R) -> R {
        let mut found = (x.constant(MISS_DISTANCE), x.constant(1.0));
        for edge in &self.points.edges {
            found = edge.scan(x, y, found);
        }
        let (nearest, sign) = found;
        sign * nearest.sqrt()
    }

    fn extent(&self, isolevel: f32) -> Bounds2 {
        Bounds2::from_points(self.points.edges.iter().map(|edge| edge.from)).widened(isolevel)
    }

    fn validate(&self) -> Option<NodeError> {
        let edges = &self.points.edges;
        let count = edges.len();
        let (number, message) = (0..count).find_map(|number| duplicate_vertex(edges, number)).or_else(|| {
            (0..count).find_map(|number| (0..number).find_map(|earlier| self_intersection(edges, earlier, number)))
        })?;
        Some(NodeError::new(format!("points/{number}"), message))
    }

    fn size_in_nodes(&self) -> u32 {
        self.points.edges.len() as u32 / 2
    }
}

/// Error for a corner at the position of an earlier one.
fn duplicate_vertex(edges: &[Edge], number: usize) -> Option<(usize, String)> {
    let earlier = (0..number).find(|&earlier| edges[earlier].from == edges[number].from)?;
    Some((number, format!("is the same point as points/{earlier}: remove or move one of them")))
}

/// Error for an edge that touches an earlier one anywhere but at a shared corner.
fn self_intersection(edges: &[Edge], earlier: usize, number: usize) -> Option<(usize, String)> {
    let (a, b) = (edges[earlier], edges[number]);
    let count = edges.len();
    if a.to == b.from || b.to == a.from {
        // Neighbors share one corner, unless the second reverses along the first.
        let (corner, before, after) = if a.to == b.from { (a.to, a.from, b.to) } else { (b.to, b.from, a.to) };
        let goes_back = orientation(before, corner, after) == 0.0 && !is_between(corner, before, after);
        let back = format!("goes back along the edge before it: remove or move points/{number}");
        return goes_back.then_some((number, back));
    }
    let next = (number + 1) % count;
    let cure = "put the points in the order of a walk around the shape";
    let message = format!(
        "begins an edge, to points/{next}, that crosses the one from points/{earlier} to points/{}: {cure}",
        earlier + 1
    );
    segments_touch(a, b).then_some((number, message))
}

/// Whether two edges have a point in common.
fn segments_touch(a: Edge, b: Edge) -> bool {
    let sides = |edge: Edge, other: Edge| {
        [orientation(edge.from, edge.to, other.from), orientation(edge.from, edge.to, other.to)]
    };
    let ([p, q], [r, s]) = (sides(a, b), sides(b, a));
    if p * q < 0.0 && r * s < 0.0 {
        return true;
    }
    (p == 0.0 && is_between(b.from, a.from, a.to))
        || (q == 0.0 && is_between(b.to, a.from, a.to))
        || (r == 0.0 && is_between(a.from, b.from, b.to))
        || (s == 0.0 && is_between(a.to, b.from, b.to))
}

/// Orientation of the triangle (a, b, c): positive if counter-clockwise, negative if clockwise, 0 if collinear.
fn orientation(a: [f32; 2], b: [f32; 2], c: [f32; 2]) -> f64 {
    let along = |axis: usize, to: [f32; 2]| f64::from(to[axis]) - f64::from(a[axis]);
    along(0, b) * along(1, c) - along(1, b) * along(0, c)
}

/// Whether `point`, which is on the line through `a` and `b`, is between them or equal to one.
fn is_between(point: [f32; 2], a: [f32; 2], b: [f32; 2]) -> bool {
    (0..2).all(|axis| (a[axis].min(b[axis])..=a[axis].max(b[axis])).contains(&point[axis]))
}
