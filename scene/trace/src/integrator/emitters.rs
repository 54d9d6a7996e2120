//! Lights of path tracing: one of them is chosen at each surface, by its strength there.

use std::f32::consts::PI;

use super::Integrator;
use super::lighting::{OF_LIGHT, ON_LIGHT};
use super::ray_kinds::RayFunction;
use super::sky_table::{SkyDirection, SkyTable};
use crate::lights::{LightBody, NEVER, PlacedLight, direction_around};
use crate::materials::microfacet::orthonormal_basis;
use crate::ray::Ray;
use crate::real::{MaskValue, Real, Vec3, bundle, vec3};
use crate::sampling::Sampler;
use crate::scene::{LightGroups, Scene};

/// Maximum number of emitting objects that are sampled as lights; others light surfaces where a path meets them.
const MAX_EMITTING_OBJECTS: usize = 32;

/// Something that shines on surfaces.
#[derive(Clone, Debug)]
enum Emitter {
    /// A light of the scene, and its shape if rays meet it.
    Light { index: usize, body: Option<LightBody> },
    /// An object of one radiance: its directions are sampled in the cone of a ball around it.
    Object(EmittingObject),
    /// The sky, if it is brighter in some directions than in others.
    Sky(SkyTable),
}

#[derive(Clone, Debug)]
struct EmittingObject {
    index: usize,
    center: Vec3<f32>,
    radius: f32,
    radiance: Vec3<f32>,
}

impl Emitter {
    /// Place of its light group.
    fn group(&self, groups: &LightGroups) -> usize {
        match self {
            Self::Light { index, .. } => groups.lights[*index],
            Self::Object(object) => groups.objects[object.index],
            Self::Sky(_) => groups.sky,
        }
    }
}

/// The objects and lights of a scene that send light out.
#[derive(Clone, Debug)]
pub(super) struct Emitters {
    all: Vec<Emitter>,
    /// Whether rays of some kind see an object that is sampled as a light.
    has_objects: bool,
}

/// A direction that was sampled toward a light.
#[derive(Clone, Copy)]
struct LightRay<R> {
    direction: Vec3<R>,
    /// Distance of the light.
    distance: R,
    /// Radiance over π and over the density of the direction, without occlusion.
    arriving: Vec3<R>,
    /// Density of the direction, if a scattered ray may meet the light there; else 0.
    density: R,
    /// Index of the emitter.
    emitter: R,
    /// 0 if the light casts no shadows.
    casts_shadows: R,
    /// Place of its light group; `None` if the picture has no groups.
    group: Option<R>,
}

bundle!(LightRay { direction, distance, arriving, density, emitter, casts_shadows, group });

/// A light that a ray meets.
#[derive(Clone, Copy)]
pub(super) struct MetLight<R> {
    /// [`NEVER`] if there is none.
    pub(super) distance: R,
    pub(super) radiance: Vec3<R>,
    /// Density with which next-event estimation would have chosen the direction.
    pub(super) density: R,
    /// Place of its light group; `None` if the picture has no groups.
    pub(super) group: Option<R>,
}

bundle!(MetLight { distance, radiance, density, group });

/// Light that arrives at a surface from the chosen light, if nothing is in the way.
pub(super) struct NextEvent<R: Real> {
    pub(super) direction: Vec3<R>,
    /// Radiance over π and over the density of the direction.
    pub(super) arriving: Vec3<R>,
    /// Density of the direction, if a scattered ray may meet the light there; else 0.
    pub(super) density: R,
    /// The ray that finds out, without its color.
    pub(super) shadow: ShadowRay<R>,
}

/// A ray from a path's vertex toward a light.
#[derive(Clone, Copy)]
pub(super) struct ShadowRay<R: Real> {
    pub(super) direction: Vec3<R>,
    /// Distance of the light.
    pub(super) distance: R,
    /// Index of the object that is the light; −1 if it is none. `None` if no object is a light.
    pub(super) object: Option<R>,
    /// Light that it brings to the camera, if nothing is in the way.
    pub(super) color: Vec3<R>,
    /// Place of the light's group; `None` if the picture has no groups.
    pub(super) group: Option<R>,
    /// Whether it has still to be traced.
    pub(super) is_traced: MaskValue<R>,
}

