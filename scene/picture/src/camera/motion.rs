//! Motion in the picture: the way of a point of it from one frame to the next, in pixels to the right and up.
//!
//! Both points are computed by the same formula, so that what does not move has a way of exactly 0.

use super::{CameraAxes, View};
use crate::real::{Real, Vec3};

impl View {
    /// The way of what is at a point of space in this frame and at another in the next, which has the camera `next`.
    pub fn way_of_point<R: Real>(&self, next: &Self, [now, then]: [Vec3<R>; 2]) -> (R, R) {
        let seen = |view: &Self, p: Vec3<R>| {
            view.projection.picture_point(&view.measuring_axes(p.x), p - Vec3::uniform(p.x, view.origin))
        };
        self.way_in_pixels(seen(self, now), seen(next, then))
    }

    /// The way of the background in a direction.
    pub fn way_of_background<R: Real>(&self, next: &Self, direction: Vec3<R>) -> (R, R) {
        let seen = |view: &Self| {
            if view.is_parallel() {
                // The background is the same everywhere in the picture.
                return (direction.x.constant(0.0), direction.x.constant(0.0));
            }
            view.projection.picture_point(&view.measuring_axes(direction.x), direction)
        };
        self.way_in_pixels(seen(self), seen(next))
    }

    /// The camera's axes, with which scalar products are coordinates in the picture.
    fn measuring_axes<R: Real>(&self, like: R) -> CameraAxes<R> {
        let per_square = |axis: Vec3<f32>| Vec3::uniform(like, axis * (1.0 / axis.length_squared()));
        let [origin, forward] = [self.origin, self.forward].map(|vector| Vec3::uniform(like, vector));
        CameraAxes { origin, forward, right: per_square(self.right), up: per_square(self.up) }
    }

    fn way_in_pixels<R: Real>(&self, (across, up): (R, R), (next_across, next_up): (R, R)) -> (R, R) {
        let across = self.projection.way_across(next_across - across);
        (across * across.uniform(1.0 / self.scale.0), (next_up - up) * up.uniform(-1.0 / self.scale.1))
    }
}
