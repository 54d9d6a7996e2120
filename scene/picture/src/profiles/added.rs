//! Profile that exists in unit tests alone: shows what adding one takes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Bounds2, ProfileSdf};
use crate::real::Real;
use crate::seek::Seek;
use crate::values::Length;

/// Area between two lines across y.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct AddedProfile {
    /// Distance between the lines.
    pub height: Length,
}

impl ProfileSdf for AddedProfile {
    const EXAMPLE: &str = r#"{ "height": 0.8 }"#;

    fn is_symmetric(&self) -> bool {
        true
    }

    fn distance<R: Real>(&self, _: R, y: R) -> R {
        y.abs() - y.uniform(0.5 * self.height.get())
    }

    fn extent(&self, isolevel: f32) -> Bounds2 {
        Bounds2::symmetric(f32::INFINITY, 0.5 * self.height.in_frame() + isolevel)
    }
}
