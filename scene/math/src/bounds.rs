//! Axis-aligned boxes around shapes: a ray need not march outside them.
//!
//! Bounds follow from a shape's numbers alone, in plain `f32`. Before a ray is clipped by a box, the box is expanded
//! by far more than rounding errors, so that no surface is outside.

use crate::ray::Ray;
use crate::real::{Real, Vec3, vec3};

/// Axis-aligned box; a side may be infinitely distant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Minimum coordinates.
    pub min: Vec3<f32>,
    /// Maximum coordinates.
    pub max: Vec3<f32>,
}

impl Bounds {
    /// All of space.
    pub const INFINITE: Self = {
        const FAR: f32 = f32::INFINITY;
        Self { min: vec3(-FAR, -FAR, -FAR), max: vec3(FAR, FAR, FAR) }
    };

    /// Box without any point.
    pub const EMPTY: Self = {
        const FAR: f32 = 1e9;
        Self { min: vec3(FAR, FAR, FAR), max: vec3(-FAR, -FAR, -FAR) }
    };

    /// Box around the origin with these half extents.
    pub fn symmetric(x: f32, y: f32, z: f32) -> Self {
        Self { min: vec3(-x, -y, -z), max: vec3(x, y, z) }
    }

    /// Smallest box that contains both.
    pub fn union(self, other: Self) -> Self {
        Self { min: zip(self.min, other.min, f32::min), max: zip(self.max, other.max, f32::max) }
    }

    /// Intersection of two boxes.
    pub fn intersection(self, other: Self) -> Self {
        Self { min: zip(self.min, other.min, f32::max), max: zip(self.max, other.max, f32::min) }
    }

    /// Box with each side moved out by `margin`.
    pub fn expanded(self, margin: f32) -> Self {
        let Self { min: low, max: high } = self;
        Self { min: low.map(|c| c - margin), max: high.map(|c| c + margin) }
    }

    /// Box translated by a vector.
    pub fn translated(self, by: Vec3<f32>) -> Self {
        Self { min: zip(self.min, by, |c, by| c + by), max: zip(self.max, by, |c, by| c + by) }
    }

    /// Box scaled by `factor` about the origin.
    pub fn scaled(self, factor: f32) -> Self {
        let Self { min: low, max: high } = self;
        Self { min: low.map(|c| c * factor), max: high.map(|c| c * factor) }
    }

    /// Box around this box after its rotation by the matrix of these columns.
    pub fn rotated(self, columns: [Vec3<f32>; 3]) -> Self {
        let ends = [(self.min.x, self.max.x), (self.min.y, self.max.y), (self.min.z, self.max.z)];
        let mut rotated = Self { min: vec3(0.0, 0.0, 0.0), max: vec3(0.0, 0.0, 0.0) };
        for (column, (low, high)) in columns.into_iter().zip(ends) {
            let least = column.map(|c| product(c, low).min(product(c, high)));
            let most = column.map(|c| product(c, low).max(product(c, high)));
            rotated = Self { min: zip(rotated.min, least, |a, b| a + b), max: zip(rotated.max, most, |a, b| a + b) };
        }
        rotated
    }

    /// Box expanded by a fraction of its size and of its distance from `origin`, so that rounding along a ray from
    /// `origin` never puts a surface outside.
    pub fn with_margin(self, origin: Vec3<f32>) -> Self {
        const OF_SIZE: f32 = 1e-3;
        const OF_DISTANCE: f32 = 1e-5;
        let finite = |c: f32| if c.is_finite() { c.abs() } else { 0.0 };
        let far = [self.min, self.max, origin].map(|v| v.map(finite).max_element()).into_iter().fold(0.0, f32::max);
        let size = zip(self.max, self.min, |high, low| finite(high - low)).max_element();
        self.expanded(OF_SIZE * size + OF_DISTANCE * far)
    }

    /// Greatest distance between two boxes along an axis; negative if they overlap.
    pub fn gap(self, other: Self) -> f32 {
        let Vec3 { x, y, z } =
            zip(zip(self.min, other.max, |a, b| a - b), zip(other.min, self.max, |a, b| a - b), f32::max);
        x.max(y).max(z)
    }

