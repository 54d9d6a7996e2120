//! Node that exists in unit tests alone: shows what adding one takes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Primitive;
use crate::bounds::Bounds;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::Length;

/// Space between two planes across z.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct AddedNode {
    /// Distance between the planes.
    pub depth: Length,
}

impl Primitive for AddedNode {
    const ALIASES: &[&str] = &["extra_node"];
    const EXAMPLE: &str = r#"{ "depth": 0.8 }"#;

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        p.z.abs() - p.z.uniform(0.5 * self.depth.get())
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let reach = 0.5 * self.depth.in_frame() + isolevel;
        Bounds::symmetric(f32::INFINITY, f32::INFINITY, reach)
    }
}
