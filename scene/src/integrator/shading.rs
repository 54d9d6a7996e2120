//! Material shading at a hit: evaluates each material there and blends the results by weight.

use super::{Hit, Program};
use crate::camera::Ray;
use crate::materials::microfacet::frame;
use crate::materials::{Finish, Lighting, Place, Shade};
use crate::nodes::{Coat, Painted, Sample};
use crate::real::{Bundle, Real, Vec3, vec3};
use crate::scene::Scene;

/// Which materials are worn where: what a scene's structure tells.
#[derive(Clone, Debug)]
pub(super) struct Clothes {
    /// Whether an object's tree says materials of its own.
    painted: Vec<bool>,
    /// Materials that some surface may wear.
    worn: Vec<usize>,
    /// The material of all surfaces, where there is only one and it looks the same from every space.
    only: Option<usize>,
    /// Whether some material needs the normal in its own space.
    needs_own_normal: bool,
    /// Whether some texture needs the footprint in its own space.
    needs_footprint: bool,
}

/// A material on a surface.
struct Worn<R> {
    slot: usize,
    share: R,
    point: Vec3<R>,
    own_normal: Vec3<R>,
    footprint: [Vec3<R>; 2],
}

impl Clothes {
    pub(super) fn new(scene: &Scene) -> Self {
        let slots = scene.slots();
        let painted: Vec<bool> = scene.objects.iter().map(|object| object.shape.is_painted()).collect();
        let worn: Vec<usize> = (0..slots.len()).filter(|&slot| !slots[slot].is_medium()).collect();
        let is_textured = |slot: usize| slots[slot].is_textured() && painted.contains(&true);
        let only = match worn[..] {
            [only] if slots.len() == 1 && !is_textured(only) => Some(only),
            _ => None,
        };
        let needs_own_normal = worn.iter().any(|&slot| slots[slot].needs_own_normal());
        let needs_footprint = worn.iter().any(|&slot| slots[slot].needs_footprint());
        Self { painted, worn, only, needs_own_normal, needs_footprint }
    }

    pub(super) fn slots(&self) -> impl Iterator<Item = usize> + '_ {
        self.worn.iter().copied()
    }
}

