//! Rotations of a shape: by angles, and toward a point. An exact distance remains exact.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::carried::carries_child;
use super::cut::Cut;
use super::modifiers::cached::Cached;
use super::transforms::around_child;
use super::{Child, Node, NodeError, Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::real::{Real, Vec3, vec3};
use crate::seek::{Seek, SeekError};
use crate::values::{Angles, Direction, Placement, Point, Rotation, inverse_rows_about, unit_of};

/// Smallest sine of the angle between two directions that are not parallel.
const MIN_SINE: f32 = 1e-4;

/// A shape rotated about the fixed x, then y, then z axis, or about one axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Rotate {
    /// Angles about x, y and z, in degrees; or one angle about `axis`, counter-clockwise seen from its tip.
    pub degrees: Angles,
    /// Axis of the rotation, if there is one angle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<Direction>,
    /// Point that stays in place, in scene units; the origin when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub about: Option<Point>,
    /// The shape.
    pub child: Child,
    /// Rows of the inverse rotation's matrix.
    #[serde(skip)]
    #[schemars(skip)]
    rows: Cached<[Vec3<f32>; 3]>,
}

/// A shape whose +z axis points to a point, with its +y axis as close to `up` as possible.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
#[seek(then = follow)]
pub struct Aim {
    /// Point that the shape's +z axis points to, in scene units; not the origin.
    pub at: Point,
    /// Direction that is up for the shape; not parallel to the direction of `at`.
    #[serde(default = "default_up")]
    pub up: Direction,
    /// The shape.
    pub child: Child,
    /// Rows of the inverse rotation's matrix.
    #[serde(skip)]
    #[schemars(skip)]
    rows: Cached<[Vec3<f32>; 3]>,
}

fn default_up() -> Direction {
    Direction::up()
}

impl Rotate {
    fn inverse_rows(&self) -> [Vec3<f32>; 3] {
        match (&self.degrees, &self.axis) {
            (Angles::Fixed(rotation), _) => rotation.inverse_rows(),
            (Angles::About(degrees), axis) => {
                let axis = axis.as_ref().map_or(vec3(0.0, 1.0, 0.0), Direction::unit);
                *self.rows.get(|| inverse_rows_about(axis, degrees.in_frame()))
            }
        }
    }
}

/// Error in the combination of angles and an axis, if there is one.
pub fn rotation_error(degrees: &Angles, axis: Option<&Direction>) -> Option<NodeError> {
    match (degrees, axis) {
        (Angles::Fixed(_), Some(_)) => {
            Some(NodeError::new("axis", "is for one angle: write degrees as one number, or leave axis out"))
        }
        (Angles::About(_), None) => {
            Some(NodeError::new("degrees", "is one angle: give it an axis, or write [x, y, z]"))
        }
        (Angles::Fixed(_), None) | (Angles::About(_), Some(_)) => None,
    }
}

impl Node {
    /// A shape rotated by angles.
    pub(crate) fn rotated(degrees: Angles, axis: Option<Direction>, about: Option<Point>, child: Self) -> Self {
        Self::Rotate(Box::new(Rotate { degrees, axis, about, child: Box::new(child), rows: Cached::default() }))
    }

    /// The shape inside the nodes that place it, and the names of these nodes, the innermost first.
    pub fn placed(self, placement: &Placement) -> (Self, Vec<&'static str>) {
        let Placement { by, degrees, axis, about } = placement;
        let mut shape = self;
        let mut names = Vec::new();
        if let Some(degrees) = degrees {
            shape = Self::rotated(degrees.clone(), axis.clone(), about.clone(), shape);
            names.push(shape.name());
        }
        if let Some(by) = by {
            shape = Self::translated(by.clone(), shape);
            names.push(shape.name());
        }
        (shape, names)
    }
}

/// Product of a matrix of these rows and a vector.
pub(super) fn rotated<R: Real>(p: Vec3<R>, [x, y, z]: [Vec3<f32>; 3]) -> Vec3<R> {
    vec3(p.dot_uniform(x), p.dot_uniform(y), p.dot_uniform(z))
}

fn rotated_about<R: Real>(p: Vec3<R>, rows: [Vec3<f32>; 3], about: &Point) -> Vec3<R> {
    let about = Vec3::uniform(p.x, about.get());
    rotated(p - about, rows) + about
}

/// The rows of the inverse of a rotation.
pub(super) fn transposed([x, y, z]: [Vec3<f32>; 3]) -> [Vec3<f32>; 3] {
    [vec3(x.x, y.x, z.x), vec3(x.y, y.y, z.y), vec3(x.z, y.z, z.z)]
}

