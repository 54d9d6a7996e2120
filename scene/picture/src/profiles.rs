//! Profiles: 2D shapes in the plane of x and y, for `extrude` and `revolve`.
//!
//! A profile is one documented struct in a file of its family under `profiles/`, one `impl` of
//! [`ProfileSdf`], and one entry in the list below. Its examples are examples of `extrude` and
//! `revolve`, so the contract tests and the pictures of docs/nodes.md follow from those.

#[cfg(feature = "added")]
mod added;
mod bezier;
mod edge;
mod ellipse;
mod polygon;
mod regular;
mod simple;
mod strokes;
mod text;
mod text_outline;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

#[cfg(feature = "added")]
pub use added::AddedProfile;
pub use ellipse::Ellipse;
pub use polygon::{Polygon, PolygonVertices, VertexCountError};
pub use regular::{RegularPolygon, Star};
pub use simple::{Circle, Rectangle};
pub use strokes::{Arc, Bezier};
pub use text::Text;
pub use text_outline::{TextOutline, TextOutlineError};

use crate::kinds::{Exactness, NodeError, family};
use crate::real::Real;
use crate::seek::Seek;
use crate::values::{Coordinate, LengthOrZero};

/// A point or an offset in the plane, in scene units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[schemars(rename = "PlanePoint")]
pub struct Point2(pub Coordinate, pub Coordinate);

impl Point2 {
    /// Its coordinates in this frame.
    pub fn in_frame(&self) -> [f32; 2] {
        [self.0.in_frame(), self.1.in_frame()]
    }
}

/// A rectangle along the axes, in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds2 {
    /// Minimum coordinates.
    pub low: [f32; 2],
    /// Maximum coordinates.
    pub high: [f32; 2],
}

impl Bounds2 {
    /// Rectangle around the origin with these half extents.
    pub fn symmetric(x: f32, y: f32) -> Self {
        Self { low: [-x, -y], high: [x, y] }
    }

    /// Smallest rectangle around one or more points.
    pub(crate) fn from_points(points: impl IntoIterator<Item = [f32; 2]>) -> Self {
        let empty = Self { low: [f32::INFINITY; 2], high: [f32::NEG_INFINITY; 2] };
        points.into_iter().fold(empty, |extent, point| extent.hull(Self { low: point, high: point }))
    }

    /// Smallest rectangle that contains both.
    pub fn hull(self, other: Self) -> Self {
        let axis = |f: fn(f32, f32) -> f32, a: [f32; 2], b: [f32; 2]| [f(a[0], b[0]), f(a[1], b[1])];
        Self { low: axis(f32::min, self.low, other.low), high: axis(f32::max, self.high, other.high) }
    }

    /// Rectangle with each side moved out by `margin`.
    pub fn widened(self, margin: f32) -> Self {
        Self { low: self.low.map(|c| c - margin), high: self.high.map(|c| c + margin) }
    }
}

family! {
    /// A flat shape in the plane of x and y: an object whose member is the profile's name.
    pub enum Profile {
        Circle(Circle),
        Ellipse(Ellipse),
        Rectangle(Rectangle),
        RegularPolygon(RegularPolygon),
        Star(Star),
        Polygon(Polygon),
        Arc(Arc),
        Bezier(Bezier),
        Text(Text),
        #[cfg(feature = "added")]
        AddedProfile(AddedProfile),
    }

    /// A profile. Its value has a Lipschitz factor of 1.
    pub trait ProfileSdf {

        /// Whether it is its own mirror image about the y axis.
        fn is_symmetric(&self) -> bool = false;

        /// The signed distance from (`x`, `y`) to the outline, negative inside.
        fn distance<R: Real>(&self, x: R, y: R) -> R;

        /// Rectangle that contains every point whose distance is at most `isolevel`, which is at least 0.
        fn extent(&self, isolevel: f32) -> Bounds2;

        /// Relation of its value to the true distance.
        fn exactness(&self) -> Exactness = Exactness::Exact;

        /// Error in its numbers taken together, if any; each number alone is in range.
        fn validate(&self) -> Option<NodeError> = None;

        /// Its size in simple nodes.
        fn size_in_nodes(&self) -> u32 = 1;
    }
}

impl Profile {
    /// The signed distance from (`x`, `y`) to the outline, under the profile's name.
    pub(crate) fn sample<R: Real>(&self, x: R, y: R) -> R {
        x.labeled(self.type_name(), || self.distance(x, y))
    }
}

fn default_round() -> LengthOrZero {
    LengthOrZero::new(0.0).expect("0 is in range")
}
