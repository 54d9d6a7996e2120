//! The shapes of lights that have a size: their points are sampled, and rays meet those that are visible.

use std::f32::consts::PI;

use super::direction_around;
use crate::materials::microfacet::orthonormal_basis;
use crate::ray::Ray;
use crate::real::{Real, Vec3};

/// Distance along a ray that does not meet a light.
pub const NEVER: f32 = 1e30;

/// The shape of a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightShape {
    /// A ball.
    Sphere {
        /// Center.
        center: Vec3<f32>,
        /// Radius.
        radius: f32,
    },
    /// A flat shape, which shines to the side of its normal.
    Flat {
        /// Center.
        center: Vec3<f32>,
        /// Direction in which it shines, of length 1.
        normal: Vec3<f32>,
        /// Directions of length 1 in its plane: along the width and the height of a rectangle.
        sides: [Vec3<f32>; 2],
        /// Outline in that plane.
        outline: Outline,
    },
}

/// The outline of a flat light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outline {
    /// Half the width and half the height.
    Rectangle([f32; 2]),
    /// Radius.
    Disc(f32),
}

/// A light that rays meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightBody {
    /// Its shape.
    pub shape: LightShape,
    /// Its radiance.
    pub radiance: Vec3<f32>,
}

/// A point of a light, as seen from another point.
pub struct PointOfLight<R> {
    /// Toward the point.
    pub direction: Vec3<R>,
    /// Distance of the point.
    pub distance: R,
    /// Solid angle that the light covers, or would if all of it were as that point: 1 over the density of the point. 0
    /// where the point does not shine.
    pub solid_angle: R,
}

impl LightBody {
    /// Light that arrives from it, over π, if all of its solid angle shines.
    pub fn arriving<R: Real>(&self, solid_angle: R) -> Vec3<R> {
        Vec3::uniform(solid_angle, self.radiance) * (solid_angle * (1.0 / PI))
    }
}

impl Outline {
    /// Largest distance from the center.
    pub fn radius(self) -> f32 {
        match self {
            Self::Rectangle([x, y]) => Real::sqrt(x * x + y * y),
            Self::Disc(radius) => radius,
        }
    }

    /// Area in square scene units.
    pub fn area(self) -> f32 {
        match self {
            Self::Rectangle([x, y]) => 4.0 * x * y,
            Self::Disc(radius) => PI * radius * radius,
        }
    }
}

impl LightShape {
    /// The point that a pair of numbers from 0 to 1 chooses, as seen from `p`.
    pub fn sample<R: Real>(&self, p: Vec3<R>, (u, v): (R, R)) -> PointOfLight<R> {
        match *self {
            // Peter Shirley, Changyaw Wang, Kurt Zimmerman, "Monte Carlo techniques for direct lighting calculations",
            // ACM Transactions on Graphics 15(1), 1996: directions are sampled in the cone that the ball covers.
            Self::Sphere { center, radius } => {
                let toward = Vec3::uniform(p.x, center) - p;
                let radius = p.x.uniform(radius);
                // Inside the ball, light comes from a full half-space.
                let distance = toward.length().max(radius);
                let axis = (toward * (p.x.constant(1.0) / distance)).normalize();
                let versine_of_edge = versine_of_edge(radius, distance);
                let (right, up) = orthonormal_basis(axis);
                let direction = direction_around(axis, right, up, u * versine_of_edge, v);
                let along = direction.dot(toward);
                let to_surface = along - (radius.square() - (distance.square() - along.square())).sqrt();
                PointOfLight {
                    direction,
                    distance: to_surface.at_least(1e-6),
                    solid_angle: versine_of_edge * (2.0 * PI),
                }
            }
            Self::Flat { center, normal, sides: [right, up], outline } => {
                let (x, y) = match outline {
                    Outline::Rectangle([x, y]) => ((u * 2.0 - 1.0) * u.uniform(x), (v * 2.0 - 1.0) * u.uniform(y)),
                    Outline::Disc(radius) => {
                        let away = u.sqrt() * u.uniform(radius);
                        let (sine, cosine) = v.sin_cos_turns();
                        (away * cosine, away * sine)
                    }
                };
                let flat = Vec3::uniform(u, right).mul_add(x, Vec3::uniform(u, up) * y);
                let toward = Vec3::uniform(u, center) + flat - p;
                let distance = toward.length().at_least(1e-6);
                let direction = toward * (u.constant(1.0) / distance);
                let cosine = (-direction.dot_uniform(normal)).at_least(0.0);
                let solid_angle = cosine * u.uniform(outline.area()) / distance.square();
                PointOfLight { direction, distance, solid_angle }
            }
        }
    }

    /// Distance at which a ray meets the light from either side; [`NEVER`] if it does not, or starts inside a ball.
    pub fn distance_along<R: Real>(&self, ray: &Ray<R>) -> R {
        let never = ray.origin.x.constant(NEVER);
        match *self {
            Self::Sphere { center, radius } => {
                let toward = Vec3::uniform(never, center) - ray.origin;
                let along = toward.dot(ray.direction);
                let beside = ray.direction.mul_add(-along, toward).length_squared();
                let square = never.uniform(radius * radius);
                let distance = along - (square - beside).sqrt();
                R::select(beside.lt(square) & distance.above(0.0), distance, never)
            }
            Self::Flat { center, normal, sides: [right, up], outline } => {
                let toward = Vec3::uniform(never, center) - ray.origin;
                let across = ray.direction.dot_uniform(normal);
                let is_level = across.abs().below(1e-7);
                let distance = toward.dot_uniform(normal) / R::select(is_level, never.constant(1e-7), across);
                let from_center = ray.direction.mul_add(distance, -toward);
                let (x, y) = (from_center.dot_uniform(right), from_center.dot_uniform(up));
                let is_within = match outline {
                    Outline::Rectangle([width, height]) => x.abs().lt(x.uniform(width)) & y.abs().lt(x.uniform(height)),
                    Outline::Disc(radius) => x.square_add(y.square()).lt(x.uniform(radius * radius)),
                };
                R::select(is_within & distance.above(1e-5) & !is_level, distance, never)
            }
        }
    }

    /// Whether the side that a ray in this direction meets shines.
    pub fn shines_against<R: Real>(&self, direction: Vec3<R>) -> R::Mask {
        match self {
            Self::Sphere { .. } => direction.x.constant(0.0).below(1.0),
            Self::Flat { normal, .. } => direction.dot_uniform(*normal).below(0.0),
        }
    }

    /// Density, per steradian, with which `sample` chooses a direction from `p` that meets the light at a distance.
    pub fn density<R: Real>(&self, p: Vec3<R>, direction: Vec3<R>, distance: R) -> R {
        let zero = distance.constant(0.0);
        match *self {
            Self::Sphere { center, radius } => {
                let away = (Vec3::uniform(zero, center) - p).length();
                let radius = zero.uniform(radius);
                let versine = versine_of_edge(radius, away.max(radius));
                let density = zero.constant(0.5 / PI) / versine.at_least(1e-12);
                R::select(radius.lt(away), density, zero)
            }
            Self::Flat { normal, outline, .. } => {
                let cosine = (-direction.dot_uniform(normal)).at_least(1e-6);
                distance.square() / (cosine * zero.uniform(outline.area()))
            }
        }
    }
}

/// 1 − the cosine of half the angle that a ball covers.
fn versine_of_edge<R: Real>(radius: R, distance: R) -> R {
    let one = radius.constant(1.0);
    let sine = (radius / distance).at_most(1.0);
    sine.square() / (one + (one - sine.square()).sqrt())
}
