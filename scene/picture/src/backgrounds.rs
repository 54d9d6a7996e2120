//! Registry of backgrounds, and the trait that each background implements.
//!
//! A background is one documented struct in a file under `backgrounds/`, one `impl` of [`Backdrop`], and one entry in
//! the list. If it has fields, it also has an `impl` of [`HasExamples`]; without fields, JSON has its name alone.

#[cfg(feature = "added")]
mod added;
mod day;
mod simple;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

#[cfg(feature = "added")]
pub use added::AddedBackground;
pub use day::Day;
pub use simple::{SkyGradient, SolidColor, Transparent};

pub use crate::kinds::{Example, HasExamples};
use crate::kinds::{NodeError, snake_case};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::Color;

/// Behavior of a background.
pub trait Backdrop {
    /// Linear RGB radiance from `direction`, of length 1; black where the background is transparent.
    fn radiance<R: Real>(&self, direction: Vec3<R>) -> Vec3<R>;

    /// Mean radiance over the half space of this normal, weighted by the cosine; `None` if it has no closed form.
    fn cosine_mean<R: Real>(&self, normal: Vec3<R>) -> Option<Vec3<R>> {
        let _ = normal;
        None
    }

    /// The background's `day`, if it is one.
    fn day(&self) -> Option<&Day> {
        None
    }

    /// Whether the background is empty, so that alpha is 0.
    fn is_transparent(&self) -> bool {
        false
    }

    /// Error in the background's parameters, if there is one.
    fn validate(&self) -> Option<NodeError> {
        None
    }

    /// Precomputes values that all directions use.
    fn precompute(&mut self) {}
}

/// The list: each background's name and its struct, then those without fields, described as in the schema.
macro_rules! backgrounds {
    (
        structs: [$($(#[$attribute:meta])* $Kind:ident: $Struct:ident),* $(,)?],
        units: [$($(#[$about:meta])* $Unit:ident),* $(,)?] $(,)?
    ) => {
        /// Background: seen by rays that hit nothing.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
        #[serde(rename_all = "snake_case", deny_unknown_fields)]
        pub enum Background {
            $($(#[$attribute])* #[doc = concat!("See [`", stringify!($Struct), "`].")] $Kind($Struct),)*
            $($(#[$about])* $Unit,)*
        }

        impl Backdrop for Background {
            fn radiance<R: Real>(&self, direction: Vec3<R>) -> Vec3<R> {
                match self {
                    $($(#[$attribute])* Self::$Kind(background) => background.radiance(direction),)*
                    $(Self::$Unit => $Unit.radiance(direction),)*
                }
            }

            fn cosine_mean<R: Real>(&self, normal: Vec3<R>) -> Option<Vec3<R>> {
                match self {
                    $($(#[$attribute])* Self::$Kind(background) => background.cosine_mean(normal),)*
                    $(Self::$Unit => $Unit.cosine_mean(normal),)*
                }
            }

            fn day(&self) -> Option<&Day> {
                match self {
                    $($(#[$attribute])* Self::$Kind(background) => background.day(),)*
                    $(Self::$Unit => None,)*
                }
            }

            fn is_transparent(&self) -> bool {
                match self {
                    $($(#[$attribute])* Self::$Kind(background) => background.is_transparent(),)*
                    $(Self::$Unit => $Unit.is_transparent(),)*
                }
            }

            /// Same error, with its pointer in the background's JSON.
            fn validate(&self) -> Option<NodeError> {
                match self {
                    $($(#[$attribute])* Self::$Kind(background) => {
                        background.validate().map(|validate| validate.inside(&snake_case(stringify!($Kind))))
                    })*
                    $(Self::$Unit => $Unit.validate(),)*
                }
            }

            fn precompute(&mut self) {
                match self {
                    $($(#[$attribute])* Self::$Kind(background) => background.precompute(),)*
                    $(Self::$Unit => {})*
                }
            }
        }

        impl Background {
            /// Each kind's examples, as a user would write the background.
            pub fn examples() -> Vec<Example> {
                let mut examples = Vec::new();
                $(
                    $(#[$attribute])*
                    examples.extend(Example::keyed::<$Struct>(stringify!($Struct), stringify!($Kind)));
                )*
                $(examples.push(Example::unit(stringify!($Unit)));)*
                examples
            }
        }
    };
}

backgrounds![
    structs: [
        Color: SolidColor,
        Gradient: SkyGradient,
        Day: Day,
        #[cfg(feature = "added")]
        Added: AddedBackground,
    ],
    units: [
        /// Empty: alpha is 0.
        Transparent,
    ],
];

impl Default for Background {
    fn default() -> Self {
        Self::Gradient(SkyGradient { bottom: Color::new(1.0, 1.0, 1.0), top: Color::new(0.5, 0.7, 1.0) })
    }
}
