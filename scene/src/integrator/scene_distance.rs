//! The distance of a whole scene, and which object is the nearest.

use super::Program;
use crate::real::{Bundle, Real, Vec3};

/// How far away a surface is where there is none.
const NOWHERE: f32 = 1e9;

impl Program<'_> {
    /// The distance of the whole scene at `p`, never more than to the nearest surface.
    #[inline(always)]
    pub fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        if self.is_long {
            self.nearest(p).0
        } else if self.boxes.is_empty() {
            self.distance_to_all(p)
        } else {
            self.distance_past_boxes(p)
        }
    }

    fn distance_to_all<R: Real>(&self, p: Vec3<R>) -> R {
        p.x.shared(
            "distance",
            p,
            #[inline(always)]
            |p| {
                let Some((&first, others)) = self.surfaces.split_first() else { return p.x.splat(NOWHERE) };
                let mut nearest = self.object_distance(first, p);
                for &index in others {
                    nearest = nearest.min(self.object_distance(index, p));
                }
                nearest
            },
        )
    }

    fn distance_past_boxes<R: Real>(&self, p: Vec3<R>) -> R {
        p.x.shared(
            "distance",
            p,
            #[inline(always)]
            |p| {
                let Some((&first, others)) = self.surfaces.split_first() else { return p.x.splat(NOWHERE) };
                let mut nearest = self.object_distance(first, p);
                for &index in others {
                    nearest = self.unless_beyond(
                        index,
                        p,
                        nearest,
                        nearest,
                        #[inline(always)]
                        || nearest.min(self.object_distance(index, p)),
                    );
                }
                nearest
            },
        )
    }

    /// The same, and the index of the nearest object; of the first of several.
    pub(super) fn nearest<R: Real>(&self, p: Vec3<R>) -> (R, R) {
        p.x.shared(
            "nearest",
            p,
            #[inline(always)]
            |p| {
                let Some((&first, others)) = self.surfaces.split_first() else {
                    return (p.x.splat(NOWHERE), p.x.splat(-1.0));
                };
                let mut nearest = (self.object_distance(first, p), p.x.splat(first as f32));
                for &index in others {
                    nearest = self.unless_beyond(
                        index,
                        p,
                        nearest.0,
                        nearest,
                        #[inline(always)]
                        || {
                            let distance = self.object_distance(index, p);
                            let nearer = distance.lt(nearest.0);
                            let object = R::select(nearer, p.x.splat(index as f32), nearest.1);
                            (nearest.0.min(distance), object)
                        },
                    );
                }
                nearest
            },
        )
    }

    /// Merges one object into the nearest result so far. Skips the object if its bounds are farther away than that result.
    #[inline(always)]
    fn unless_beyond<R: Real, T: Bundle<R>>(
        &self,
        index: usize,
        p: Vec3<R>,
        nearest: R,
        before: T,
        with_object: impl FnOnce() -> T,
    ) -> T {
        match self.boxes.get(index).and_then(Option::as_ref) {
            Some(bounds) => R::when(bounds.distance_below(p).lt(nearest), before, with_object),
            None => with_object(),
        }
    }

    #[inline(always)]
    pub(super) fn object_distance<R: Real>(&self, index: usize, p: Vec3<R>) -> R {
        let distance = self.scene.objects[index].shape.distance(p);
        match self.shrink[index] {
            Some(factor) => distance * distance.given(factor),
            None => distance,
        }
    }
}
