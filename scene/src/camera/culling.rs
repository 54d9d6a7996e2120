//! View culling: tests by bounding boxes whether the picture can show an object.

use super::{Project, View};
use crate::bounds::Bounds;
use crate::real::{Vec3, vec3};

impl View {
    /// Whether no ray of the picture hits the box at any distance. May be false although no ray does.
    pub(crate) fn is_outside_view(&self, bounds: Bounds) -> bool {
        if is_empty(bounds) {
            return true;
        }
        let bounds = bounds.with_margin(self.origin);
        self.projection.is_beside(self, bounds)
    }

    /// Whether no ray of the picture reaches the box within this distance.
    pub(crate) fn is_farther_than(&self, bounds: Bounds, distance: f32) -> bool {
        if is_empty(bounds) {
            return false;
        }
        let bounds = bounds.with_margin(self.origin);
        self.projection.is_beyond(self, bounds, distance)
    }

    /// Whether all of a box is farther from the camera than this.
    pub(super) fn is_out_of_reach(&self, bounds: Bounds, distance: f32) -> bool {
        let Bounds { min: low, max: high } = bounds.translated(-self.origin);
        let away = |low: f32, high: f32| low.max(-high).max(0.0);
        vec3(away(low.x, high.x), away(low.y, high.y), away(low.z, high.z)).length() > distance
    }

    /// Box around another box in orthographic view space: −1 to 1 across and up, and the distance in front of the
    /// camera.
    pub(super) fn to_view_space(&self, bounds: Bounds) -> Bounds {
        let (right, up, forward) = (inverse_extent(self.right), inverse_extent(self.up), self.forward);
        bounds.translated(-self.origin).rotated([
            vec3(right.x, up.x, forward.x),
            vec3(right.y, up.y, forward.y),
            vec3(right.z, up.z, forward.z),
        ])
    }

    /// Whether a plane separates a box, relative to the camera position, from the picture's pyramid: a side of the
    /// pyramid, or a side of the box.
    pub(super) fn is_outside_pyramid(&self, bounds: Bounds) -> bool {
        let (right, up, forward) = (inverse_extent(self.right), inverse_extent(self.up), self.forward);
        let sides = [forward, forward + right, forward - right, forward + up, forward - up];
        if sides.into_iter().any(|side| support(bounds, side) < 0.0) {
            return true;
        }
        let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]
            .map(|(across, upwards)| forward + self.right * across + self.up * upwards);
        let leaves = |along: fn(Vec3<f32>) -> f32| {
            (along(bounds.max) < 0.0 && corners.iter().all(|&corner| along(corner) >= 0.0))
                || (along(bounds.min) > 0.0 && corners.iter().all(|&corner| along(corner) <= 0.0))
        };
        leaves(|v| v.x) || leaves(|v| v.y) || leaves(|v| v.z)
    }
}

fn is_empty(Bounds { min: low, max: high }: Bounds) -> bool {
    low.x > high.x || low.y > high.y || low.z > high.z
}

/// Vector whose dot product with `extent` is 1.
fn inverse_extent(extent: Vec3<f32>) -> Vec3<f32> {
    extent * (1.0 / extent.length_squared().max(1e-30))
}

/// Support function of a box: its maximum dot product with a vector.
fn support(bounds: Bounds, along: Vec3<f32>) -> f32 {
    let Vec3 { x, y, z } = along;
    bounds.rotated([vec3(x, 0.0, 0.0), vec3(y, 0.0, 0.0), vec3(z, 0.0, 0.0)]).max.x
}
