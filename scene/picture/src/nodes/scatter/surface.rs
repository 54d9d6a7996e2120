//! The surface on which copies are scattered: the first point below a position, by sphere tracing.

use crate::bounds::Bounds;
use crate::limits::MAX_LENGTH;
use crate::nodes::Node;
use crate::real::{Vec3, vec3};

/// Maximum number of evaluations for one position.
const MAX_STEPS: u32 = 256;
/// Minimum of the step scale. A shape with a larger Lipschitz factor is rarely that steep along a vertical line, and a
/// step that passes its surface is halved until it ends there.
const MIN_STEP_SCALE: f32 = 0.25;
/// Distance from the surface that counts as on it, as a fraction of the largest coordinate, which is at least 1.
const TOLERANCE: f32 = 4e-6;

/// A shape below positions, and the evaluations that are left.
#[derive(Debug)]
pub(super) struct SurfaceBelow<'a> {
    shape: &'a Node,
    bounds: Bounds,
    /// Height from which rays start: above the region and, if it has a top, the shape.
    top: f32,
    step_scale: f32,
    evaluations_left: u64,
    /// Number of positions that were tried, and of those that are above no surface.
    tried: u64,
    missed: u64,
}

impl<'a> SurfaceBelow<'a> {
    /// The surface of a shape below a region that ends at a height, for at most `evaluations_left` evaluations.
    pub(super) fn new(shape: &'a Node, region_top: f32, evaluations_left: u64) -> Self {
        let bounds = shape.bounds(0.0);
        let top = if bounds.max.y.is_finite() { region_top.max(bounds.max.y) } else { region_top };
        Self {
            shape,
            bounds,
            top: top.min(MAX_LENGTH),
            step_scale: (1.0 / shape.lipschitz()).max(MIN_STEP_SCALE),
            evaluations_left,
            tried: 0,
            missed: 0,
        }
    }

    /// Whether evaluations are left.
    pub(super) fn has_evaluations(&self) -> bool {
        self.evaluations_left > 0
    }

    /// Whether most positions are above no surface.
    pub(super) fn is_missed(&self) -> bool {
        self.missed > self.tried / 2
    }

    /// The highest point of the surface at the position's x and z, if there is one.
    pub(super) fn below(&mut self, position: Vec3<f32>) -> Option<Vec3<f32>> {
        let found = self.find(position);
        self.tried += 1;
        self.missed += u64::from(found.is_none());
        found
    }

    fn find(&mut self, position: Vec3<f32>) -> Option<Vec3<f32>> {
        let mut p = vec3(position.x, self.top, position.z);
        let (mut is_above, mut above, mut below) = (false, self.top, None);
        for _ in 0..MAX_STEPS {
            self.evaluations_left = self.evaluations_left.checked_sub(1)?;
            let distance = self.shape.distance(p);
            let tolerance = TOLERANCE * p.map(f32::abs).max_element().max(1.0);
            if distance.abs() <= tolerance {
                return Some(p);
            }
            // A ray that starts inside an endless shape first leaves it upward.
            is_above |= distance > 0.0;
            if distance > 0.0 {
                above = p.y;
            } else if is_above {
                below = Some(p.y);
            }
            if let Some(below) = below {
                let middle = 0.5 * (above + below);
                if middle == above || middle == below {
                    return Some(p);
                }
                p.y = middle;
                continue;
            }
            p.y -= distance * self.step_scale;
            let is_below = is_above && self.bounds.min.y.is_finite() && p.y < self.bounds.min.y - tolerance;
            if p.y.abs() > MAX_LENGTH || is_below {
                return None;
            }
        }
        None
    }
}