bundle!(ShadowRay { direction, distance, object, color, group, is_traced });

/// The vertex that a ray comes from, as the lights saw it.
#[derive(Clone, Copy)]
pub(super) struct Vertex<R> {
    pub(super) position: Vec3<R>,
    /// Sum of the strengths of all lights there.
    pub(super) strength: R,
}

bundle!(Vertex { position, strength });

impl Emitters {
    /// The lights of a scene, and its objects that shine and that `surfaces` has.
    pub(super) fn new(scene: &Scene, surfaces: &[usize]) -> Self {
        // Light of the sky is met by rays that meet nothing else.
        let day = scene.environment().day();
        let has_direction =
            |light: &PlacedLight| light.sample_at(vec3(0.0, 0.0, 0.0), 1.0, day, || (0.5, 0.5)).is_some();
        let lights =
            scene.lights.iter().enumerate().filter(|(_, light)| !light.options().is_dark && has_direction(light));
        let lights = lights.map(|(index, light)| Emitter::Light { index, body: light.body_in_scene() });
        let emitting = |index: usize| {
            let object = &scene.objects[index];
            let radiance = scene.material_of(index).uniform_emission()?;
            let bounds = object.shape.bounds(0.0);
            if object.shape.has_own_materials() || !bounds.is_finite() {
                return None;
            }
            let center = (bounds.min + bounds.max) * 0.5;
            Some(Emitter::Object(EmittingObject { index, center, radius: bounds.diagonal() * 0.5005, radiance }))
        };
        let objects = surfaces.iter().filter_map(|&index| emitting(index));
        let has_objects = (0..scene.objects.len()).any(|index| emitting(index).is_some());
        let has_table = scene.integrator.is_path() && scene.skies().any(|sky| sky.from.day().is_some());
        let sky = has_table.then(|| Emitter::Sky(SkyTable::new(|direction| scene.light_of_sky(direction))));
        Self { all: lights.chain(objects.take(MAX_EMITTING_OBJECTS)).chain(sky).collect(), has_objects }
    }

    /// The lights that rays meet, with their indices and shapes.
    fn bodies(&self) -> impl Iterator<Item = (usize, &Emitter, &LightBody)> {
        self.all.iter().enumerate().filter_map(|(index, emitter)| match emitter {
            Emitter::Light { body, .. } => body.as_ref().map(|body| (index, emitter, body)),
            Emitter::Object(_) | Emitter::Sky(_) => None,
        })
    }

    /// The objects that are sampled as lights, with their indices among the emitters.
    fn objects(&self) -> impl Iterator<Item = (usize, &EmittingObject)> {
        self.all.iter().enumerate().filter_map(|(index, emitter)| match emitter {
            Emitter::Light { .. } | Emitter::Sky(_) => None,
            Emitter::Object(object) => Some((index, object)),
        })
    }

    /// Whether some object is sampled as a light, by this integrator or the ones for other kinds of rays.
    pub(super) fn has_objects(&self) -> bool {
        self.has_objects
    }

    /// Whether the emitters of another scene are the same objects and lights.
    pub(super) fn is_alike(&self, other: &Self) -> bool {
        let key = |emitter: &Emitter| match emitter {
            // Lights and skies are compared by the frames' keys.
            Emitter::Light { .. } | Emitter::Sky(_) => None,
            Emitter::Object(EmittingObject { index, center, radius, radiance }) => {
                Some((*index, *center, *radius, *radiance))
            }
        };
        self.all.iter().map(key).eq(other.all.iter().map(key))
    }
}

impl EmittingObject {
    /// 1 − the cosine of half the cone in which directions are sampled; 2 inside the ball, where all are.
    fn versine<R: Real>(&self, p: Vec3<R>) -> R {
        let one = p.x.constant(1.0);
        let square = p.x.uniform(self.radius * self.radius);
        let away = (Vec3::uniform(p.x, self.center) - p).length_squared();
        let sine_squared = (square / away.max(square)).at_most(1.0);
        let versine = sine_squared / (one + (one - sine_squared).sqrt());
        R::select(square.lt(away), versine, p.x.constant(2.0))
    }

    fn density<R: Real>(&self, p: Vec3<R>) -> R {
        p.x.constant(0.5 / PI) / self.versine(p).at_least(1e-12)
    }

