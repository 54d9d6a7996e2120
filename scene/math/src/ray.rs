//! Rays, and lengths that grow along them.

use crate::real::{Real, Vec3, bundle};

/// A ray: a half line.
#[derive(Clone, Copy, Debug)]
pub struct Ray<R> {
    /// Start of the ray.
    pub origin: Vec3<R>,
    /// Direction, of length 1.
    pub direction: Vec3<R>,
}

bundle!(Ray { origin, direction });

impl<R: Real> Ray<R> {
    /// Point at a distance along the ray.
    pub fn at(&self, distance: R) -> Vec3<R> {
        self.direction.mul_add(distance, self.origin)
    }
}

/// Tolerance: `slope · t + floor` at distance t along the ray.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// Growth per distance along the ray.
    pub slope: f32,
    /// Minimum, in scene units.
    pub floor: f32,
}

impl Tolerance {
    /// The same approach with tolerances `factor` times as large.
    pub fn scaled(self, factor: f32) -> Self {
        Self { slope: self.slope * factor, floor: self.floor * factor }
    }

    /// Tolerance at a distance along the ray.
    pub fn at<R: Real>(self, distance: R) -> R {
        distance.mul_add(distance.uniform(self.slope), distance.uniform(self.floor))
    }
}
