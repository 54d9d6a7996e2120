//! Straight edges of an outline.

use crate::real::{FunctionKey, Real};

/// State of a scan over an outline's edges: the squared distance to the nearest edge so far, and a sign that
/// changes at each edge that a ray to the right crosses.
pub(super) type EdgeScan<R> = (R, R);

/// An edge from one corner to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Edge {
    pub(super) from: [f32; 2],
    pub(super) to: [f32; 2],
    /// One over the square of its length.
    over_square: f32,
}

impl Edge {
    pub(super) fn new(from: [f32; 2], to: [f32; 2]) -> Self {
        let (x, y) = (to[0] - from[0], to[1] - from[1]);
        Self { from, to, over_square: 1.0 / (x * x + y * y).max(1e-30) }
    }

    /// Adds this edge to a scan.
    ///
    /// Inigo Quilez, "2D distance functions": <https://iquilezles.org/articles/distfunctions2d/>.
    pub(super) fn scan<R: Real>(&self, x: R, y: R, found: EdgeScan<R>) -> EdgeScan<R> {
        let Self { from, to, over_square } = *self;
        x.call(
            FunctionKey::new("outline_edge"),
            (
                (x, y),
                found,
                (x.uniform(from[0]), x.uniform(from[1])),
                (x.uniform(to[0] - from[0]), x.uniform(to[1] - from[1])),
                (x.uniform(over_square), x.uniform(to[1])),
            ),
            |((x, y), (nearest, sign), (from_x, from_y), (along_x, along_y), (over_square, to_y))| {
                let (off_x, off_y) = (x - from_x, y - from_y);
                let share = (off_x.mul_add(along_x, off_y * along_y) * over_square).at_least(0.0).at_most(1.0);
                let (to_edge_x, to_edge_y) = (off_x - share * along_x, off_y - share * along_y);
                let square = to_edge_x.square_add(to_edge_y.square());
                let is_left = (along_y * off_x).lt(along_x * off_y);
                (nearest.min(square), R::select(is_crossed(y, from_y, to_y, is_left), -sign, sign))
            },
        )
    }
}

/// Whether a ray to the right from a point at height `y` crosses an edge: upwards with the point
/// on its left, or downwards with it on its right.
pub(super) fn is_crossed<R: Real>(y: R, from_y: R, to_y: R, is_left: R::Mask) -> R::Mask {
    let (is_from_above, is_to_above) = (y.lt(from_y), y.lt(to_y));
    (!is_from_above & is_to_above & is_left) | (is_from_above & !is_to_above & !is_left)
}
