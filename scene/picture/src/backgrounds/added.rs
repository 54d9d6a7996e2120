//! Background that exists in unit tests alone: shows what adding one takes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Backdrop;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::Color;

/// A color straight ahead and behind, black to all sides.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct AddedBackground {
    /// The color.
    pub color: Color,
}

impl Backdrop for AddedBackground {
    const EXAMPLE: &str = r#"{ "color": [0.3, 0.6, 0.9] }"#;

    fn radiance<R: Real>(&self, direction: Vec3<R>) -> Vec3<R> {
        Vec3::uniform(direction.x, self.color.get()) * direction.z.abs()
    }
}
