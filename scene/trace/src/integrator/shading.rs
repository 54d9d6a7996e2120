//! Material shading at a hit: evaluates each material there and blends the results by weight.

use super::{Hit, Integrator, shading_point};
use crate::materials::bsdf::{Bsdf, Lobes};
use crate::materials::microfacet::orthonormal_basis;
use crate::materials::{IncidentLight, ShadingPoint, SpecularBsdf};
use crate::nodes::{DistanceWithMaterials, MaterialWeight, SdfValue};
use crate::ray::Ray;
use crate::real::{Bundle, Real, Vec3, vec3};
use crate::scene::Scene;

/// Materials of the scene's surfaces, as far as its structure determines them.
#[derive(Clone, Debug)]
pub(super) struct MaterialTable {
    /// Whether a node of an object names a material of its own.
    has_own_materials: Vec<bool>,
    /// Slots of materials that surfaces can have.
    surface_slots: Vec<usize>,
    /// Slot of the only material of all surfaces, if it looks the same from every space.
    single_slot: Option<usize>,
    /// Whether some material needs the normal in its own space.
    needs_own_normal: bool,
    /// Whether some texture needs the footprint in its own space.
    needs_footprint: bool,
    /// Whether some surface shows the shadows on it and nothing else.
    pub(super) catches_shadows: bool,
    /// Terms that the BSDF of some surface has.
    pub(super) lobes: Lobes,
}

/// A material at a hit.
struct HitMaterial<R> {
    slot: usize,
    weight: R,
    point: Vec3<R>,
    own_normal: Vec3<R>,
    footprint: [Vec3<R>; 2],
}

impl MaterialTable {
    pub(super) fn new(scene: &Scene) -> Self {
        let slots = scene.used_materials();
        let painted: Vec<bool> = scene.objects.iter().map(|object| object.shape.has_own_materials()).collect();
        let surfaces: Vec<usize> = (0..slots.len()).filter(|&slot| !slots[slot].is_medium()).collect();
        let is_textured = |slot: usize| slots[slot].is_textured() && painted.contains(&true);
        let only = match surfaces[..] {
            [only] if slots.len() == 1 && !is_textured(only) => Some(only),
            _ => None,
        };
        let needs_own_normal = surfaces.iter().any(|&slot| slots[slot].needs_local_normal());
        let needs_footprint = surfaces.iter().any(|&slot| slots[slot].needs_footprint());
        let catches_shadows = surfaces.iter().any(|&slot| slots[slot].is_shadow_catcher());
        let lobes = surfaces.iter().fold(Lobes::default(), |lobes, &slot| lobes.or(slots[slot].lobes()));
        Self {
            catches_shadows,
            lobes,
            has_own_materials: painted,
            surface_slots: surfaces,
            single_slot: only,
            needs_own_normal,
            needs_footprint,
        }
    }

    /// Whether the materials of two scenes are of the same kinds.
    pub(super) fn is_alike(&self, other: &Self) -> bool {
        let Self {
            // How weights are found follows from the surfaces, and the weights are the same.
            has_own_materials: _,
            surface_slots,
            single_slot,
            needs_own_normal,
            needs_footprint,
            catches_shadows,
            lobes,
        } = self;
        *surface_slots == other.surface_slots
            && *single_slot == other.single_slot
            && *needs_own_normal == other.needs_own_normal
            && *needs_footprint == other.needs_footprint
            && *catches_shadows == other.catches_shadows
            && *lobes == other.lobes
    }

    /// Index of a slot among the surfaces' slots.
    fn place_of(&self, slot: u32) -> Option<usize> {
        self.surface_slots.iter().position(|&surface| surface == slot as usize)
    }

    pub(super) fn slots(&self) -> impl Iterator<Item = usize> + '_ {
        self.surface_slots.iter().copied()
    }
}

