//! Uses of shapes by their names.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::real::{Real, Vec3};
use crate::seek::Seek;

/// A shape of the scene's `shapes`, by its name: `{ "use": "leg" }`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
pub struct Use(String);

/// It is replaced by its shape when a job is parsed. Until then it is empty.
impl Sdf for Use {
    const EXAMPLE: &'static str = r#""leg""#;

    /// None, because an example is tested and drawn alone, without a scene that defines its name.
    fn examples() -> Vec<String> {
        Vec::new()
    }

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>) -> V {
        V::new(p.x.constant(1e9))
    }

    fn bounds(&self, _: f32) -> Bounds {
        Bounds::EMPTY
    }

    fn used_shape(&self) -> Option<&str> {
        Some(&self.0)
    }
}
