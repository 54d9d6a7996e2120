//! Texture that exists in unit tests alone: shows what adding one takes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Pattern;
use crate::materials::{ColorParam, ShadingPoint};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::Length;

/// A color that rises from black along z, repeated with a period.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct AddedTexture {
    /// Length of a period.
    pub period: Length,
    /// Color at the end of a period.
    pub color: ColorParam,
}

impl Pattern for AddedTexture {
    const EXAMPLE: &str = r#"{ "period": 0.7, "color": [0.9, 0.5, 0.2] }"#;

    fn color<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        let periods = place.local_point.z * place.local_point.z.uniform(1.0 / self.period.get());
        let share = periods - periods.floor();
        self.color.at(place) * share
    }

    fn color_params(&self) -> Vec<&ColorParam> {
        vec![&self.color]
    }
}
