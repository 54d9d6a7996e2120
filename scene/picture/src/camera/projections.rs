//! Registry of projections, and the trait that each projection implements.
//!
//! A projection is one documented struct in a file under `camera/projections/`, one `impl` of [`Project`], and one
//! entry in the list. Without fields, JSON has its name alone.

#[cfg(feature = "added")]
mod added;
mod orthographic;
mod panorama;
mod perspective;

#[cfg(feature = "added")]
use added::AddedProjection;
pub use orthographic::Orthographic;
pub use panorama::Panorama;
pub use perspective::Perspective;

use super::{Matrix, View};
use crate::bounds::Bounds;
use crate::film::Film;
use crate::kinds::family;
use crate::ray::{Ray, Tolerance};
use crate::real::{Real, Vec3};
use crate::values::FieldOfView;

/// Extent of the picture in space.
#[derive(Clone, Copy, Debug)]
pub struct Extent {
    /// Half the picture's width at distance 1, or at any distance for parallel rays; 1 if it has no meaning.
    pub half_width: f32,
    /// Half the picture's height, like `half_width`.
    pub half_height: f32,
    /// Half a pixel's height at a distance along a ray: the same at all distances if, and only if, rays are parallel.
    pub footprint: Tolerance,
}

/// Position and directions of a camera; `right` and `up` are as long as the picture's half extent.
#[derive(Clone, Copy, Debug)]
pub struct CameraAxes<R> {
    /// Position of the camera.
    pub origin: Vec3<R>,
    /// To the right.
    pub right: Vec3<R>,
    /// Up.
    pub up: Vec3<R>,
    /// To the center of the picture, of length 1.
    pub forward: Vec3<R>,
}

family! {
    /// Projection of space onto the picture.
    pub enum Projection {
        /// A pinhole: more distant objects are smaller.
        Perspective,
        /// All around the camera, 360 by 180 degrees: longitude across, latitude down (equirectangular), with
        /// `look_at` at the center.
        Panorama,
        Orthographic(Orthographic),
        #[cfg(feature = "added")]
        Added(AddedProjection),
    }

    /// Behavior of a projection.
    pub trait Project {
        /// Field of view of a camera that names none; or the error message if a camera must have none.
        fn default_fov(&self) -> Result<FieldOfView, &'static str>;

        /// Error message if a camera with this projection has a lens and must not.
        fn validate_lens(&self) -> Option<&'static str> = None;

        /// Extent of a picture that is `aspect` times as wide as high, and `height` pixels high.
        fn extent(&self, fov: Option<&FieldOfView>, aspect: f32, height: f32) -> Extent;

        /// Ray through a point of the picture, −1 to 1 across and up.
        fn ray<R: Real>(&self, axes: &CameraAxes<R>, across: R, upwards: R) -> Ray<R>;

        /// Point of the picture, across and up, at which a point at an offset from the camera is seen: the inverse of
        /// `ray`. Scalar products with the axes are coordinates in the picture at distance 1. One that is not in front of
        /// the camera may be seen anywhere beside the picture.
        fn picture_point<R: Real>(&self, axes: &CameraAxes<R>, offset: Vec3<R>) -> (R, R);

        /// The shorter way across the picture, if there are two.
        fn way_across<R: Real>(&self, way: R) -> R = way;

        /// Whether no ray of the picture hits the box at any distance. May be false although no ray does.
        fn is_beside(&self, view: &View, bounds: Bounds) -> bool;

        /// Matrix from the scene to the picture, see [`View::world_to_ndc`]; `None` if the projection is not linear.
        fn world_to_ndc(&self, view: &View) -> Option<Matrix> = None;

        /// Warning about a picture of this size, if there is one.
        fn warning(&self, film: Film<'_>) -> Option<String> = None;
    }
}

#[expect(clippy::derivable_impls, reason = "the list of kinds has no mark for a default")]
impl Default for Projection {
    fn default() -> Self {
        Self::Perspective
    }
}

impl Projection {
    /// Whether it is the default projection.
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }
}
