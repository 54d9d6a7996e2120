//! Perspective camera: a pinhole.

use super::{CameraAxes, Extent, Project};
use crate::bounds::Bounds;
use crate::camera::{Matrix, View};
use crate::ray::{Ray, Tolerance};
use crate::real::{Real, Vec3};
use crate::values::FieldOfView;

/// Default vertical field of view.
const DEFAULT_FOV_DEGREES: f32 = 40.0;

/// About the least cosine of the angle between the view and a point that is still in the picture.
const MIN_COSINE: f32 = 1e-5;

/// A pinhole: farther objects are smaller.
#[derive(Clone, Copy, Debug)]
pub struct Perspective;

impl Project for Perspective {
    const EXAMPLE: &'static str = r#""perspective""#;

    fn default_fov(&self) -> Result<FieldOfView, &'static str> {
        Ok(FieldOfView::new(DEFAULT_FOV_DEGREES).expect("40 is in range"))
    }

    fn extent(&self, fov: Option<&FieldOfView>, aspect: f32, height: f32) -> Extent {
        let fov = fov.map_or(DEFAULT_FOV_DEGREES, FieldOfView::in_frame);
        let (sine, cosine) = Real::sin_cos(fov * (std::f32::consts::PI / 360.0));
        let tangent = sine / cosine;
        let footprint = Tolerance { slope: tangent / height, floor: 0.0 };
        Extent { half_width: aspect * tangent, half_height: tangent, footprint }
    }

    fn ray<R: Real>(&self, axes: &CameraAxes<R>, across: R, upwards: R) -> Ray<R> {
        let direction = axes.right.mul_add(across, axes.up.mul_add(upwards, axes.forward));
        Ray { origin: axes.origin, direction: direction.normalize() }
    }

    fn picture_point<R: Real>(&self, axes: &CameraAxes<R>, offset: Vec3<R>) -> (R, R) {
        let size = offset.map(Real::abs).max_element();
        let ahead = offset.dot(axes.forward).max(size * MIN_COSINE).at_least(1e-12);
        (offset.dot(axes.right) / ahead, offset.dot(axes.up) / ahead)
    }

    fn world_to_ndc(&self, view: &View) -> Option<Matrix> {
        Some(view.pinhole_ndc())
    }

    fn is_beside(&self, view: &View, bounds: Bounds) -> bool {
        view.is_outside_pyramid(bounds.translated(-view.origin()))
    }
}
