//! How space becomes a picture: the list of projections, and what a projection must say of itself.
//!
//! A projection is one documented struct in a file under `camera/projections/`, one `impl` of [`Project`], and one
//! entry in the list; with values it has an `impl` of [`Exemplary`] too, and without it is written as its name alone.

#[cfg(test)]
mod added;
mod orthographic;
mod panorama;
mod perspective;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

#[cfg(test)]
use added::AddedProjection;
pub use orthographic::Orthographic;
pub use panorama::Panorama;
pub use perspective::Perspective;

use super::{Ray, View};
use crate::bounds::Bounds;
use crate::job::Image;
pub use crate::kinds::{Example, Exemplary};
use crate::march::Tolerance;
use crate::real::{Real, Vec3};
use crate::values::FieldOfView;

/// How much of space a picture shows.
#[derive(Clone, Copy, Debug)]
pub struct Extent {
    /// Half the picture's width at a distance of 1, or at any; 1 where that means nothing.
    pub half_width: f32,
    /// Half its height.
    pub half_height: f32,
    /// Half a pixel's height, by the distance along a ray.
    pub footprint: Tolerance,
}

/// Where a camera is and where it looks: each direction to the right and up is as long as the picture's half extent.
#[derive(Clone, Copy, Debug)]
pub struct Axes<R> {
    /// Where the camera is.
    pub origin: Vec3<R>,
    /// To the right.
    pub right: Vec3<R>,
    /// Up.
    pub up: Vec3<R>,
    /// To the middle of the picture, of length 1.
    pub forward: Vec3<R>,
}

/// What a projection means.
pub trait Project {
    /// The field of view that it has where the camera says none; `None` if it has none at all.
    fn default_fov(&self) -> Option<FieldOfView> {
        None
    }

    /// Why a camera must not say a field of view, if it must not.
    fn fov_fault(&self) -> Option<&'static str> {
        None
    }

    /// How much of space a picture shows that is `aspect` times as wide as high, and `height` pixels high.
    fn extent(&self, fov: Option<FieldOfView>, aspect: f32, height: f32) -> Extent;

    /// The ray through a point of the picture: −1 to 1 across and upwards.
    fn ray<R: Real>(&self, axes: &Axes<R>, across: R, upwards: R) -> Ray<R>;

    /// Whether no ray of the picture meets the box, however long it is. It may say no where there is none.
    fn is_beside(&self, view: &View, bounds: Bounds) -> bool;

    /// Whether no ray of the picture has come to the box at this distance.
    fn is_beyond(&self, view: &View, bounds: Bounds, distance: f32) -> bool {
        view.is_out_of_reach(bounds, distance)
    }

    /// Where the picture's rays start, or some of those places.
    fn starts(&self, view: &View, image: &Image) -> Vec<Vec3<f32>> {
        let _ = image;
        vec![view.origin()]
    }

    /// What an author is told of a start inside an object: what is inside, and what to do about it.
    fn inside(&self) -> (&'static str, &'static str) {
        ("the camera is inside", "move camera.position out of it")
    }

    /// What an author should know of a picture of this size, if anything.
    fn warning(&self, image: &Image) -> Option<String> {
        let _ = image;
        None
    }
}

/// The list: each projection's name and its struct, then those that are a name alone, described as in the schema.
macro_rules! projections {
    (
        values: [$($(#[$attribute:meta])* $Kind:ident: $Struct:ident),* $(,)?],
        words: [$($(#[$about:meta])* $Word:ident),* $(,)?] $(,)?
    ) => {
        /// How space becomes a picture.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum Projection {
            $($(#[$about])* $Word,)*
            $($(#[$attribute])* #[doc = concat!("See [`", stringify!($Struct), "`].")] $Kind($Struct),)*
        }

        impl Project for Projection {
            fn default_fov(&self) -> Option<FieldOfView> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.default_fov(),)*
                    $(Self::$Word => $Word.default_fov(),)*
                }
            }

            fn fov_fault(&self) -> Option<&'static str> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.fov_fault(),)*
                    $(Self::$Word => $Word.fov_fault(),)*
                }
            }

            fn extent(&self, fov: Option<FieldOfView>, aspect: f32, height: f32) -> Extent {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.extent(fov, aspect, height),)*
                    $(Self::$Word => $Word.extent(fov, aspect, height),)*
                }
            }

            #[inline(always)]
            fn ray<R: Real>(&self, axes: &Axes<R>, across: R, upwards: R) -> Ray<R> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.ray(axes, across, upwards),)*
                    $(Self::$Word => $Word.ray(axes, across, upwards),)*
                }
            }

            fn is_beside(&self, view: &View, bounds: Bounds) -> bool {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.is_beside(view, bounds),)*
                    $(Self::$Word => $Word.is_beside(view, bounds),)*
                }
            }

            fn is_beyond(&self, view: &View, bounds: Bounds, distance: f32) -> bool {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.is_beyond(view, bounds, distance),)*
                    $(Self::$Word => $Word.is_beyond(view, bounds, distance),)*
                }
            }

            fn starts(&self, view: &View, image: &Image) -> Vec<Vec3<f32>> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.starts(view, image),)*
                    $(Self::$Word => $Word.starts(view, image),)*
                }
            }

            fn inside(&self) -> (&'static str, &'static str) {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.inside(),)*
                    $(Self::$Word => $Word.inside(),)*
                }
            }

            fn warning(&self, image: &Image) -> Option<String> {
                match self {
                    $($(#[$attribute])* Self::$Kind(projection) => projection.warning(image),)*
                    $(Self::$Word => $Word.warning(image),)*
                }
            }
        }

        impl Projection {
            /// Each kind's examples, as a user would write the whole projection.
            pub fn examples() -> Vec<Example> {
                let mut examples = vec![$(Example::word(stringify!($Word))),*];
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
    values: [
        Orthographic: Orthographic,
        #[cfg(test)]
        Added: AddedProjection,
    ],
    words: [
        /// A pinhole: what is further away is smaller.
        #[default]
        Perspective,
        /// All around the camera, 360 by 180 degrees: longitude across, latitude down (equirectangular);
        /// what it looks at is in the middle.
        Panorama,
    ],
];

impl Projection {
    /// Whether it is the one that a camera has that says none.
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands a reference")]
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }
}
