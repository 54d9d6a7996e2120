//! The light that arrives at a place, and what stands in its way.

use super::{Hit, Program};
use crate::ambient_occlusion::AmbientOcclusion;
use crate::backgrounds::Backdrop;
use crate::camera::Ray;
use crate::lights::{Incoming, Light, LightSource, Surrounding};
use crate::march::{Marched, RELAXATION, Reach, march};
use crate::materials::microfacet::frame;
use crate::materials::{Lighting, Shade};
use crate::real::{Real, Vec3};
use crate::sampling::Dice;

/// What a pair of numbers is for, see [`Dice::pair`]: the light of this index has `LIGHTS` + index.
pub(super) const SCATTERING: u32 = 0;
pub(super) const CHOICE: u32 = 1;
const LIGHTS: u32 = 2;
/// Evaluations that a normal takes.
pub(super) const NORMAL_TAPS: f32 = 4.0;

impl Program<'_> {
    /// The colour of a surface, and how many evaluations it cost.
    #[inline(always)]
    pub(super) fn surface<R: Real>(&self, ray: &Ray<R>, marched: &Marched<R>, dice: &Dice<R>) -> (Vec3<R>, R) {
        let hit = self.hit(ray, marched);
        let (light, evaluations) = self.lighting(&hit, dice);
        (self.dress(&hit, ray, &light), evaluations + NORMAL_TAPS)
    }

    /// The light at a hit, and how often the scene was evaluated for it.
    #[inline(always)]
    pub(super) fn lighting<R: Real>(&self, hit: &Hit<R>, dice: &Dice<R>) -> (Lighting<R>, R) {
        let zero = hit.distance.splat(0.0);
        let mut evaluations = zero;
        let mut light = Lighting { lights: Vec::new(), surrounding: None, openness: None };
        if !self.clothes.slots().any(|slot| self.scene.slots()[slot].is_lit()) {
            return (light, evaluations);
        }
        light.openness = self.openness(hit);
        if light.openness.is_some() {
            evaluations = evaluations + AmbientOcclusion::TAPS;
        }
        let farthest = zero.given(self.scene.march.max_distance.get());
        for (index, source) in self.scene.lights.iter().enumerate() {
            let pair = || dice.pair(LIGHTS + index as u32);
            let background = &self.scene.background;
            if let Some((mut incoming, distance)) = source.arriving(hit.position, farthest, background.day(), pair) {
                if source.casts_shadows() {
                    let (visible, steps) = self.visibility(hit, incoming.direction, distance);
                    incoming.radiance = incoming.radiance * visible;
                    evaluations = evaluations + steps;
                }
                light.lights.push(incoming);
            } else if let Some(sky) = source.surrounding(background) {
                let (around, steps) = self.sky_light(sky, source.casts_shadows(), hit, light.openness, pair);
                evaluations = evaluations + steps;
                light.surrounding = Some(light.surrounding.map_or(around, |sum| sum + around));
            }
        }
        (light, evaluations)
    }

    #[inline(always)]
    fn openness<R: Real>(&self, hit: &Hit<R>) -> Option<R> {
        let occlusion = self.scene.ambient_occlusion.as_ref()?;
        Some(occlusion.openness(
            hit.position,
            hit.normal,
            #[inline(always)]
            |p| self.distance(p),
        ))
    }

    /// Light from all around, and the steps it took to see what hides it.
    #[inline(always)]
    fn sky_light<R: Real>(
        &self,
        sky: Surrounding<'_>,
        casts_shadows: bool,
        hit: &Hit<R>,
        openness: Option<R>,
        pair: impl FnOnce() -> (R, R),
    ) -> (Vec3<R>, R) {
        let strength = hit.distance.given(sky.strength);
        if !casts_shadows && let Some(mean) = sky.from.mean_over(hit.normal) {
            let mean = mean * strength;
            return (openness.map_or(mean, |openness| mean * openness), hit.distance.splat(0.0));
        }
        let direction = by_cosine(hit.normal, pair());
        let seen = sky.from.toward(direction) * strength;
        if !casts_shadows {
            return (openness.map_or(seen, |openness| seen * openness), hit.distance.splat(0.0));
        }
        let farthest = hit.distance.given(self.scene.march.max_distance.get());
        let (visible, steps) = self.visibility(hit, direction, farthest);
        (seen * visible, steps)
    }

    /// The share of the light from `direction` that reaches the place, and the steps it took to see.
    pub(super) fn visibility<R: Real>(&self, hit: &Hit<R>, direction: Vec3<R>, farthest: R) -> (R, R) {
        farthest.shared(
            "visibility",
            (*hit, direction, farthest),
            #[inline(always)]
            |(hit, direction, farthest)| {
                let zero = farthest.splat(0.0);
                // Off the surface by more than the march was off it.
                let near = self.tolerance.at(hit.distance);
                let ray = Ray { origin: hit.normal.mul_add(near * 4.0, hit.position), direction };
                let faces = hit.normal.dot(direction).above(0.0);
                R::when(
                    faces,
                    (zero, zero),
                    #[inline(always)]
                    || {
                        let (visible, steps) = self.clear(&ray, near, farthest);
                        match &self.media {
                            None => (visible, steps),
                            Some(media) => R::when(
                                visible.above(0.0),
                                (visible, steps),
                                #[inline(always)]
                                || (self.transmittance(media, &ray, farthest), steps),
                            ),
                        }
                    },
                )
            },
        )
    }

    /// 1 where no surface is on the ray nearer than `farthest`, else 0; and the steps it took to see.
    #[inline(always)]
    pub(super) fn clear<R: Real>(&self, ray: &Ray<R>, near: R, farthest: R) -> (R, R) {
        let (zero, one) = (farthest.splat(0.0), farthest.splat(1.0));
        let (nearest, farthest) = self.bounds.along(ray, farthest);
        R::when(
            nearest.lt(farthest),
            (one, zero),
            #[inline(always)]
            || {
                let reach = Reach { nearest, farthest, max_steps: self.scene.march.max_steps, relaxation: RELAXATION };
                let marched = march(
                    ray,
                    reach,
                    #[inline(always)]
                    |t| t.mul_add(t.splat(4e-7), near),
                    #[inline(always)]
                    |p| self.distance(p),
                );
                (R::select(marched.hit.0, zero, one), marched.steps)
            },
        )
    }
}

/// A direction around a normal, as likely as its cosine: a point of the unit disc, raised to the half sphere.
#[inline(always)]
fn by_cosine<R: Real>(normal: Vec3<R>, (u, v): (R, R)) -> Vec3<R> {
    let (right, up) = frame(normal);
    let (sine, cosine) = (v * std::f32::consts::TAU).sin_cos();
    let away = u.sqrt();
    let height = (u.splat(1.0) - u).sqrt();
    let along = normal.mul_add(height, right * (away * cosine));
    up.mul_add(away * sine, along)
}

/// All lights as they arrive at a point in the air, unhindered, with their places among the lights.
#[inline(always)]
pub(super) fn arriving_in_air<'a, R: Real>(
    program: &'a Program<'_>,
    p: Vec3<R>,
    dice: &'a Dice<R>,
) -> impl Iterator<Item = (&'a Light, Incoming<R>, R)> {
    let farthest = p.x.given(program.scene.march.max_distance.get());
    program.scene.lights.iter().enumerate().filter_map(move |(index, source)| {
        let day = program.scene.background.day();
        let (incoming, distance) = source.arriving(p, farthest, day, || dice.pair(LIGHTS + index as u32))?;
        Some((source, incoming, distance))
    })
}
