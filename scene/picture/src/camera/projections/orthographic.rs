//! Orthographic camera, with parallel rays.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{CameraAxes, Extent, Project};
use crate::bounds::Bounds;
use crate::camera::{Matrix, View};
use crate::ray::{Ray, Tolerance};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{FieldOfView, Length};

/// Parallel rays from a plane through the camera: sizes do not change with distance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Orthographic {
    /// Height of the picture, in scene units.
    pub height: Length,
}

impl Project for Orthographic {
    const ALIASES: &'static [&'static str] = &["ortho"];
    const EXAMPLE: &'static str = r#"{ "height": 4.2 }"#;

    fn default_fov(&self) -> Result<FieldOfView, &'static str> {
        Err("has no effect in an orthographic picture: remove it, and set the height")
    }

    fn extent(&self, _: Option<&FieldOfView>, aspect: f32, height: f32) -> Extent {
        let half = self.height.in_frame() * 0.5;
        let footprint = Tolerance { slope: 0.0, floor: half / height };
        Extent { half_width: aspect * half, half_height: half, footprint }
    }

    fn ray<R: Real>(&self, axes: &CameraAxes<R>, across: R, upwards: R) -> Ray<R> {
        let origin = axes.right.mul_add(across, axes.up.mul_add(upwards, axes.origin));
        Ray { origin, direction: axes.forward }
    }

    fn picture_point<R: Real>(&self, axes: &CameraAxes<R>, offset: Vec3<R>) -> (R, R) {
        (offset.dot(axes.right), offset.dot(axes.up))
    }

    fn is_beside(&self, view: &View, bounds: Bounds) -> bool {
        let seen = view.to_view_space(bounds);
        let (across, upwards) = view.blur_in_view_space(seen);
        let is_off = |low: f32, high: f32, blur: f32| high < -1.0 - blur || low > 1.0 + blur;
        is_off(seen.min.x, seen.max.x, across) || is_off(seen.min.y, seen.max.y, upwards) || seen.max.z < 0.0
    }

    fn world_to_ndc(&self, view: &View) -> Option<Matrix> {
        Some(view.parallel_ndc())
    }
}
