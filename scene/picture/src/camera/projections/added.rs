//! Projection that exists in unit tests alone: shows what adding one takes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{CameraAxes, Extent, Project};
use crate::bounds::Bounds;
use crate::camera::View;
use crate::ray::{Ray, Tolerance};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{FieldOfView, Length};

/// A pinhole with a picture shifted down.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct AddedProjection {
    /// Shift, as a fraction of the picture's height.
    pub shift: Length,
}

impl Project for AddedProjection {
    const EXAMPLE: &str = r#"{ "shift": 0.25 }"#;

    fn default_fov(&self) -> Result<FieldOfView, &'static str> {
        Err("has no effect in an added picture: remove it")
    }

    fn extent(&self, _: Option<&FieldOfView>, aspect: f32, height: f32) -> Extent {
        let footprint = Tolerance { slope: 0.5 / height, floor: 0.0 };
        Extent { half_width: 0.5 * aspect, half_height: 0.5, footprint }
    }

    fn ray<R: Real>(&self, axes: &CameraAxes<R>, across: R, upwards: R) -> Ray<R> {
        let shifted = upwards + upwards.uniform(self.shift.get());
        let direction = axes.right.mul_add(across, axes.up.mul_add(shifted, axes.forward));
        Ray { origin: axes.origin, direction: direction.normalize() }
    }

    fn picture_point<R: Real>(&self, axes: &CameraAxes<R>, offset: Vec3<R>) -> (R, R) {
        let ahead = offset.dot(axes.forward).at_least(1e-6);
        let shift = offset.x.uniform(self.shift.get());
        (offset.dot(axes.right) / ahead, offset.dot(axes.up) / ahead / (shift + 1.0))
    }

    fn is_beside(&self, _: &View, _: Bounds) -> bool {
        false
    }
}
