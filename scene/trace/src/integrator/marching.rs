//! Marches to the surfaces of a scene, and the hits there.

use super::ray_kinds::RayFunction;
use super::scene_distance::AlongRay;
use super::{Hit, Integrator};
use crate::march::{Approach, MarchRange, MarchResult, find_root, march_to_root, settle};
use crate::ray::{Ray, Tolerance};
use crate::real::{MaskValue, Real, Vec3, vec3};

impl Integrator<'_> {
    pub(super) fn march<R: Real>(&self, ray: &Ray<R>) -> MarchResult<R> {
        ray.direction.x.call(self.key(RayFunction::March), *ray, |ray| {
            let Tolerance { slope, floor } = self.tolerance;
            self.march_in_bounds(&ray, ray.direction.x.uniform(slope), ray.direction.x.uniform(floor), false)
        })
    }

    /// Like `march`, but to an exact root also on surfaces with fine detail. Only the depth layer is worth its cost.
    pub(super) fn march_to_depth<R: Real>(&self, ray: &Ray<R>) -> MarchResult<R> {
        ray.direction.x.call(self.key(RayFunction::MarchToDepth), *ray, |ray| {
            let Tolerance { slope, floor } = self.tolerance;
            self.march_in_bounds(&ray, ray.direction.x.uniform(slope), ray.direction.x.uniform(floor), true)
        })
    }

    /// Marches within the scene's bounds, with a tolerance that grows by `slope` from `near`. On surfaces with fine
    /// detail, a point within the tolerance is a hit, unless `depth` is requested.
    pub(super) fn march_in_bounds<R: Real>(&self, ray: &Ray<R>, slope: R, near: R, depth: bool) -> MarchResult<R> {
        let approach = self.approach(slope, near, depth);
        let zero = ray.direction.x.constant(0.0);
        let farthest = zero.uniform(self.scene.march.max_distance.get());
        let (nearest, farthest) = self.bounds.intersect_ray(ray, farthest);
        let missed = MarchResult {
            t: farthest,
            near: farthest,
            distance: farthest,
            steps: zero,
            evaluations: zero,
            hit: MaskValue(zero.below(0.0)),
        };
        R::when(nearest.lt(farthest), missed, || {
            // Depth on fine detail takes many steps, because the distance is close to 0.
            let max_steps = self.scene.march.max_steps * if depth { 16 } else { 1 };
            let max_past = if depth { 0.0 } else { self.max_past };
            let reach = MarchRange { t_min: nearest, t_max: farthest, max_steps, max_past };
            let along = AlongRay { integrator: self, ray };
            let marched = march_to_root(ray, reach, approach, &along, |p| self.distance(p), |p| self.is_fine(p));
            let touches = self.touches(&marched, farthest);
            R::when(touches, marched, || self.touched_surface(ray, marched, approach))
        })
    }

    /// Whether a march that ran out of steps did so within the pixel's footprint of a surface.
    fn touches<R: Real>(&self, marched: &MarchResult<R>, farthest: R) -> R::Mask {
        let seen = self.view.footprint().at(marched.t);
        !marched.hit.0 & marched.distance.lt(seen) & marched.t.lt(farthest)
    }

    /// The hit of a march that touches a surface.
    fn touched_surface<R: Real>(&self, ray: &Ray<R>, marched: MarchResult<R>, approach: Approach<R>) -> MarchResult<R> {
        if !self.fine.is_empty() {
            return MarchResult { hit: MaskValue(marched.t.below(f32::MAX)), ..marched };
        }
        // A root must exist, too: a ray along a surface has none.
        let wide = Approach { slope: marched.t.constant(0.0), near: self.view.footprint().at(marched.t), ..approach };
        find_root(ray, &marched, wide, None, |p| self.distance(p))
    }

    /// The surface where a march ended: not a hit if it ended at none, or if the ray passes the surface.
    pub(super) fn found_surface<R: Real>(
        &self,
        ray: &Ray<R>,
        near: R,
        marched: MarchResult<R>,
        farthest: R,
    ) -> MarchResult<R> {
        let approach = self.approach(near.uniform(self.tolerance.slope), near, false);
        let found = R::when(marched.hit.0, marched, || {
            settle(ray, marched, approach, |p| self.distance(p), |p| self.is_fine(p))
        });
        let touches = self.touches(&marched, farthest);
        R::when(touches, found, || self.touched_surface(ray, marched, approach))
    }

    pub(super) fn approach<R>(&self, slope: R, near: R, among_details: bool) -> Approach<R> {
        Approach {
            slope,
            near,
            resolution: self.resolution,
            both_sides: self.lets_through,
            among_details,
            detail_evaluations: self.detail_evaluations(),
        }
    }

    /// Refines a march that came near the surface to the exact intersection, and computes the normal there.
    pub(super) fn hit<R: Real>(&self, ray: &Ray<R>, marched: &MarchResult<R>) -> Hit<R> {
        marched.t.call(self.key(RayFunction::Hit), (*ray, *marched), |(ray, marched)| {
            let MarchResult { t: root, near, distance: gap, .. } = marched;
            let fine = self.is_fine(ray.at(near));
            let from = fine.map_or(root, |fine| R::select(fine, near, root));
            let p = ray.at(from);
            let normal = self.normal(p, self.normal_epsilon(p, from, fine));
            let facing = -normal.dot(ray.direction);
            let steepness = if self.lets_through { facing.abs() } else { facing };
            // One step of Newton's method along the ray, limited at grazing angles.
            let about = (near + gap / steepness.at_least(0.25)).at_least(0.0);
            // There is no root where the march ran out of steps.
            let distance = R::select(near.lt(root) | root.lt(near), root, about);
            let position = ray.at(fine.map_or(distance, |fine| R::select(fine, about, distance)));
            let inside = facing.below(0.0);
            let normal = Vec3::select(inside, -normal, normal);
            Hit { t: distance, position, normal, is_inside: MaskValue(inside) }
        })
    }

    /// Whether the surface at `p` has fine detail at every scale; `None` if no surface does. There a ray has many
    /// roots, so the visible surface is the one at the march's tolerance, and its normal is averaged over a pixel.
    pub(super) fn is_fine<R: Real>(&self, p: Vec3<R>) -> Option<R::Mask> {
        let zero = p.x.constant(0.0);
        if self.detail_evaluations() == 0.0 {
            return (!self.fine.is_empty()).then(|| zero.below(1.0));
        }
        let object = self.nearest_object(p).1;
        let nowhere = zero.above(1.0);
        Some(self.fine.iter().fold(nowhere, |mask, &index| mask | (object - index as f32).abs().below(0.5)))
    }

    /// Evaluations of the scene's distance in one call of `is_fine`.
    pub(super) fn detail_evaluations(&self) -> f32 {
        if self.fine.is_empty() || self.fine.len() == self.surfaces.len() { 0.0 } else { 1.0 }
    }

    /// Distance from a hit at which its normal is measured: as small as `f32` allows, so that nearby edges have no
    /// effect; a quarter of a pixel if the surface has finer detail.
    fn normal_epsilon<R: Real>(&self, p: Vec3<R>, distance: R, fine: Option<R::Mask>) -> R {
        /// Multiple of the coordinate: about a thousand times its rounding error.
        const OF_COORDINATE: f32 = 2.5e-4;
        /// Fraction of the maximum: a fortieth of half a pixel.
        const OF_MOST: f32 = 0.05;
        let most = self.normal_epsilon.at(distance);
        let size = vec3(p.x.abs(), p.y.abs(), p.z.abs()).max_element();
        let least = distance.uniform(self.resolution.floor * 50.0);
        let sharp = (size * OF_COORDINATE).max(most * OF_MOST).max(least).min(most);
        fine.map_or(sharp, |fine| R::select(fine, most, sharp))
    }

    /// Direction of the gradient, from four evaluations at the corners of a tetrahedron.
    fn normal<R: Real>(&self, p: Vec3<R>, size: R) -> Vec3<R> {
        let a = self.distance(p + vec3(size, -size, -size));
        let b = self.distance(p + vec3(-size, -size, size));
        let c = self.distance(p + vec3(-size, size, -size));
        let d = self.distance(p + vec3(size, size, size));
        let (ad, bc) = (a + d, b + c);
        let (ca, db) = (c - a, d - b);
        // Scaled up, so that the squares of small differences do not vanish.
        let gradient = vec3(ad - bc, ca + db, (d - c) + (b - a));
        let largest = gradient.map(Real::abs).max_element().at_least(1e-20);
        (gradient * (size.constant(1.0) / largest)).normalize()
    }
}
