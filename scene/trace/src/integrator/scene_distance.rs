//! Distance of the whole scene, and the nearest object.

use super::Integrator;
use super::ray_boxes::RayBoxes;
use super::ray_kinds::RayFunction;
use crate::march::{Part, RayField};
use crate::ray::Ray;
use crate::real::{Bundle, Real, Vec3};

/// Distance returned if there is no surface.
const MISS_DISTANCE: f32 = 1e9;

impl Integrator<'_> {
    /// Distance of the whole scene at `p`: at most the distance to the nearest surface.
    pub fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.distance_in(p, self.all_boxes(p.x))
    }

    /// Distance at `p` of the objects in some boxes, given their bits, and of those that have none.
    fn distance_in<R: Real>(&self, p: Vec3<R>, boxes: Option<R>) -> R {
        let distance = self.unrecorded_distance(p, boxes);
        self.visits.as_ref().map_or(distance, |visits| distance.max(visits.at(p)))
    }

    fn all_boxes<R: Real>(&self, like: R) -> Option<R> {
        self.ray_boxes.as_ref().map(|_| RayBoxes::all(like))
    }

    fn unrecorded_distance<R: Real>(&self, p: Vec3<R>, boxes: Option<R>) -> R {
        if let Some(cells) = &self.cells {
            p.x.call(self.key(RayFunction::Distance), p, |p| cells.distance(p))
        } else if self.shares_nearest {
            self.unrecorded_nearest_object(p, boxes).0
        } else {
            p.x.call(self.key(RayFunction::Distance), (p, boxes), |(p, boxes)| {
                let (first, others) = self.first_and_others();
                let start = first.map_or(p.x.constant(MISS_DISTANCE), |first| self.object_distance(first, p));
                others.iter().fold(start, |nearest, &index| {
                    self.with_object(index, p, boxes, nearest, nearest, |distance| nearest.min(distance))
                })
            })
        }
    }

    /// Distance of the whole scene at `p`, and the index of the nearest object; if several are equally near, of the
    /// first.
    pub(super) fn nearest_object<R: Real>(&self, p: Vec3<R>) -> (R, R) {
        let (distance, object) = self.unrecorded_nearest_object(p, self.all_boxes(p.x));
        match &self.visits {
            None => (distance, object),
            Some(visits) => {
                let visited = visits.at(p);
                (distance.max(visited), object.max(visited))
            }
        }
    }

    fn unrecorded_nearest_object<R: Real>(&self, p: Vec3<R>, boxes: Option<R>) -> (R, R) {
        p.x.call(self.key(RayFunction::Nearest), (p, boxes), |(p, boxes)| {
            if let Some(cells) = &self.cells {
                return cells.nearest(p);
            }
            let (first, others) = self.first_and_others();
            let nothing = (p.x.constant(MISS_DISTANCE), p.x.constant(-1.0));
            let start = first.map_or(nothing, |first| (self.object_distance(first, p), p.x.constant(first as f32)));
            others.iter().fold(start, |nearest, &index| {
                self.with_object(index, p, boxes, nearest.0, nearest, |distance| {
                    let nearer = distance.lt(nearest.0);
                    let object = R::select(nearer, p.x.constant(index as f32), nearest.1);
                    (nearest.0.min(distance), object)
                })
            })
        })
    }

    /// The first surface, unless it is evaluated only in its box, and those after it.
    fn first_and_others(&self) -> (Option<usize>, &[usize]) {
        match self.surfaces.split_first() {
            Some((&first, others)) if self.ray_boxes.as_ref().is_none_or(|all| all.bit(first).is_none()) => {
                (Some(first), others)
            }
            _ => (None, &self.surfaces),
        }
    }

    /// Merges one object into the nearest result so far. Skips the object if it is in another box, or its bounds are
    /// farther away than that result.
    fn with_object<R: Real, T: Bundle<R>>(
        &self,
        index: usize,
        p: Vec3<R>,
        boxes: Option<R>,
        nearest: R,
        before: T,
        join: impl FnOnce(R) -> T,
    ) -> T {
        let with_it = || join(self.object_distance(index, p));
        let Some(bounds) = self.cull_bounds.get(index).and_then(Option::as_ref) else { return with_it() };
        let is_near = bounds.distance_lower_bound(p).lt(nearest);
        let is_in_box = self.ray_boxes.as_ref().zip(boxes).and_then(|(all, boxes)| all.is_evaluated(index, boxes));
        R::when(is_in_box.map_or(is_near, |is_in_box| is_near & is_in_box), before, with_it)
    }

    pub(super) fn object_distance<R: Real>(&self, index: usize, p: Vec3<R>) -> R {
        let distance = self.scene.objects[index].shape.distance(p);
        match self.step_scales[index] {
            Some(factor) => distance * distance.uniform(factor),
            None => distance,
        }
    }
}

/// The scene's distance along a ray.
pub(super) struct AlongRay<'a, 'b, R> {
    pub(super) integrator: &'a Integrator<'b>,
    pub(super) ray: &'a Ray<R>,
}

impl<R: Real> RayField<R> for AlongRay<'_, '_, R> {
    fn start(&self) -> Option<Part<R>> {
        let nowhere = self.ray.direction.x.constant(-1e30);
        let all = self.integrator;
        (all.cells.is_some() || all.ray_boxes.is_some()).then_some(Part { formula: nowhere, end: nowhere })
    }

    fn enter(&self, t: R, farthest: R) -> (R, Part<R>) {
        let all = self.integrator;
        match (&all.cells, &all.ray_boxes) {
            (Some(cells), _) => cells.enter(self.ray, t, farthest),
            (None, Some(boxes)) => (t, all.enter_boxes(boxes, self.ray, t, farthest)),
            (None, None) => (t, Part { formula: t, end: farthest }),
        }
    }

    fn ends_with_part(&self) -> bool {
        self.integrator.ray_boxes.is_some()
    }

    fn distance(&self, t: R, part: Option<Part<R>>) -> R {
        let p = self.ray.at(t);
        match (&self.integrator.cells, part) {
            (Some(cells), Some(part)) => cells.fold(part.formula, p),
            (None, Some(part)) => self.integrator.distance_in(p, Some(part.formula)),
            (_, None) => self.integrator.distance(p),
        }
    }
}
