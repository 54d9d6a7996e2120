//! The slanted faces of pyramids.

use crate::real::Real;

/// Slanted face of a pyramid: a triangle from an edge of the base to the apex, in its own coordinates.
///
/// The base is on y = 0 and the apex above its center. The coordinates of a point are its distance outward from the
/// axis, its position along the edge from the edge's center, and its height.
#[derive(Clone, Copy, Debug)]
pub(super) struct PyramidFace {
    /// Distance of the base's edge from the axis.
    inradius: f32,
    /// Half of that edge.
    half_edge: f32,
    /// Length of the slanted edge, from a corner to the apex.
    slant: f32,
    /// Normal of the face, out and up.
    normal: (f32, f32),
    /// Direction of its slanted edge within the face: along and up the face.
    side: (f32, f32),
}

impl PyramidFace {
    /// A face of a pyramid of this height.
    pub(super) fn new(inradius: f32, half_edge: f32, height: f32) -> Self {
        let rise = Real::sqrt(inradius * inradius + height * height);
        let slant = Real::sqrt(half_edge * half_edge + rise * rise);
        let normal = (height / rise, inradius / rise);
        let side = (rise / slant, half_edge / slant);
        Self { inradius, half_edge, slant, normal, side }
    }

    /// Squared distance to the triangle, for points next to the half of it with positive `along`, and the signed
    /// distance of the point from its plane. Below the edge of the base it is at most the distance to the corner,
    /// because the base is nearer there.
    pub(super) fn distance_and_depth<R: Real>(&self, out: R, along: R, height: R) -> (R, R) {
        let (across, up) = (out.uniform(self.normal.0), out.uniform(self.normal.1));
        let from_edge = out - out.uniform(self.inradius);
        let before = from_edge.mul_add(across, height * up);
        let climbed = height.mul_add(across, -(from_edge * up));
        let from_corner = along - out.uniform(self.half_edge);
        let (sideways, upwards) = (out.uniform(self.side.0), out.uniform(self.side.1));
        let past_slant = from_corner.mul_add(sideways, climbed * upwards);
        let along_slant = climbed.mul_add(sideways, -(from_corner * upwards));
        let past_end = along_slant - along_slant.at_least(0.0).min(out.uniform(self.slant));
        let to_slant = past_slant.square_add(past_end.square());
        let is_beside = past_slant.max(-climbed).above(0.0);
        (before.square_add(R::select(is_beside, to_slant, out.constant(0.0))), before)
    }
}
