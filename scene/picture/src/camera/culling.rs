//! View culling: tests by bounding boxes whether the picture can show an object.

use super::View;
use crate::bounds::Bounds;
use crate::real::{Vec3, vec3};

impl View {
    /// Whether no ray of the picture hits the box at any distance. May be false although no ray does.
    pub fn is_outside_view(&self, bounds: Bounds) -> bool {
        if is_empty(bounds) {
            return true;
        }
        self.projection.is_beside(self, self.with_margin(bounds))
    }

    /// Whether no ray of the picture reaches the box within this distance.
    pub fn is_farther_than(&self, bounds: Bounds, distance: f32) -> bool {
        if is_empty(bounds) {
            return false;
        }
        // A ray starts up to the lens' radius nearer.
        let (bounds, distance) = (self.with_margin(bounds), distance + self.lens_radius());
        if self.is_parallel() {
            return self.to_view_space(bounds).min.z > distance;
        }
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

    /// Whether a plane separates a box, relative to the camera position, from all that rays of the picture's pyramid
    /// meet: a side of what they meet, or a side of the box.
    ///
    /// At a depth z, rays through a lens of the radius r are up to r·|z − f|/f beside those through its center, where f
    /// is the distance of the plane of focus.
    pub(super) fn is_outside_pyramid(&self, bounds: Bounds) -> bool {
        let (right, up, forward) = (inverse_extent(self.right), inverse_extent(self.up), self.forward);
        let (radius, per_focus) = self.lens.as_ref().map_or((0.0, 0.0), |lens| (lens.radius(), 1.0 / lens.focus()));
        let is_before = |side: Vec3<f32>| {
            // The radius over the picture's half extent at distance 1, which `side` is the inverse of.
            let wider = radius * side.length();
            let beyond_focus = support(bounds, forward * (1.0 + wider * per_focus) + side) < wider;
            beyond_focus && support(bounds, forward * (1.0 - wider * per_focus) + side) < -wider
        };
        if support(bounds, forward) < 0.0 || [right, -right, up, -up].into_iter().any(is_before) {
            return true;
        }
        let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]
            .map(|(across, upwards)| forward + self.right * across + self.up * upwards);
        let slant = radius * per_focus;
        let leaves = |along: fn(Vec3<f32>) -> f32| {
            (along(bounds.max) < -radius && corners.iter().all(|&corner| along(corner) >= slant))
                || (along(bounds.min) > radius && corners.iter().all(|&corner| along(corner) <= -slant))
        };
        leaves(|v| v.x) || leaves(|v| v.y) || leaves(|v| v.z)
    }

    /// How far rays of a point of an orthographic picture may be from its central ray in a box in view space: to the
    /// right and up, in halves of the picture.
    pub(super) fn blur_in_view_space(&self, seen: Bounds) -> (f32, f32) {
        let Some(lens) = &self.lens else { return (0.0, 0.0) };
        let from_focus = |z: f32| (z.max(0.0) - lens.focus()).abs();
        let blur = lens.radius() / lens.focus() * from_focus(seen.min.z).max(from_focus(seen.max.z));
        (blur / self.right.length(), blur / self.up.length())
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