impl Program<'_> {
    /// The surface's own colour at a hit of an object.
    #[inline(always)]
    pub(super) fn albedo<R: Real>(&self, hit: &Hit<R>, ray: &Ray<R>, object: R) -> Vec3<R> {
        let black = vec3(object.splat(0.0), object.splat(0.0), object.splat(0.0));
        self.blend(
            hit,
            ray,
            // Layers are what is in the middle of a pixel.
            [black; 2],
            object,
            black,
            #[inline(always)]
            |slot, place| self.scene.slots()[slot].albedo(place),
            #[inline(always)]
            |sum, color, share| color.mul_add(share, sum),
        )
    }

    /// The shaded colour at a hit.
    pub(super) fn dress<R: Real>(&self, hit: &Hit<R>, ray: &Ray<R>, light: &Lighting<R>) -> Vec3<R> {
        hit.distance.vectorize(
            #[inline(always)]
            || {
                if let Some(only) = self.clothes.only {
                    return self.scene.slots()[only].shade(&Place::of(hit, ray, self.footprint(hit, ray)), light);
                }
                let object = self.nearest(hit.position).1;
                let black = vec3(object.splat(0.0), object.splat(0.0), object.splat(0.0));
                self.blend(
                    hit,
                    ray,
                    self.footprint(hit, ray),
                    object,
                    black,
                    #[inline(always)]
                    |slot, place| self.scene.slots()[slot].shade(place, light),
                    #[inline(always)]
                    |sum, color, share| color.mul_add(share, sum),
                )
            },
        )
    }

    /// The shaded colour at a hit, and how it sends rays on.
    pub(super) fn dress_and_finish<R: Real>(
        &self,
        hit: &Hit<R>,
        ray: &Ray<R>,
        light: &Lighting<R>,
    ) -> (Vec3<R>, Finish<R>) {
        hit.distance.vectorize(
            #[inline(always)]
            || {
                let (zero, one) = (hit.distance.splat(0.0), hit.distance.splat(1.0));
                let black = vec3(zero, zero, zero);
                let matt = Finish { mirrored: black, roughness: one, passed: black, ior: one };
                if let Some(only) = self.clothes.only {
                    return self.of_slot(only, &Place::of(hit, ray, self.footprint(hit, ray)), light, matt);
                }
                let object = self.nearest(hit.position).1;
                let none = Finish { roughness: zero, ior: zero, ..matt };
                self.blend(
                    hit,
                    ray,
                    self.footprint(hit, ray),
                    object,
                    (black, none),
                    #[inline(always)]
                    |slot, place| self.of_slot(slot, place, light, matt),
                    #[inline(always)]
                    |(sum, finish), (color, own), share| {
                        let finish = Finish {
                            mirrored: own.mirrored.mul_add(share, finish.mirrored),
                            roughness: own.roughness.mul_add(share, finish.roughness),
                            passed: own.passed.mul_add(share, finish.passed),
                            ior: own.ior.mul_add(share, finish.ior),
                        };
                        (color.mul_add(share, sum), finish)
                    },
                )
            },
        )
    }

    #[inline(always)]
    fn of_slot<R: Real>(
        &self,
        slot: usize,
        place: &Place<R>,
        light: &Lighting<R>,
        matt: Finish<R>,
    ) -> (Vec3<R>, Finish<R>) {
        let material = &self.scene.slots()[slot];
        (material.shade(place, light), material.finish(place).unwrap_or(matt))
    }

    /// What the materials at a hit of an object give, added up by their shares.
    #[inline(always)]
    fn blend<R: Real, T: Bundle<R>>(
        &self,
        hit: &Hit<R>,
        ray: &Ray<R>,
        footprint: [Vec3<R>; 2],
        object: R,
        nothing: T,
        of_slot: impl Fn(usize, &Place<R>) -> T,
        add: impl Fn(T, T, R) -> T,
    ) -> T {
        let mut sum = nothing;
        for worn in self.worn(hit, footprint, object) {
            let place = Place { point: worn.point, own_normal: worn.own_normal, ..Place::of(hit, ray, worn.footprint) };
            let part = R::when(
                worn.share.above(0.0),
                nothing,
                #[inline(always)]
                || of_slot(worn.slot, &place),
            );
            sum = add(sum, part, worn.share);
        }
        sum
    }

    /// What one sample of a pixel covers of the surface at a hit: two ways of half its width, at right angles to
    /// each other as the camera sees them. A surface seen edge on counts as seen at a fiftieth of its length.
    #[inline(always)]
    fn footprint<R: Real>(&self, hit: &Hit<R>, ray: &Ray<R>) -> [Vec3<R>; 2] {
        let half = self.seen.at(hit.distance);
        let facing = (-ray.direction.dot(hit.normal)).at_least(0.02);
        let (right, up) = frame(ray.direction);
        [right, up].map(
            #[inline(always)]
            |side| ray.direction.mul_add(side.dot(hit.normal) / facing, side) * half,
        )
    }

    /// The materials at a hit of an object, and where each sees it.
    #[inline(always)]
    fn worn<R: Real>(&self, hit: &Hit<R>, footprint: [Vec3<R>; 2], object: R) -> Vec<Worn<R>> {
        let (p, zero) = (hit.position, object.splat(0.0));
        let worn = |slot| Worn { slot, share: zero, point: p, own_normal: hit.normal, footprint };
        let mut all: Vec<Worn<R>> = self.clothes.slots().map(worn).collect();
        let place_of = |slot: u32| self.clothes.worn.iter().position(|&worn| worn == slot as usize);
        for &index in &self.surfaces {
            let tree = &self.scene.objects[index];
            let here = (object - index as f32).abs().below(0.5);
            let own = tree.material.slot();
            if !self.clothes.painted[index] {
                if let Some(place) = place_of(own) {
                    all[place].share = R::select(here, zero.splat(1.0), all[place].share);
                }
                continue;
            }
            let coats = self.coats(index, p);
            // How the normal's own space sees a short way along it.
            let further = self.clothes.needs_own_normal.then(|| self.coats(index, hit.normal.mul_add(reach(p), p)));
            // The footprint in that space: where its ends are seen.
            let ends = self.clothes.needs_footprint.then(|| footprint.map(|end| self.coats(index, p + end)));
            for (number, coat) in coats.iter().enumerate() {
                let Some(place) = place_of(coat.slot.unwrap_or(own)) else { continue };
                let worn = &mut all[place];
                worn.share = R::select(here, coat.share, zero) + worn.share;
                if self.scene.slots()[worn.slot].is_textured() {
                    worn.point = Vec3::select(here, coat.place, worn.point);
                    if let Some(further) = &further {
                        let own_normal = (further[number].place - coat.place).normalize();
                        worn.own_normal = Vec3::select(here, own_normal, worn.own_normal);
                    }
                    if let Some(ends) = &ends {
                        for (seen, end) in worn.footprint.iter_mut().zip(ends) {
                            *seen = Vec3::select(here, end[number].place - coat.place, *seen);
                        }
                    }
                }
            }
        }
        all
    }

    /// The coats of an object's tree at `p`.
    #[inline(always)]
    fn coats<R: Real>(&self, index: usize, p: Vec3<R>) -> Vec<Coat<R>> {
        let tree = &self.scene.objects[index];
        let sample: Painted<R> = tree.shape.sample(p);
        sample.paint(tree.material.slot(), p).coats().to_vec()
    }
}

/// How far along a normal one goes to see it from another space.
#[inline(always)]
fn reach<R: Real>(p: Vec3<R>) -> R {
    let size = vec3(p.x.abs(), p.y.abs(), p.z.abs()).max_element();
    (size + 1.0) * 1e-2
}