impl Node {
    /// The angles by which it rotates its child about the axes, if it does nothing else.
    pub fn rotation(&self) -> Option<&Rotation> {
        let Self::Rotate(rotate) = self else { return None };
        match &rotate.degrees {
            Angles::Fixed(rotation) => Some(rotation),
            Angles::About(_) => None,
        }
    }
}

impl Sdf for Rotate {
    const ALIASES: &'static [&'static str] = &["orient", "rotation", "turn"];
    const EXAMPLE: &str = r#"{ "degrees": [30, 40, 0], "child": { "box": { "size": [1.2, 0.8, 1.6] } } }"#;

    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "degrees": 50, "axis": [1, 1, 0], "about": [0.6, 0, 0.8], "child": { "box": { "size": [1.2, 0.8, 1.6] } } }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        sample(0, self.to_child(p))
    }

    around_child!();

    fn cut(&self) -> Cut<'_> {
        Cut::Child(&self.child)
    }

    fn to_child<R: Real>(&self, p: Vec3<R>) -> Vec3<R> {
        let rows = self.inverse_rows();
        match &self.about {
            None => rotated(p, rows),
            Some(about) => rotated_about(p, rows, about),
        }
    }

    carries_child!(|self| self.is_placement_animated());

    fn bounds_from_child(&self, child: Bounds) -> Bounds {
        let rows = self.inverse_rows();
        match &self.about {
            None => child.rotated(rows),
            Some(about) => child.translated(-about.in_frame()).rotated(rows).translated(about.in_frame()),
        }
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.bounds_from_child(self.child.bounds(isolevel))
    }

    fn validate(&self) -> Option<NodeError> {
        rotation_error(&self.degrees, self.axis.as_ref())
    }

    fn is_placement_animated(&self) -> bool {
        self.degrees.is_animated()
            || self.axis.as_ref().is_some_and(Direction::is_animated)
            || self.about.as_ref().is_some_and(Point::is_animated)
    }
}

impl Rotate {
    fn outward<R: Real>(&self, q: Vec3<R>) -> Vec3<R> {
        let rows = transposed(self.inverse_rows());
        match &self.about {
            None => rotated(q, rows),
            Some(about) => rotated_about(q, rows, about),
        }
    }
}

impl Aim {
    fn outward<R: Real>(&self, q: Vec3<R>) -> Vec3<R> {
        rotated(q, transposed(self.inverse_rows()))
    }

    /// The directions of the shape's axes; the name of the key that is wrong, and its error, if there are none.
    fn axes(&self) -> Result<[Vec3<f32>; 3], (&'static str, &'static str)> {
        let Some(z) = unit_of(&self.at) else {
            return Err((
                "at",
                "is where the shape is: write a point other than the origin of the shape's coordinates",
            ));
        };
        let x = self.up.unit().cross(z);
        if x.length() < MIN_SINE {
            return Err((
                "up",
                "\"up\" is parallel to the direction of \"at\", also if it is left out: write another \"up\", such as [1, 0, 0]",
            ));
        }
        let x = x.normalize();
        Ok([x, z.cross(x), z])
    }

    fn inverse_rows(&self) -> [Vec3<f32>; 3] {
        let upright = [vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), vec3(0.0, 0.0, 1.0)];
        *self.rows.get(|| self.axes().unwrap_or(upright))
    }

    fn follow(&self) -> Result<(), Box<SeekError>> {
        self.axes().map(drop).map_err(|(key, message)| SeekError::new(message).inside(key))
    }
}

impl Sdf for Aim {
    const EXAMPLE: &str = r#"{ "at": [1, 0.6, 0.8], "child": {
        "rotate": { "degrees": 90, "axis": [1, 0, 0], "child": { "cone": { "radius": 0.4, "height": 1.6 } } }
    } }"#;

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        sample(0, self.to_child(p))
    }

    around_child!();

    fn cut(&self) -> Cut<'_> {
        Cut::Child(&self.child)
    }

    fn to_child<R: Real>(&self, p: Vec3<R>) -> Vec3<R> {
        rotated(p, self.inverse_rows())
    }

    carries_child!(|self| self.is_placement_animated());

    fn bounds_from_child(&self, child: Bounds) -> Bounds {
        child.rotated(self.inverse_rows())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.bounds_from_child(self.child.bounds(isolevel))
    }

    fn validate(&self) -> Option<NodeError> {
        self.axes().err().map(|(key, message)| NodeError::new(key, message))
    }

    fn is_placement_animated(&self) -> bool {
        self.at.is_animated() || self.up.is_animated()
    }
}
