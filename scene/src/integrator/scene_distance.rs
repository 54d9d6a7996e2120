//! Distance of the whole scene, and the nearest object.

use super::Integrator;
use crate::camera::Ray;
use crate::march::{Part, RayField};
use crate::real::{Bundle, Real, Vec3};

/// Distance returned if there is no surface.
const MISS_DISTANCE: f32 = 1e9;

impl Integrator<'_> {
    /// Distance of the whole scene at `p`: at most the distance to the nearest surface.
    pub fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let distance = self.unrecorded_distance(p);
        self.visits.as_ref().map_or(distance, |visits| distance.max(visits.at(p)))
    }

    fn unrecorded_distance<R: Real>(&self, p: Vec3<R>) -> R {
        if let Some(cells) = &self.cells {
            p.x.call(self.names.distance, p, |p| cells.distance(p))
        } else if self.shares_nearest {
            self.unrecorded_nearest_object(p).0
        } else if self.cull_bounds.is_empty() {
            self.distance_unculled(p)
        } else {
            self.distance_culled(p)
        }
    }

    fn distance_unculled<R: Real>(&self, p: Vec3<R>) -> R {
        p.x.call(self.names.distance, p, |p| {
            let Some((&first, others)) = self.surfaces.split_first() else { return p.x.constant(MISS_DISTANCE) };
            let mut nearest = self.object_distance(first, p);
            for &index in others {
                nearest = nearest.min(self.object_distance(index, p));
            }
            nearest
        })
    }

    fn distance_culled<R: Real>(&self, p: Vec3<R>) -> R {
        p.x.call(self.names.distance, p, |p| {
            let Some((&first, others)) = self.surfaces.split_first() else { return p.x.constant(MISS_DISTANCE) };
            let mut nearest = self.object_distance(first, p);
            for &index in others {
                nearest =
                    self.unless_beyond(index, p, nearest, nearest, || nearest.min(self.object_distance(index, p)));
            }
            nearest
        })
    }

    /// Distance of the whole scene at `p`, and the index of the nearest object; if several are equally near, of the
    /// first.
    pub(super) fn nearest_object<R: Real>(&self, p: Vec3<R>) -> (R, R) {
        let (distance, object) = self.unrecorded_nearest_object(p);
        match &self.visits {
            None => (distance, object),
            Some(visits) => {
                let visited = visits.at(p);
                (distance.max(visited), object.max(visited))
            }
        }
    }

    fn unrecorded_nearest_object<R: Real>(&self, p: Vec3<R>) -> (R, R) {
        p.x.call(self.names.nearest, p, |p| {
            if let Some(cells) = &self.cells {
                return cells.nearest(p);
            }
            let Some((&first, others)) = self.surfaces.split_first() else {
                return (p.x.constant(MISS_DISTANCE), p.x.constant(-1.0));
            };
            let mut nearest = (self.object_distance(first, p), p.x.constant(first as f32));
            for &index in others {
                nearest = self.unless_beyond(index, p, nearest.0, nearest, || {
                    let distance = self.object_distance(index, p);
                    let nearer = distance.lt(nearest.0);
                    let object = R::select(nearer, p.x.constant(index as f32), nearest.1);
                    (nearest.0.min(distance), object)
                });
            }
            nearest
        })
    }

    /// Merges one object into the nearest result so far. Skips the object if its bounds are farther away than that
    /// result.
    fn unless_beyond<R: Real, T: Bundle<R>>(
        &self,
        index: usize,
        p: Vec3<R>,
        nearest: R,
        before: T,
        with_object: impl FnOnce() -> T,
    ) -> T {
        match self.cull_bounds.get(index).and_then(Option::as_ref) {
            Some(bounds) => R::when(bounds.distance_lower_bound(p).lt(nearest), before, with_object),
            None => with_object(),
        }
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
        self.integrator.cells.as_ref().map(|_| Part { formula: nowhere, end: nowhere })
    }

    fn enter(&self, t: R, farthest: R) -> (R, Part<R>) {
        match &self.integrator.cells {
            Some(cells) => cells.enter(self.ray, t, farthest),
            None => (t, Part { formula: t, end: farthest }),
        }
    }

    fn distance(&self, t: R, part: Option<Part<R>>) -> R {
        let p = self.ray.at(t);
        match (&self.integrator.cells, part) {
            (Some(cells), Some(part)) => cells.fold(part.formula, p),
            _ => self.integrator.distance(p),
        }
    }
}