    fn sample<R: Real>(&self, p: Vec3<R>, farthest: R, (u, v): (R, R)) -> LightRay<R> {
        let axis = (Vec3::uniform(p.x, self.center) - p).normalize();
        let versine = self.versine(p);
        let (right, up) = orthonormal_basis(axis);
        LightRay {
            direction: direction_around(axis, right, up, u * versine, v).normalize(),
            distance: farthest,
            arriving: Vec3::uniform(p.x, self.radiance) * (versine * 2.0),
            density: self.density(p),
            emitter: p.x.constant(-1.0),
            casts_shadows: p.x.constant(1.0),
            group: None,
        }
    }
}

impl Integrator<'_> {
    /// About how much light arrives at `p` from an emitter.
    fn strength_of<R: Real>(&self, emitter: &Emitter, p: Vec3<R>) -> R {
        match emitter {
            Emitter::Light { index, .. } => self.scene.lights[*index].strength_at(p, self.scene.environment().day()),
            Emitter::Object(EmittingObject { center, radius, radiance, .. }) => {
                let square = radius * radius;
                let away = (Vec3::uniform(p.x, *center) - p).length_squared();
                p.x.uniform(radiance.mean() * square) / away.max(p.x.uniform(square))
            }
            Emitter::Sky(table) => p.x.uniform(table.mean),
        }
    }

    /// A point, and the sum of the strengths of all lights there.
    pub(super) fn vertex<R: Real>(&self, position: Vec3<R>) -> Vertex<R> {
        let zero = position.x.constant(0.0);
        let strengths = self.emitters.all.iter().map(|emitter| self.strength_of(emitter, position));
        Vertex { position, strength: strengths.fold(zero, |sum, strength| sum + strength) }
    }

    /// The first visible light on a ray from a vertex.
    pub(super) fn met_light<R: Real>(&self, ray: &Ray<R>, from: &Vertex<R>) -> MetLight<R> {
        let zero = ray.direction.x.constant(0.0);
        let nothing = MetLight {
            distance: zero.constant(NEVER),
            radiance: vec3(zero, zero, zero),
            density: zero,
            group: self.group_number(zero, LightGroups::rest),
        };
        self.emitters.bodies().fold(nothing, |first, (_, emitter, LightBody { shape, radiance })| {
            let distance = shape.distance_along(ray);
            R::when(distance.lt(first.distance), first, || {
                let shines = shape.shines_against(ray.direction);
                let radiance = Vec3::select(shines, Vec3::uniform(zero, *radiance), vec3(zero, zero, zero));
                let share = self.strength_of(emitter, from.position) / from.strength.at_least(1e-30);
                let density = shape.density(from.position, ray.direction, distance) * share;
                let group = self.group_number(zero, |groups| emitter.group(groups));
                MetLight { distance, radiance, density, group }
            })
        })
    }

    /// Whether a ray meets a visible light nearer than `length`, its distance and its radiance; `None` without such lights.
    pub(super) fn seen_light<R: Real>(&self, ray: &Ray<R>, length: R) -> Option<(R::Mask, R, Vec3<R>)> {
        self.emitters.bodies().next()?;
        let from = Vertex { position: ray.origin, strength: length.constant(1.0) };
        let MetLight { distance, radiance, density: _, group: _ } = self.met_light(ray, &from);
        Some((distance.lt(length), distance, radiance))
    }

    /// Density with which next-event estimation at a vertex would have chosen the direction to a point of an object.
    pub(super) fn density_of_object<R: Real>(&self, object: R, from: &Vertex<R>) -> R {
        let zero = object.constant(0.0);
        self.emitters.all.iter().fold(zero, |density, emitter| {
            let Emitter::Object(own) = emitter else { return density };
            let is_own = (object - own.index as f32).abs().below(0.5);
            R::when(is_own, density, || {
                let share = self.strength_of(emitter, from.position) / from.strength.at_least(1e-30);
                own.density(from.position) * share
            })
        })
    }

    /// Density with which next-event estimation at a vertex would have chosen a direction to the sky.
    pub(super) fn density_of_sky<R: Real>(&self, direction: Vec3<R>, from: &Vertex<R>) -> R {
        let zero = direction.x.constant(0.0);
        self.emitters.all.iter().fold(zero, |density, emitter| {
            let Emitter::Sky(table) = emitter else { return density };
            let share = self.strength_of(emitter, from.position) / from.strength.at_least(1e-30);
            table.density(direction).mul_add(share, density)
        })
    }

    /// Light at a point off a surface with a normal, or in a medium, from one light, chosen by strength: up to what is in the
    /// way.
    pub(super) fn next_event<R: Real>(
        &self,
        normal: Option<Vec3<R>>,
        here: &Vertex<R>,
        sampler: &Sampler<R>,
    ) -> NextEvent<R> {
        let p = here.position;
        let zero = p.x.constant(0.0);
        let farthest = zero.uniform(self.scene.march.max_distance.get());
        let (choice, _) = sampler.get_2d(OF_LIGHT);
        let pair = sampler.get_2d(ON_LIGHT);
        let black = vec3(zero, zero, zero);
        let mut chosen = LightRay {
            direction: normal.unwrap_or(vec3(zero, zero + 1.0, zero)),
            distance: farthest,
            arriving: black,
            density: zero,
            emitter: zero.constant(-1.0),
            casts_shadows: zero,
            group: self.group_number(zero, LightGroups::rest),
        };
        let (target, mut before) = (choice * here.strength, zero);
        for (index, emitter) in self.emitters.all.iter().enumerate() {
            let strength = self.strength_of(emitter, p);
            let after = before + strength;
            let is_chosen = !target.lt(before) & target.lt(after);
            chosen = R::when(is_chosen, chosen, || {
                let ray = self.sample_emitter(emitter, p, farthest, pair);
                let share = strength / here.strength.at_least(1e-30);
                LightRay {
                    arriving: ray.arriving * (zero.constant(1.0) / share),
                    density: ray.density * share,
                    emitter: zero.constant(index as f32),
                    group: self.group_number(zero, |groups| emitter.group(groups)),
                    ..ray
                }
            });
            before = after;
        }
        let shines = chosen.arriving.max_element().above(0.0);
        let shines = normal.map_or(shines, |normal| normal.dot(chosen.direction).above(0.0) & shines);
        let casts_shadows = chosen.casts_shadows.above(0.5);
        let ray = Ray { origin: p, direction: chosen.direction };
        let is = |index: usize| (chosen.emitter - index as f32).abs().below(0.5);
        // Other lights are in the way, too.
        let MaskValue(is_blocked) = R::when(shines & casts_shadows, MaskValue(zero.above(0.0)), || {
            MaskValue(self.emitters.bodies().fold(zero.above(0.0), |is_blocked, (index, _, body)| {
                is_blocked | (body.shape.distance_along(&ray).lt(chosen.distance) & !is(index))
            }))
        });
        let arrives = shines & !is_blocked;
        let none = zero.constant(-1.0);
        let object = self
            .emitters
            .objects()
            .fold(none, |object, (index, own)| R::select(is(index), zero.constant(own.index as f32), object));
        NextEvent {
            direction: chosen.direction,
            arriving: Vec3::select(arrives, chosen.arriving, black),
            density: chosen.density,
            shadow: ShadowRay {
                direction: chosen.direction,
                distance: chosen.distance,
                object: self.emitters.has_objects().then_some(object),
                color: black,
                group: chosen.group,
                is_traced: MaskValue(arrives & casts_shadows),
            },
        }
    }

    /// A shadow ray that is not traced.
    pub(super) fn no_shadow_ray<R: Real>(&self, zero: R) -> ShadowRay<R> {
        let black = vec3(zero, zero, zero);
        ShadowRay {
            direction: vec3(zero, zero + 1.0, zero),
            distance: zero,
            object: self.emitters.has_objects().then_some(zero.constant(-1.0)),
            color: black,
            group: self.group_number(zero, LightGroups::rest),
            is_traced: MaskValue(zero.above(0.0)),
        }
    }

    fn sample_emitter<R: Real>(&self, emitter: &Emitter, p: Vec3<R>, farthest: R, pair: (R, R)) -> LightRay<R> {
        let zero = p.x.constant(0.0);
        match emitter {
            Emitter::Object(object) => object.sample(p, farthest, pair),
            Emitter::Sky(table) => {
                let SkyDirection { direction, density } = table.sample(pair);
                LightRay {
                    direction,
                    distance: farthest,
                    arriving: self.scene.light_of_sky(direction) * (zero.constant(1.0 / PI) / density),
                    density,
                    emitter: zero.constant(-1.0),
                    casts_shadows: zero.constant(1.0),
                    group: None,
                }
            }
            Emitter::Light { index, body } => {
                let light = &self.scene.lights[*index];
                let day = self.scene.environment().day();
                let Some((sample, distance)) = light.sample_at(p, farthest, day, || pair) else {
                    unreachable!("emitters have a direction");
                };
                let density = body.map_or(zero, |body| body.shape.density(p, sample.direction, distance));
                let casts_shadows = zero.constant(if light.options().casts_shadows { 1.0 } else { 0.0 });
                LightRay {
                    direction: sample.direction,
                    distance,
                    arriving: sample.radiance,
                    density,
                    emitter: zero.constant(-1.0),
                    casts_shadows,
                    group: None,
                }
            }
        }
    }

    /// Fraction of the light of a shadow ray that reaches `origin`, off a surface by the tolerance `near`, and the number of
    /// distance evaluations.
    pub(super) fn light_visibility<R: Real>(
        &self,
        origin: Vec3<R>,
        near: R,
        shadow: &ShadowRay<R>,
        sampler: &Sampler<R>,
    ) -> (R, R) {
        let shadows = self.of_shadow_rays();
        let (length, visible, evaluations) = shadows.light_occlusion(origin, near, shadow);
        (shadows.through_media(origin, visible, length, shadow.direction, sampler), evaluations)
    }

    /// The visibility of a light behind media along a shadow ray of this length.
    pub(super) fn through_media<R: Real>(
        &self,
        origin: Vec3<R>,
        visible: R,
        length: R,
        direction: Vec3<R>,
        sampler: &Sampler<R>,
    ) -> R {
        let Some(media) = &self.media else { return visible };
        let ray = Ray { origin, direction };
        R::when(visible.above(0.0), visible, || self.tracked_transmittance(media, &ray, length, sampler))
    }

    /// The distance of what shines, 1 if nothing is nearer, else 0; and the number of distance evaluations.
    fn light_occlusion<R: Real>(&self, origin: Vec3<R>, near: R, shadow: &ShadowRay<R>) -> (R, R, R) {
        let arguments = ((near, origin), (shadow.direction, shadow.distance), shadow.object);
        let key = self.key(RayFunction::LightVisibility);
        near.call(key, arguments, |((near, origin), (direction, distance), object)| {
            let zero = near.constant(0.0);
            let ray = Ray { origin, direction };
            let Some(object) = object else { return self.is_clear(&ray, near, distance) };
            let of_light = object.below(-0.5);
            let lit = R::when(of_light, (distance, zero, zero), || self.is_clear(&ray, near, distance));
            R::when(!of_light, lit, || self.meets_object(&ray, near, object))
        })
    }

    /// The distance of a light, 1 if no surface is nearer, else 0; and the number of distance evaluations.
    fn is_clear<R: Real>(&self, ray: &Ray<R>, near: R, distance: R) -> (R, R, R) {
        let (visible, evaluations) = self.is_unoccluded(ray, near, distance);
        (distance, visible, evaluations)
    }

    /// The distance of the first surface, 1 if it is this object's, else 0; and the number of distance evaluations.
    fn meets_object<R: Real>(&self, ray: &Ray<R>, near: R, object: R) -> (R, R, R) {
        let zero = near.constant(0.0);
        let marched = self.march_from(ray, near);
        let (visible, asked) = R::when(marched.hit.0, (zero, zero), || self.is_of_object(ray, marched.t, object));
        (marched.t, visible, marched.evaluations + asked)
    }

    /// 1 if the surface at a point of a ray is this object's, else 0; and the number of distance evaluations.
    pub(super) fn is_of_object<R: Real>(&self, ray: &Ray<R>, t: R, object: R) -> (R, R) {
        let (met, one) = (self.nearest_object(ray.at(t)).1, t.constant(1.0));
        (R::select((met - object).abs().below(0.5), one, t.constant(0.0)), one)
    }
}
