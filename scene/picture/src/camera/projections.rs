//! Registry of projections, and the trait that each projection implements.
//!
//! A projection is one documented struct in a file under `camera/projections/`, one `impl` of [`Project`], and one
//! entry in the list. If it has fields, it also has an `impl` of [`HasExamples`]; without fields, JSON has its name
//! alone.

#[cfg(feature = "added")]
mod added;
mod orthographic;
mod panorama;
mod perspective;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

#[cfg(feature = "added")]
use added::AddedProjection;
pub use orthographic::Orthographic;
pub use panorama::Panorama;
pub use perspective::Perspective;

use super::{Matrix, View};
use crate::bounds::Bounds;
use crate::film::Image;
pub use crate::kinds::{Example, HasExamples};
use crate::ray::{Ray, Tolerance};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::FieldOfView;

/// Extent of the picture in space.
#[derive(Clone, Copy, Debug)]
pub struct Extent {
    /// Half the picture's width at distance 1, or at any distance for parallel rays; 1 if it has no meaning.
    pub half_width: f32,
    /// Half the picture's height, like `half_width`.
    pub half_height: f32,
    /// Half a pixel's height at a distance along a ray.
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

/// Behavior of a projection.
pub trait Project {
    /// Field of view to use if the camera has none; `None` if the projection does not use one.
    fn default_fov(&self) -> Option<FieldOfView> {
        None
    }

    /// Error message if a camera with this projection has a field of view and must not.
    fn validate_fov(&self) -> Option<&'static str> {
        None
    }

    /// Error message if a camera with this projection has a lens and must not.
    fn validate_lens(&self) -> Option<&'static str> {
        None
    }

    /// Extent of a picture that is `aspect` times as wide as high, and `height` pixels high.
    fn extent(&self, fov: Option<&FieldOfView>, aspect: f32, height: f32) -> Extent;

    /// Ray through a point of the picture, −1 to 1 across and up.
    fn ray<R: Real>(&self, axes: &CameraAxes<R>, across: R, upwards: R) -> Ray<R>;

    /// Point of the picture, across and up, at which a point at an offset from the camera is seen: the inverse of `ray`.
    /// Scalar products with the axes are coordinates in the picture at distance 1. One that is not in front of the camera
    /// may be seen anywhere beside the picture.
    fn picture_point<R: Real>(&self, axes: &CameraAxes<R>, offset: Vec3<R>) -> (R, R);

    /// Point of the picture, like `picture_point`, at which the background in a direction is seen.
    fn background_point<R: Real>(&self, axes: &CameraAxes<R>, direction: Vec3<R>) -> (R, R) {
        self.picture_point(axes, direction)
    }

    /// The shorter way across the picture, if there are two.
    fn way_across<R: Real>(&self, way: R) -> R {
        way
    }

    /// Whether no ray of the picture hits the box at any distance. May be false although no ray does.
    fn is_beside(&self, view: &View, bounds: Bounds) -> bool;

    /// Whether no ray of the picture reaches the box within this distance.
    fn is_beyond(&self, view: &View, bounds: Bounds, distance: f32) -> bool {
        view.is_out_of_reach(bounds, distance)
    }

    /// Origins of the picture's rays, or a sample of them.
    fn ray_origins(&self, view: &View, image: &Image) -> Vec<Vec3<f32>> {
        let _ = image;
        vec![view.origin()]
    }

    /// Words of the warning about a ray origin inside an object: the subject, and the fix.
    fn inside_warning(&self) -> (&'static str, &'static str) {
        ("the camera is inside", "move camera.position out of it")
    }

    /// Matrix from the scene to the picture, see [`View::world_to_ndc`]; `None` if the projection is not linear.
    fn world_to_ndc(&self, view: &View) -> Option<Matrix> {
        let _ = view;
        None
    }

    /// Warning about a picture of this size, if there is one.
    fn warning(&self, image: &Image) -> Option<String> {
        let _ = image;
        None
    }
}

