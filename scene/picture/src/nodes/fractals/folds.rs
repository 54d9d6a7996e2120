//! Reflections that fold space onto a part of it: each preserves lengths and is continuous.

use crate::real::{Real, Vec3, vec3};

/// The nearer to (1, 1, 1) of a point and its mirror image across the plane between two corners of a tetrahedron, (1,
/// 1, 1) and another. `a` and `b` are the coordinates in which the corners differ.
fn to_corner<R: Real>(a: R, b: R) -> (R, R) {
    let is_beyond = (a + b).below(0.0);
    (R::select(is_beyond, -b, a), R::select(is_beyond, -a, b))
}

/// Folds a tetrahedron with corners (1, 1, 1), (1, −1, −1), (−1, 1, −1), (−1, −1, 1) onto the
/// quarter around its corner (1, 1, 1).
pub(super) fn tetrahedral<R: Real>(p: Vec3<R>) -> Vec3<R> {
    let (x, y) = to_corner(p.x, p.y);
    let (x, z) = to_corner(x, p.z);
    let (y, z) = to_corner(y, z);
    vec3(x, y, z)
}

/// Folds an octahedron, or a cube, onto a 48th of it: x ≥ y ≥ z ≥ 0.
pub(super) fn octahedral<R: Real>(p: Vec3<R>) -> Vec3<R> {
    let (x, y, z) = (p.x.abs(), p.y.abs(), p.z.abs());
    let (x, y) = (x.max(y), x.min(y));
    let (x, z) = (x.max(z), x.min(z));
    vec3(x, y.max(z), y.min(z))
}

/// The median of three numbers.
pub(super) fn middle<R: Real>(p: Vec3<R>) -> R {
    p.x.min(p.y).max(p.x.max(p.y).min(p.z))
}
