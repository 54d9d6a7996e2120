//! Groups: objects, lights and the camera that move together.
//!
//! A scene to be rendered has no groups: the shapes of their objects are inside `translate` and `rotate` nodes, and
//! their lights and the camera have placements.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::lights::Light;
use crate::scene::Object;
use crate::values::{Angles, Direction, Placement, Point};

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

impl Group {
    /// Its rotation and offset.
    pub(crate) fn placement(&self) -> Placement {
        let Self { name: _, by, degrees, axis, about, objects: _, lights: _, camera: _, groups: _ } = self;
        Placement { by: by.clone(), degrees: degrees.clone(), axis: axis.clone(), about: about.clone() }
    }
}