/// The list: each projection's name and its struct, then those without fields, described as in the schema.
macro_rules! projections {
    (
        structs: [$($(#[$attribute:meta])* $Kind:ident: $Struct:ident),* $(,)?],
        units: [$($(#[$about:meta])* $Unit:ident),* $(,)?] $(,)?
    ) => {
        /// Projection of space onto the picture.
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
        #[serde(rename_all = "snake_case")]
        pub enum Projection {
            $($(#[$about])* $Unit,)*
            $($(#[$attribute])* #[doc = concat!("See [`", stringify!($Struct), "`].")] $Kind($Struct),)*
        }

        impl Project for Projection {
            fn default_fov(&self) -> Option<FieldOfView> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.default_fov(),)*
                    $(Self::$Unit => $Unit.default_fov(),)*
                }
            }

            fn validate_fov(&self) -> Option<&'static str> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.validate_fov(),)*
                    $(Self::$Unit => $Unit.validate_fov(),)*
                }
            }

            fn validate_lens(&self) -> Option<&'static str> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.validate_lens(),)*
                    $(Self::$Unit => $Unit.validate_lens(),)*
                }
            }

            fn extent(&self, fov: Option<&FieldOfView>, aspect: f32, height: f32) -> Extent {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.extent(fov, aspect, height),)*
                    $(Self::$Unit => $Unit.extent(fov, aspect, height),)*
                }
            }

            fn ray<R: Real>(&self, axes: &CameraAxes<R>, across: R, upwards: R) -> Ray<R> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.ray(axes, across, upwards),)*
                    $(Self::$Unit => $Unit.ray(axes, across, upwards),)*
                }
            }

            fn picture_point<R: Real>(&self, axes: &CameraAxes<R>, offset: Vec3<R>) -> (R, R) {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.picture_point(axes, offset),)*
                    $(Self::$Unit => $Unit.picture_point(axes, offset),)*
                }
            }

            fn background_point<R: Real>(&self, axes: &CameraAxes<R>, direction: Vec3<R>) -> (R, R) {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.background_point(axes, direction),)*
                    $(Self::$Unit => $Unit.background_point(axes, direction),)*
                }
            }

            fn way_across<R: Real>(&self, way: R) -> R {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.way_across(way),)*
                    $(Self::$Unit => $Unit.way_across(way),)*
                }
            }

            fn is_beside(&self, view: &View, bounds: Bounds) -> bool {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.is_beside(view, bounds),)*
                    $(Self::$Unit => $Unit.is_beside(view, bounds),)*
                }
            }

            fn is_beyond(&self, view: &View, bounds: Bounds, distance: f32) -> bool {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.is_beyond(view, bounds, distance),)*
                    $(Self::$Unit => $Unit.is_beyond(view, bounds, distance),)*
                }
            }

            fn ray_origins(&self, view: &View, image: &Image) -> Vec<Vec3<f32>> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.ray_origins(view, image),)*
                    $(Self::$Unit => $Unit.ray_origins(view, image),)*
                }
            }

            fn inside_warning(&self) -> (&'static str, &'static str) {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.inside_warning(),)*
                    $(Self::$Unit => $Unit.inside_warning(),)*
                }
            }

            fn world_to_ndc(&self, view: &View) -> Option<Matrix> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.world_to_ndc(view),)*
                    $(Self::$Unit => $Unit.world_to_ndc(view),)*
                }
            }

            fn warning(&self, image: &Image) -> Option<String> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.warning(image),)*
                    $(Self::$Unit => $Unit.warning(image),)*
                }
            }
        }

        impl Projection {
            /// Each kind's examples, as a user would write the projection.
            pub fn examples() -> Vec<Example> {
                let mut examples = vec![$(Example::unit(stringify!($Unit))),*];
                $(
                    $(#[$attribute])*
                    examples.extend(Example::keyed::<$Struct>(stringify!($Struct), stringify!($Kind)));
                )*
                examples
            }
        }
    };
}

projections![
    structs: [
        Orthographic: Orthographic,
        #[cfg(feature = "added")]
        Added: AddedProjection,
    ],
    units: [
        /// A pinhole: more distant objects are smaller.
        #[default]
        Perspective,
        /// All around the camera, 360 by 180 degrees: longitude across, latitude down (equirectangular), with
        /// `look_at` at the center.
        Panorama,
    ],
];

impl Projection {
    /// Whether it is the default projection.
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }
}
