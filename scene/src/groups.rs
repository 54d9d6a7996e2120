//! Groups: objects, lights and the camera that move together.
//!
//! A scene to be rendered has no groups: the shapes of their objects are inside `translate` and `rotate` nodes, and
//! their lights and the camera have placements.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::lights::Light;
use crate::nodes::{Node, inverse_rows_about};
use crate::real::{Real, Vec3, vec3};
use crate::scene::Object;
use crate::seek::Seek;
use crate::values::{Angles, Direction, Point};

/// Objects, lights and the camera that move together. The group is turned first, then moved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Group {
    /// Name of the group, for people.
    #[serde(default, skip_serializing)]
    #[schemars(length(min = 1, max = crate::limits::MAX_NAME_CHARS))]
    pub name: Option<String>,
    /// Offset, in scene units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [[0, 1, 0]]))]
    pub by: Option<Point>,
    /// Angles about x, y and z, in degrees; or one angle about `axis`, counter-clockwise seen from its tip.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [[0, 30, 0]]))]
    pub degrees: Option<Angles>,
    /// Axis of the rotation, if there is one angle; y when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [[0, 1, 0]]))]
    pub axis: Option<Direction>,
    /// Point that the rotation leaves in place, in scene units; the origin when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [[0, 1, 0]]))]
    pub about: Option<Point>,
    /// Objects of the group.
    #[serde(default)]
    pub objects: Vec<Object>,
    /// Lights of the group.
    #[serde(default)]
    pub lights: Vec<Light>,
    /// Whether the camera belongs to the group.
    #[serde(default)]
    pub camera: bool,
    /// Groups that move with this one.
    #[serde(default)]
    pub groups: Vec<Group>,
}

/// A rotation and an offset of a light or the camera: that of its group.
#[derive(Clone, Debug, PartialEq, Serialize, Seek)]
pub(crate) struct Placement {
    by: Option<Point>,
    degrees: Option<Angles>,
    axis: Option<Direction>,
    about: Option<Point>,
}

impl Placement {
    /// The placement of a group.
    pub(crate) fn of(group: &Group) -> Self {
        let Group { name: _, by, degrees, axis, about, objects: _, lights: _, camera: _, groups: _ } = group;
        Self { by: by.clone(), degrees: degrees.clone(), axis: axis.clone(), about: about.clone() }
    }

    /// Rows of the inverse rotation's matrix.
    fn inverse_rows(&self) -> Option<[Vec3<f32>; 3]> {
        Some(match self.degrees.as_ref()? {
            Angles::Fixed(rotation) => rotation.inverse_rows(),
            Angles::About(degrees) => {
                let axis = self.axis.as_ref().map_or(vec3(0.0, 1.0, 0.0), Direction::unit);
                inverse_rows_about(axis, degrees.get())
            }
        })
    }

    /// A point of the scene, as seen from inside the group.
    pub(crate) fn to_group<R: Real>(&self, p: Vec3<R>) -> Vec3<R> {
        let p = self.by.as_ref().map_or(p, |by| p - Vec3::uniform(p.x, by.get()));
        let Some([x, y, z]) = self.inverse_rows() else { return p };
        let turned = |p: Vec3<R>| vec3(p.dot_uniform(x), p.dot_uniform(y), p.dot_uniform(z));
        self.about.as_ref().map_or_else(
            || turned(p),
            |about| {
                let about = Vec3::uniform(p.x, about.get());
                turned(p - about) + about
            },
        )
    }

    /// A direction of the group, as seen in the scene.
    pub(crate) fn direction_to_scene<R: Real>(&self, d: Vec3<R>) -> Vec3<R> {
        let Some([x, y, z]) = self.inverse_rows() else { return d };
        let column = |axis: fn(Vec3<f32>) -> f32| vec3(axis(x), axis(y), axis(z));
        vec3(d.dot_uniform(column(|v| v.x)), d.dot_uniform(column(|v| v.y)), d.dot_uniform(column(|v| v.z)))
    }

    /// A point of the group, as seen in the scene.
    pub(crate) fn to_scene(&self, p: Vec3<f32>) -> Vec3<f32> {
        let about = self.about.as_ref().map_or(vec3(0.0, 0.0, 0.0), Point::get);
        let by = self.by.as_ref().map_or(vec3(0.0, 0.0, 0.0), Point::get);
        self.direction_to_scene(p - about) + about + by
    }
}

impl Placement {
    /// A shape inside the nodes that place it, and the names of these nodes, the innermost first.
    pub(crate) fn around(&self, mut shape: Node) -> (Node, Vec<&'static str>) {
        let Self { by, degrees, axis, about } = self;
        let mut names = Vec::new();
        if let Some(degrees) = degrees {
            shape = Node::rotated(degrees.clone(), axis.clone(), about.clone(), shape);
            names.push(shape.name());
        }
        if let Some(by) = by {
            shape = Node::translated(by.clone(), shape);
            names.push(shape.name());
        }
        (shape, names)
    }
}