    /// Boxes that contain all points that are in only one of two boxes: one for each side that differs.
    pub fn symmetric_difference(self, other: Self) -> Vec<Self> {
        let Self { min, max } = self.union(other);
        let (inner_min, inner_max) = (zip(self.min, other.min, f32::max), zip(self.max, other.max, f32::min));
        let below = |end: Vec3<f32>| Self { min, max: end };
        let above = |start: Vec3<f32>| Self { min: start, max };
        let sides = [
            (min.x < inner_min.x, below(vec3(inner_min.x, max.y, max.z))),
            (min.y < inner_min.y, below(vec3(max.x, inner_min.y, max.z))),
            (min.z < inner_min.z, below(vec3(max.x, max.y, inner_min.z))),
            (inner_max.x < max.x, above(vec3(inner_max.x, min.y, min.z))),
            (inner_max.y < max.y, above(vec3(min.x, inner_max.y, min.z))),
            (inner_max.z < max.z, above(vec3(min.x, min.y, inner_max.z))),
        ];
        sides.into_iter().filter(|(differs, _)| *differs).map(|(_, side)| side).collect()
    }

    /// Distance between opposite corners.
    pub fn diagonal(self) -> f32 {
        zip(self.max, self.min, |high, low| high - low).length()
    }

    /// Box with infinite sides replaced by finite ones far beyond all coordinates.
    pub fn clamped_to_finite(self) -> Self {
        const FINITE_LIMIT: f32 = 1e12;
        let ended = |c: f32| c.clamp(-FINITE_LIMIT, FINITE_LIMIT);
        Self { min: self.min.map(ended), max: self.max.map(ended) }
    }

    /// Whether the box contains a point.
    pub fn contains(self, p: Vec3<f32>) -> bool {
        let between = |low: f32, c: f32, high: f32| low <= c && c <= high;
        between(self.min.x, p.x, self.max.x)
            && between(self.min.y, p.y, self.max.y)
            && between(self.min.z, p.z, self.max.z)
    }

    /// Whether the box is bounded in every direction.
    pub fn is_finite(self) -> bool {
        [self.min, self.max]
            .into_iter()
            .all(|corner| corner.x.is_finite() && corner.y.is_finite() && corner.z.is_finite())
    }

    /// Lower bound of the distance from `p` to any point of the box: the largest coordinate difference along an axis,
    /// less a hundredth of the box's size.
    pub fn distance_lower_bound<R: Real>(&self, p: Vec3<R>) -> R {
        let half = zip(self.max, self.min, |high, low| (high - low) * 0.5);
        let middle = zip(self.max, self.min, |high, low| (high + low) * 0.5);
        let half = half.map(|c| c + 0.02 * half.max_element());
        let away = p - Vec3::uniform(p.x, middle);
        (vec3(away.x.abs(), away.y.abs(), away.z.abs()) - Vec3::uniform(p.x, half)).max_element()
    }

    /// Interval of the ray inside the box, clamped to 0..`farthest`. For a ray that misses the box, the end is less
    /// than the start.
    pub fn intersect_ray<R: Real>(&self, ray: &Ray<R>, farthest: R) -> (R, R) {
        let (low, high) = (Vec3::uniform(farthest, self.min), Vec3::uniform(farthest, self.max));
        let zero = farthest.constant(0.0);
        let (x_in, x_out) = slab_interval(low.x, high.x, ray.origin.x, ray.direction.x);
        let (y_in, y_out) = slab_interval(low.y, high.y, ray.origin.y, ray.direction.y);
        let (z_in, z_out) = slab_interval(low.z, high.z, ray.origin.z, ray.direction.z);
        (x_in.max(y_in).max(z_in.max(zero)), x_out.min(y_out).min(z_out.min(farthest)))
    }
}

/// Interval of t in which `origin + slope · t` is between `low` and `high`.
fn slab_interval<R: Real>(low: R, high: R, origin: R, slope: R) -> (R, R) {
    let per_slope = per_slope(slope);
    let (a, b) = ((low - origin) * per_slope, (high - origin) * per_slope);
    (a.min(b), a.max(b))
}

/// 1 over the slope of a ray along an axis.
pub fn per_slope<R: Real>(slope: R) -> R {
    // Replaces a slope of 0, so that the quotient exists.
    const PARALLEL_EPSILON: f32 = 1e-12;
    let slope = R::select(slope.abs().below(PARALLEL_EPSILON), slope.constant(PARALLEL_EPSILON), slope);
    slope.constant(1.0) / slope
}

fn zip(a: Vec3<f32>, b: Vec3<f32>, f: impl Fn(f32, f32) -> f32) -> Vec3<f32> {
    vec3(f(a.x, b.x), f(a.y, b.y), f(a.z, b.z))
}

/// Product in which 0 times infinity is 0.
fn product(a: f32, b: f32) -> f32 {
    if a == 0.0 { 0.0 } else { a * b }
}
