//! Placements of lights and the camera: where their groups are.

use serde::Serialize;

use super::{Angles, Direction, Point, sin_cos_degrees};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;

/// A rotation and an offset of a light or the camera: that of its group.
#[derive(Clone, Debug, PartialEq, Serialize, Seek)]
pub struct Placement {
    /// Offset, in scene units.
    pub by: Option<Point>,
    /// Angles, in degrees.
    pub degrees: Option<Angles>,
    /// Axis of the rotation, if there is one angle.
    pub axis: Option<Direction>,
    /// Point that the rotation leaves in place.
    pub about: Option<Point>,
}

impl Placement {
    /// Rows of the inverse rotation's matrix.
    fn inverse_rows(&self) -> Option<[Vec3<f32>; 3]> {
        Some(match self.degrees.as_ref()? {
            Angles::Fixed(rotation) => rotation.inverse_rows(),
            Angles::About(degrees) => {
                let axis = self.axis.as_ref().map_or(vec3(0.0, 1.0, 0.0), Direction::unit);
                inverse_rows_about(axis, degrees.in_frame())
            }
        })
    }

    /// A point of the scene, as seen from inside the group.
    pub(crate) fn to_group<R: Real>(&self, p: Vec3<R>) -> Vec3<R> {
        let p = self.by.as_ref().map_or(p, |by| p - Vec3::uniform(p.x, by.get()));
        let Some([x, y, z]) = self.inverse_rows() else { return p };
        let rotated = |p: Vec3<R>| vec3(p.dot_uniform(x), p.dot_uniform(y), p.dot_uniform(z));
        self.about.as_ref().map_or_else(
            || rotated(p),
            |about| {
                let about = Vec3::uniform(p.x, about.get());
                rotated(p - about) + about
            },
        )
    }

    /// A direction of the group, as seen in the scene.
    pub(crate) fn direction_to_scene<R: Real>(&self, d: Vec3<R>) -> Vec3<R> {
        let Some([x, y, z]) = self.inverse_rows() else { return d };
        let column = |axis: fn(Vec3<f32>) -> f32| vec3(axis(x), axis(y), axis(z));
        vec3(d.dot_uniform(column(|v| v.x)), d.dot_uniform(column(|v| v.y)), d.dot_uniform(column(|v| v.z)))
    }

    /// A point of the group, as seen in the scene.
    pub(crate) fn to_scene(&self, p: Vec3<f32>) -> Vec3<f32> {
        let about = self.about.as_ref().map_or(vec3(0.0, 0.0, 0.0), Point::in_frame);
        let by = self.by.as_ref().map_or(vec3(0.0, 0.0, 0.0), Point::in_frame);
        self.direction_to_scene(p - about) + about + by
    }
}

/// Rows of the inverse of a rotation about a unit axis: the columns of Rodrigues' matrix
/// cos θ·I + sin θ·[k]× + (1 − cos θ)·k·kᵀ.
pub(crate) fn inverse_rows_about(k: Vec3<f32>, degrees: f32) -> [Vec3<f32>; 3] {
    let (s, c) = sin_cos_degrees(degrees);
    [vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), vec3(0.0, 0.0, 1.0)]
        .map(|e| e * c + k.cross(e) * s + k * ((1.0 - c) * k.dot(e)))
}
