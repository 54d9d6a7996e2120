//! Panoramic camera, which shows all directions.

use super::{CameraAxes, Extent, Project};
use crate::bounds::Bounds;
use crate::camera::View;
use crate::film::Film;
use crate::ray::{Ray, Tolerance};
use crate::real::{Real, Vec3};
use crate::values::FieldOfView;

/// All around the camera, 360 by 180 degrees: longitude across, latitude down (equirectangular), with `look_at` at the
/// center.
#[derive(Clone, Copy, Debug)]
pub struct Panorama;

impl Project for Panorama {
    const ALIASES: &'static [&'static str] = &["equirectangular"];
    const EXAMPLE: &'static str = r#""panorama""#;

    fn default_fov(&self) -> Result<FieldOfView, &'static str> {
        Err("has no effect in a panorama, which shows all directions: remove it")
    }

    fn validate_lens(&self) -> Option<&'static str> {
        Some("has no effect in a panorama, which shows all directions: remove it, or choose another projection")
    }

    fn extent(&self, _: Option<&FieldOfView>, _: f32, height: f32) -> Extent {
        let footprint = Tolerance { slope: std::f32::consts::FRAC_PI_2 / height, floor: 0.0 };
        Extent { half_width: 1.0, half_height: 1.0, footprint }
    }

    fn ray<R: Real>(&self, axes: &CameraAxes<R>, across: R, upwards: R) -> Ray<R> {
        let (east, ahead) = (across * std::f32::consts::PI).sin_cos();
        let (above, level) = (upwards * std::f32::consts::FRAC_PI_2).sin_cos();
        let around = axes.right.mul_add(east, axes.forward * ahead);
        Ray { origin: axes.origin, direction: around.mul_add(level, axes.up * above).normalize() }
    }

    fn picture_point<R: Real>(&self, axes: &CameraAxes<R>, offset: Vec3<R>) -> (R, R) {
        let (east, ahead, above) = (offset.dot(axes.right), offset.dot(axes.forward), offset.dot(axes.up));
        let level = east.square_add(ahead.square()).sqrt();
        (east.atan2(ahead) * std::f32::consts::FRAC_1_PI, above.atan2(level) * std::f32::consts::FRAC_2_PI)
    }

    // The left and the right edge are one line in space.
    fn way_across<R: Real>(&self, way: R) -> R {
        way - ((way + 1.0) * 0.5).floor() * 2.0
    }

    fn is_beside(&self, _: &View, _: Bounds) -> bool {
        false
    }

    fn warning(&self, film: Film<'_>) -> Option<String> {
        let Film { width, height, .. } = film;
        (width != height.saturating_mul(2)).then(|| {
            format!("a panorama is 360 by 180 degrees, and {width}×{height} stretches it: make width twice height")
        })
    }
}