impl Integrator<'_> {
    /// Albedo at a hit of an object.
    pub(super) fn albedo<R: Real>(&self, hit: &Hit<R>, ray: &Ray<R>, object: R) -> Vec3<R> {
        let black = vec3(object.constant(0.0), object.constant(0.0), object.constant(0.0));
        self.blend(
            hit,
            ray,
            // Layers are sampled at the center of a pixel.
            [black; 2],
            object,
            black,
            |slot, place| self.scene.used_materials()[slot].albedo(place),
            |sum, color, share| color.mul_add(share, sum),
        )
    }

    /// Evaluations of the scene's distance in one call of `shade`, `shade_with_specular`, or `shadow_transparency` of a
    /// scene that catches shadows.
    pub(super) fn shade_evaluations(&self) -> f32 {
        if self.materials.single_slot.is_some() { 0.0 } else { 1.0 }
    }

    /// Fraction of the background that is seen through shadow catchers at a hit; `None` if the scene has none.
    pub(super) fn shadow_transparency<R: Real>(
        &self,
        hit: &Hit<R>,
        ray: &Ray<R>,
        light: &IncidentLight<R>,
    ) -> Option<R> {
        let zero = hit.t.constant(0.0);
        let of_slot = |slot: usize| self.scene.used_materials()[slot].transparency(light);
        if !self.materials.catches_shadows {
            return None;
        }
        if let Some(only) = self.materials.single_slot {
            return of_slot(only).map(|clear| self.asked_for(only, clear));
        }
        let object = self.nearest_object(hit.position).1;
        let add = |sum: R, clear: R, share: R| clear.mul_add(share, sum);
        Some(self.blend(hit, ray, [hit.position; 2], object, zero, |slot, _| of_slot(slot).unwrap_or(zero), add))
    }

    /// Shaded color at a hit.
    pub(super) fn shade<R: Real>(&self, hit: &Hit<R>, ray: &Ray<R>, light: &IncidentLight<R>) -> Vec3<R> {
        if let Some(only) = self.materials.single_slot {
            let place = shading_point(hit, ray, self.footprint(hit, ray));
            return self.scene.used_materials()[only].shade(&place, light).map(|c| self.asked_for(only, c));
        }
        let object = self.nearest_object(hit.position).1;
        let black = vec3(object.constant(0.0), object.constant(0.0), object.constant(0.0));
        self.blend(
            hit,
            ray,
            self.footprint(hit, ray),
            object,
            black,
            |slot, place| self.scene.used_materials()[slot].shade(place, light),
            |sum, color, share| color.mul_add(share, sum),
        )
    }

    /// Shaded color at a hit, and its specular BSDF.
    pub(super) fn shade_with_specular<R: Real>(
        &self,
        hit: &Hit<R>,
        ray: &Ray<R>,
        light: &IncidentLight<R>,
    ) -> (Vec3<R>, SpecularBsdf<R>) {
        let (zero, one) = (hit.t.constant(0.0), hit.t.constant(1.0));
        let black = vec3(zero, zero, zero);
        let matte = SpecularBsdf { f0: black, roughness: one, transmission: black, ior: one };
        if let Some(only) = self.materials.single_slot {
            let place = shading_point(hit, ray, self.footprint(hit, ray));
            let (color, finish) = self.shade_slot(only, &place, light, matte);
            return (color.map(|c| self.asked_for(only, c)), finish);
        }
        let object = self.nearest_object(hit.position).1;
        let none = SpecularBsdf { roughness: zero, ior: zero, ..matte };
        self.blend(
            hit,
            ray,
            self.footprint(hit, ray),
            object,
            (black, none),
            |slot, place| self.shade_slot(slot, place, light, matte),
            |(sum, finish), (color, own), share| {
                let finish = SpecularBsdf {
                    f0: own.f0.mul_add(share, finish.f0),
                    roughness: own.roughness.mul_add(share, finish.roughness),
                    transmission: own.transmission.mul_add(share, finish.transmission),
                    ior: own.ior.mul_add(share, finish.ior),
                };
                (color.mul_add(share, sum), finish)
            },
        )
    }

    /// Index of the nearest object at a hit; 0 if nothing depends on it.
    pub(super) fn object_at<R: Real>(&self, hit: &Hit<R>) -> R {
        if self.materials.single_slot.is_some() && !self.asks_for_objects() {
            return hit.t.constant(0.0);
        }
        self.nearest_object(hit.position).1
    }

    /// Evaluations of the scene's distance in one call of `object_at` and `bsdf`.
    pub(super) fn object_evaluations(&self) -> f32 {
        if self.asks_for_objects() { 1.0 } else { self.shade_evaluations() }
    }

    /// Whether a path asks for the object of a surface, whatever materials there are.
    fn asks_for_objects(&self) -> bool {
        self.emitters.has_objects() || self.has_groups_of_objects()
    }

    /// BSDF at a hit of an object.
    pub(super) fn bsdf<R: Real>(&self, hit: &Hit<R>, ray: &Ray<R>, object: R) -> Bsdf<R> {
        let materials = self.scene.used_materials();
        if let Some(only) = self.materials.single_slot {
            let place = shading_point(hit, ray, self.footprint(hit, ray));
            let bsdf = materials[only].bsdf(&place);
            return Bsdf { emission: bsdf.emission.map(|c| self.asked_for(only, c)), ..bsdf };
        }
        let of_slot = |slot: usize, place: &ShadingPoint<R>| materials[slot].bsdf(place);
        self.blend(hit, ray, self.footprint(hit, ray), object, Bsdf::nothing(object), of_slot, Bsdf::plus)
    }

    /// A number of a material, which is recorded as asked for.
    fn asked_for<R: Real>(&self, slot: usize, number: R) -> R {
        self.visits.as_ref().map_or(number, |visits| number.max(visits.of_material(number, slot)))
    }

    fn shade_slot<R: Real>(
        &self,
        slot: usize,
        place: &ShadingPoint<R>,
        light: &IncidentLight<R>,
        matte: SpecularBsdf<R>,
    ) -> (Vec3<R>, SpecularBsdf<R>) {
        let material = &self.scene.used_materials()[slot];
        (material.shade(place, light), material.specular(place).unwrap_or(matte))
    }

    /// Sum of a function of the materials at a hit of an object, weighted by their material weights.
    #[expect(clippy::too_many_arguments, reason = "a hit, how it was reached, and the four parts of a sum")]
    fn blend<R: Real, T: Bundle<R>>(
        &self,
        hit: &Hit<R>,
        ray: &Ray<R>,
        footprint: [Vec3<R>; 2],
        object: R,
        nothing: T,
        of_slot: impl Fn(usize, &ShadingPoint<R>) -> T,
        add: impl Fn(T, T, R) -> T,
    ) -> T {
        let mut sum = nothing;
        for material in self.hit_materials(hit, footprint, object) {
            let place = ShadingPoint {
                local_point: material.point,
                local_normal: material.own_normal,
                ..shading_point(hit, ray, material.footprint)
            };
            let is_seen = material.weight.above(0.0);
            let part = R::when(is_seen, nothing, || of_slot(material.slot, &place));
            let weight = match self.visits {
                None => material.weight,
                Some(_) => R::when(is_seen, material.weight, || self.asked_for(material.slot, material.weight)),
            };
            sum = add(sum, part, weight);
        }
        sum
    }

    /// Footprint of one pixel sample on the surface at a hit: two vectors of half its width, at right angles as seen
    /// from the camera. At grazing angles its length is limited to fifty times its width.
    fn footprint<R: Real>(&self, hit: &Hit<R>, ray: &Ray<R>) -> [Vec3<R>; 2] {
        let half = self.seen.at(hit.t);
        let facing = (-ray.direction.dot(hit.normal)).at_least(0.02);
        let (right, up) = orthonormal_basis(ray.direction);
        [right, up].map(|side| ray.direction.mul_add(side.dot(hit.normal) / facing, side) * half)
    }

    /// Slots of materials, and their weights at a hit of an object.
    pub(super) fn slot_weights<R: Real>(&self, hit: &Hit<R>, object: R) -> Vec<(usize, R)> {
        let all = self.hit_materials(hit, [hit.position; 2], object);
        all.into_iter().map(|HitMaterial { slot, weight, .. }| (slot, weight)).collect()
    }

    /// Slot of the material with the greatest weight at a hit of an object.
    pub(super) fn heaviest_material(&self, hit: &Hit<f32>, object: f32) -> Option<usize> {
        let all = self.hit_materials(hit, [hit.position; 2], object);
        let heaviest = all.iter().filter(|one| one.weight > 0.0).max_by(|a, b| a.weight.total_cmp(&b.weight));
        heaviest.map(|one| one.slot)
    }

    /// Materials at a hit of an object, each with its point in the space of its textures.
    fn hit_materials<R: Real>(&self, hit: &Hit<R>, footprint: [Vec3<R>; 2], object: R) -> Vec<HitMaterial<R>> {
        let (p, zero) = (hit.position, object.constant(0.0));
        let material = |slot| HitMaterial { slot, weight: zero, point: p, own_normal: hit.normal, footprint };
        let mut all: Vec<HitMaterial<R>> = self.materials.slots().map(material).collect();
        for &index in &self.surfaces {
            let tree = &self.scene.objects[index];
            let here = (object - index as f32).abs().below(0.5);
            let own = tree.material.slot();
            if self.materials.has_own_materials[index] {
                if self.cells.is_none() {
                    self.add_weights(&mut all, hit, footprint, |_| here, |p| self.material_weights(index, p));
                }
            } else if let Some(place) = self.materials.place_of(own) {
                all[place].weight = R::select(here, zero.constant(1.0), all[place].weight);
            }
        }
        if let Some(cells) = self.cells.as_ref().filter(|cells| cells.program().has_materials()) {
            let is_here = |coat: &MaterialWeight<R>| coat.weight.above(0.0);
            self.add_weights(&mut all, hit, footprint, is_here, |p| cells.material_weights(p));
        }
        all
    }

    /// Adds the weights of an object's materials where it is hit, and their points in the space of their textures.
    fn add_weights<R: Real>(
        &self,
        all: &mut [HitMaterial<R>],
        hit: &Hit<R>,
        footprint: [Vec3<R>; 2],
        is_here: impl Fn(&MaterialWeight<R>) -> R::Mask,
        weights_at: impl Fn(Vec3<R>) -> Vec<MaterialWeight<R>>,
    ) {
        let p = hit.position;
        let coats = weights_at(p);
        // Map a short offset along the normal to the local space.
        let further = self.materials.needs_own_normal.then(|| weights_at(hit.normal.mul_add(probe_offset(p), p)));
        // Footprint in that space, from its mapped end points.
        let ends = self.materials.needs_footprint.then(|| footprint.map(|end| weights_at(p + end)));
        for (number, coat) in coats.iter().enumerate() {
            let Some(place) = coat.slot.and_then(|slot| self.materials.place_of(slot)) else { continue };
            let material = &mut all[place];
            let here = is_here(coat);
            material.weight = R::select(here, coat.weight, p.x.constant(0.0)) + material.weight;
            if self.scene.used_materials()[material.slot].is_textured() {
                material.point = Vec3::select(here, coat.point, material.point);
                if let Some(further) = &further {
                    let own_normal = (further[number].point - coat.point).normalize();
                    material.own_normal = Vec3::select(here, own_normal, material.own_normal);
                }
                if let Some(ends) = &ends {
                    for (seen, end) in material.footprint.iter_mut().zip(ends) {
                        *seen = Vec3::select(here, end[number].point - coat.point, *seen);
                    }
                }
            }
        }
    }

    /// Material weights of an object at `p`.
    fn material_weights<R: Real>(&self, index: usize, p: Vec3<R>) -> Vec<MaterialWeight<R>> {
        let tree = &self.scene.objects[index];
        let sample: DistanceWithMaterials<R> = tree.shape.sample(p);
        let mut weights = sample.paint(tree.material.slot(), p).weights().to_vec();
        if let Some(visits) = &self.visits {
            let visited = visits.at(p);
            for weight in &mut weights {
                weight.weight = weight.weight.max(visited);
                weight.point = weight.point.map(|c| c.max(visited));
            }
        }
        weights
    }
}

/// Offset along a normal for measuring it in another space.
fn probe_offset<R: Real>(p: Vec3<R>) -> R {
    let size = vec3(p.x.abs(), p.y.abs(), p.z.abs()).max_element();
    (size + 1.0) * 1e-2
}
