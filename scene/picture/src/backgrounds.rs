//! Registry of backgrounds, and the trait that each background implements.
//!
//! A background is one documented struct in a file under `backgrounds/`, one `impl` of [`Backdrop`], and one entry in
//! the list. Without fields, JSON has its name alone.

#[cfg(feature = "added")]
mod added;
mod day;
mod simple;

#[cfg(feature = "added")]
pub use added::AddedBackground;
pub use day::Day;
pub use simple::{SkyGradient, SolidColor, Transparent};

use crate::kinds::{NodeError, family};
use crate::real::{Real, Vec3};
use crate::values::Color;

family! {
    /// Background: seen by rays that hit nothing.
    #[serde(deny_unknown_fields)]
    pub enum Background {
        Color(SolidColor),
        Gradient(SkyGradient),
        Day(Day),
        #[cfg(feature = "added")]
        Added(AddedBackground),
        /// Empty: alpha is 0.
        Transparent,
    }

    /// Behavior of a background.
    pub trait Backdrop {
        /// Linear RGB radiance from `direction`, of length 1; black where the background is transparent.
        fn radiance<R: Real>(&self, direction: Vec3<R>) -> Vec3<R>;

        /// Mean radiance over the half space of this normal, weighted by the cosine; `None` if it has no closed form.
        fn cosine_mean<R: Real>(&self, normal: Vec3<R>) -> Option<Vec3<R>> = None;

        /// Error in the background's parameters, if there is one.
        fn validate(&self) -> Option<NodeError> = None;

        /// Precomputes values that all directions use.
        fn precompute(&mut self) = ();
    }
}

impl Default for Background {
    fn default() -> Self {
        Self::Gradient(SkyGradient { bottom: Color::new(1.0, 1.0, 1.0), top: Color::new(0.5, 0.7, 1.0) })
    }
}

impl Background {
    /// Error in the background's parameters, with its pointer in the background's JSON.
    pub(crate) fn fault(&self) -> Option<NodeError> {
        self.validate().map(|error| error.inside(self.name()))
    }
}
