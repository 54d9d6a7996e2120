//! Profiles with a short closed formula. Each is exact.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Bounds2, ProfileSdf};
use crate::kinds::NodeError;
use crate::real::Real;
use crate::seek::Seek;
use crate::values::{Length, LengthOrZero};

/// A disk around the origin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Circle {
    /// Radius.
    pub radius: Length,
}

impl ProfileSdf for Circle {
    const EXAMPLE: &str = r#"{ "radius": 0.9 }"#;

    fn is_symmetric(&self) -> bool {
        true
    }

    fn distance<R: Real>(&self, x: R, y: R) -> R {
        x.square_add(y.square()).sqrt() - x.uniform(self.radius.get())
    }

    fn extent(&self, isolevel: f32) -> Bounds2 {
        Bounds2::symmetric(self.radius.in_frame(), self.radius.in_frame()).widened(isolevel)
    }
}

/// A rectangle around the origin, its sides along the axes.
///
/// Inigo Quilez, "2D distance functions": <https://iquilezles.org/articles/distfunctions2d/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Rectangle {
    /// Full extents along x and y.
    pub size: [Length; 2],
    /// Radius of its rounded corners, inside `size`.
    #[serde(default = "super::default_round")]
    pub round: LengthOrZero,
}

impl ProfileSdf for Rectangle {
    const ALIASES: &'static [&'static str] = &["square"];
    const EXAMPLE: &str = r#"{ "size": [1.8, 1.2], "round": 0.25 }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[r#"{ "size": [0.5, 1.1] }"#];

    fn is_symmetric(&self) -> bool {
        true
    }

    fn distance<R: Real>(&self, x: R, y: R) -> R {
        let ([width, height], round) = (&self.size, self.round.get());
        let past_side = x.abs() - x.uniform(width.get() / 2.0 - round);
        let past_top = y.abs() - x.uniform(height.get() / 2.0 - round);
        let (right, up) = (past_side.at_least(0.0), past_top.at_least(0.0));
        right.square_add(up.square()).sqrt() + past_side.max(past_top).at_most(0.0) - x.uniform(round)
    }

    fn extent(&self, isolevel: f32) -> Bounds2 {
        let [width, height] = &self.size;
        Bounds2::symmetric(width.in_frame() / 2.0, height.in_frame() / 2.0).widened(isolevel)
    }

    fn validate(&self) -> Option<NodeError> {
        let [width, height] = &self.size;
        let most = width.in_frame().min(height.in_frame()) / 2.0;
        let message = format!("must be at most half of the shorter side: make round {most} or less");
        (self.round.in_frame() > most).then(|| NodeError::new("round", message))
    }
}
