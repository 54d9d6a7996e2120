//! Boxes of large objects along a ray: a march evaluates such an object only where the ray is in its box.

use super::Integrator;
use super::ray_kinds::RayFunction;
use crate::bounds::{Bounds, per_slope};
use crate::march::Part;
use crate::nodes::Node;
use crate::ray::Ray;
use crate::real::list::is_set;
use crate::real::{Real, Vec3, vec3};
use crate::scene::Scene;

/// Least number of nodes of an object that is evaluated only in its box. With smaller ones, a march by distances alone is
/// faster (measured on CPUs and a GPU with the shipped scenes).
const MIN_NODES: u32 = 24;
/// Greatest number of boxes: each has a bit of a number.
const MAX_BOXES: usize = 30;
/// A length beyond all others: of a ray that meets no box.
const NEVER: f32 = 1e9;

/// Boxes of large objects.
#[derive(Clone, Debug)]
pub(super) struct RayBoxes {
    /// The box of each bit.
    boxes: Vec<Bounds>,
    /// Each object's bit; `None` if it has no box.
    bits: Vec<Option<u32>>,
}

/// A ray from a point on, with what its intersections with boxes need.
struct RayFromPoint<R> {
    /// 1 over each component of its direction, and the point times that.
    per_direction: Vec3<R>,
    scaled_point: Vec3<R>,
}

impl<R: Real> RayFromPoint<R> {
    fn new(point: Vec3<R>, direction: Vec3<R>) -> Self {
        let per_direction = direction.map(per_slope);
        Self { per_direction, scaled_point: point.mul_elementwise(per_direction) }
    }

    /// Lengths until it enters a box, negative inside, and until it leaves the box. A ray that misses it never enters. Each
    /// length follows, to the bit, from the one side that is crossed.
    fn chord(&self, bounds: Bounds) -> (R, R) {
        let like = self.per_direction.x;
        let to_corner =
            |at: Vec3<f32>| Vec3::uniform(like, at).mul_add_elementwise(self.per_direction, -self.scaled_point);
        let (low, high) = (to_corner(bounds.min), to_corner(bounds.max));
        let enters = vec3(low.x.min(high.x), low.y.min(high.y), low.z.min(high.z)).max_element();
        let leaves = vec3(low.x.max(high.x), low.y.max(high.y), low.z.max(high.z)).min_element();
        let meets = enters.lt(leaves) & leaves.above(0.0);
        (R::select(meets, enters, like.constant(NEVER)), leaves)
    }
}

impl RayBoxes {
    /// The boxes of the large ones of some objects, given the bounds by which objects are culled; `None` if there are none.
    /// `error` is that of coordinates. In an animated job, the same objects have boxes in all frames.
    pub(super) fn new(scene: &Scene, surfaces: &[usize], cull_bounds: &[Option<Bounds>], error: f32) -> Option<Self> {
        let (mut boxes, mut bits) = (Vec::new(), vec![None; scene.objects.len()]);
        // If an edit moves the sides of a box, all rays through these change. So an object of parts that one moves has none.
        let is_boxed = |shape: &Node| shape.node_count() >= MIN_NODES && !shape.is_union();
        for &object in surfaces.iter().filter(|&&object| is_boxed(&scene.objects[object].shape)) {
            if let Some(bounds) = cull_bounds[object].filter(|_| boxes.len() < MAX_BOXES) {
                bits[object] = Some(boxes.len() as u32);
                boxes.push(with_margin(bounds, error));
            }
        }
        (!boxes.is_empty()).then_some(Self { boxes, bits })
    }

    /// The boxes, by their bits.
    pub(super) fn boxes(&self) -> &[Bounds] {
        &self.boxes
    }

    /// The bit of an object's box, if it has one.
    pub(super) fn bit(&self, object: usize) -> Option<u32> {
        self.bits[object]
    }

    /// The bits of all boxes, as a number's bits.
    pub(super) fn all<R: Real>(like: R) -> R {
        like.constant(f32::from_bits((1 << MAX_BOXES) - 1))
    }

    /// Whether an object is evaluated, given the bits of boxes; `None` if it always is.
    pub(super) fn is_evaluated<R: Real>(&self, object: usize, inside: R) -> Option<R::Mask> {
        self.bit(object).map(|bit| is_set::<R>(inside.to_bits(), bit))
    }
}

/// A little larger, so that rounding puts no point of the surface outside. Each side follows from its own coordinate, so that
/// a ray's way through the others does not depend on it.
fn with_margin(bounds: Bounds, error: f32) -> Bounds {
    /// Of a coordinate.
    const ERROR: f32 = 1e-5;
    let margin = |coordinate: f32| 4.0 * error + ERROR * coordinate.abs();
    Bounds { min: bounds.min.map(|low| low - margin(low)), max: bounds.max.map(|high| high + margin(high)) }
}

impl Integrator<'_> {
    /// The part of a ray from a point on in which it is in the same boxes. Their bits are the part's formula.
    pub(super) fn enter_boxes<R: Real>(&self, boxes: &RayBoxes, ray: &Ray<R>, t: R, farthest: R) -> Part<R> {
        farthest.call(self.key(RayFunction::EnterBoxes), (*ray, t, farthest), |(ray, t, farthest)| {
            let rest = Ray { origin: ray.at(t), direction: ray.direction };
            let from_point = RayFromPoint::new(rest.origin, rest.direction);
            let mut inside = t.constant(0.0).to_bits();
            let mut length = t.constant(NEVER);
            for (bit, &bounds) in boxes.boxes.iter().enumerate() {
                let (enters, leaves) = from_point.chord(bounds);
                let is_inside = enters.below(0.0);
                inside = R::select(is_inside, R::from_bits(inside | (1 << bit)), R::from_bits(inside)).to_bits();
                length = length.min(R::select(is_inside, leaves, enters));
            }
            // Long enough for a step.
            let length = length.max(self.resolution.at(t));
            let inside = R::from_bits(inside);
            let part = Part { formula: inside, end: t + length };
            let Some(visits) = &self.visits else { return part };
            let visited = visits.along(&rest, length.min(farthest - t));
            Part { end: part.end.max(visited), ..part }
        })
    }
}
