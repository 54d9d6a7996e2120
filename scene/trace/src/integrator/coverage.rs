//! Coverage of pixels by objects and by materials: the layers of mattes.

use super::Hit;
use super::Integrator;
use crate::animation::JobAtFrame;
use crate::film::Layer;
use crate::mattes::Matte;
use crate::real::{Bundle, Merge, Real, bundle};
use crate::sampling::{PixelSampler, Sampler};

/// Maximum number of samples of a pixel that are counted.
pub const MAX_COVERAGE_SAMPLES: u32 = 64;
/// Number of things whose coverage a pixel has.
pub const RANKS: usize = 6;

/// A thing that a pixel shows.
#[derive(Clone, Copy, Debug)]
pub struct Rank<R> {
    /// Its id, as a number's bits; 0 for none.
    pub id: R,
    /// Fraction of the samples that see it first.
    pub coverage: R,
}

bundle!(Rank { id, coverage });

/// The things that a pixel shows, the greatest coverage first; of equal ones, the lesser id.
#[derive(Clone, Copy, Debug)]
pub struct Ranks<R>(pub [Rank<R>; RANKS]);

impl<R: Real> Bundle<R> for Ranks<R> {
    fn merge(self, other: Self, how: &mut impl Merge<R>) -> Self {
        let mut others = other.0.into_iter();
        Self(self.0.map(|own| others.next().map_or(own, |other| own.merge(other, how))))
    }
}

/// The things that a pixel shows, if its picture has these layers.
#[derive(Clone, Copy, Debug)]
pub struct Coverage<R> {
    /// Objects.
    pub objects: Option<Ranks<R>>,
    /// Materials.
    pub materials: Option<Ranks<R>>,
}

bundle!(Coverage { objects, materials });

/// The ids that a picture shows.
#[derive(Clone, Debug)]
pub(super) struct MatteIds {
    /// By the index of the object.
    objects: Option<Vec<u32>>,
    /// By the slot of the material.
    materials: Option<Vec<u32>>,
}

impl MatteIds {
    /// The ids of a frame's mattes.
    pub(super) fn of(at_frame: &JobAtFrame<'_>) -> Self {
        let mattes = at_frame.mattes();
        let ids = |layer| mattes.iter().find(|matte| matte.layer() == layer).map(Matte::ids);
        Self { objects: ids(Layer::CryptoObject), materials: ids(Layer::CryptoMaterial) }
    }

    /// By the index of the object, if the picture shows objects.
    pub(super) fn objects(&self) -> Option<&[u32]> {
        self.objects.as_deref()
    }
}

impl<R: Real> Ranks<R> {
    fn nothing(like: R) -> Self {
        let zero = like.constant(0.0);
        Self([Rank { id: zero, coverage: zero }; RANKS])
    }

    /// Counts a sample that sees the thing of an id; things after the first six are left out.
    fn with(self, id: R) -> Self {
        let mut is_counted = id.constant(1.0).below(0.0);
        Self(self.0.map(|Rank { id: known, coverage }| {
            let is_free = coverage.below(0.5);
            let is_here = (is_free | !(known.lt(id) | id.lt(known))) & !is_counted;
            is_counted = is_counted | is_here;
            Rank { id: R::select(is_here, id, known), coverage: R::select(is_here, coverage + 1.0, coverage) }
        }))
    }

    /// In their order, with counts as fractions.
    fn sorted(self, share: R) -> Self {
        let mut ranks = self.0;
        for end in (1..RANKS).rev() {
            for first in 0..end {
                let (a, b) = (ranks[first], ranks[first + 1]);
                let is_tied = !(a.coverage.lt(b.coverage) | b.coverage.lt(a.coverage));
                let swaps = a.coverage.lt(b.coverage) | (is_tied & b.id.lt(a.id));
                ranks[first] = Rank::select(swaps, b, a);
                ranks[first + 1] = Rank::select(swaps, a, b);
            }
        }
        Self(ranks.map(|rank| Rank { coverage: rank.coverage * share, ..rank }))
    }
}

impl<R: Real> Rank<R> {
    fn select(mask: R::Mask, yes: Self, no: Self) -> Self {
        Self { id: R::select(mask, yes.id, no.id), coverage: R::select(mask, yes.coverage, no.coverage) }
    }
}

impl Integrator<'_> {
    /// The things that the pixel in column `x` and row `y` shows, by its first samples.
    pub fn coverage<R: Real>(&self, x: R, y: R) -> Coverage<R> {
        let MatteIds { objects, materials } = &self.matte_ids;
        let nothing = |ids: &Option<Vec<u32>>| ids.as_ref().map(|_| Ranks::nothing(x));
        let start = Coverage { objects: nothing(objects), materials: nothing(materials) };
        let (counts, share) = self.fold_first_samples([x, y], MAX_COVERAGE_SAMPLES, start, |counts, pixel, sampler| {
            self.count_sample(counts, pixel, sampler)
        });
        let sorted = |ranks: Option<Ranks<R>>| ranks.map(|ranks| ranks.sorted(share));
        Coverage { objects: sorted(counts.objects), materials: sorted(counts.materials) }
    }

    fn count_sample<R: Real>(&self, counts: Coverage<R>, pixel: &PixelSampler<R>, sampler: &Sampler<R>) -> Coverage<R> {
        let ray = self.ray_of_sample(pixel, sampler);
        let marched = self.march(&ray);
        let light = self.seen_light(&ray, marched.t);
        let is_seen = light.map_or(marched.hit.0, |(is_nearer, ..)| marched.hit.0 & !is_nearer);
        R::when(is_seen, counts, || {
            let hit = self.hit(&ray, &marched);
            let object = self.nearest_object(hit.position).1;
            let MatteIds { objects, materials } = &self.matte_ids;
            let of_object = objects.as_ref().map(|ids| self.id_of_object(ids, &hit, object));
            let of_material = materials.as_ref().map(|ids| self.id_of_material(ids, &hit, object));
            let with = |ranks: Option<Ranks<R>>, id: Option<R>| Some(ranks?.with(id?));
            Coverage { objects: with(counts.objects, of_object), materials: with(counts.materials, of_material) }
        })
    }

    fn id_of_object<R: Real>(&self, ids: &[u32], hit: &Hit<R>, object: R) -> R {
        if let Some(cells) = &self.cells {
            return cells.id_of_nearest(hit.position);
        }
        self.surfaces.iter().fold(object.constant(0.0), |id, &index| {
            let is_here = (object - index as f32).abs().below(0.5);
            R::select(is_here, uniform_id(object, ids[index]), id)
        })
    }

    /// Id of the material with the greatest weight; of equal ones, of that in the first slot.
    fn id_of_material<R: Real>(&self, ids: &[u32], hit: &Hit<R>, object: R) -> R {
        let zero = object.constant(0.0);
        let (_, id) =
            self.slot_weights(hit, object).into_iter().fold((zero, zero), |(heaviest, id), (slot, weight)| {
                let is_heavier = heaviest.lt(weight);
                (weight.max(heaviest), R::select(is_heavier, uniform_id(object, ids[slot]), id))
            });
        id
    }
}

fn uniform_id<R: Real>(like: R, id: u32) -> R {
    R::from_bits(like.uniform_bits(id))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ranked(seen: &[f32]) -> Vec<(f32, f32)> {
        let counts = seen.iter().fold(Ranks::nothing(0.0), |ranks, &id| ranks.with(id));
        counts.sorted(1.0 / seen.len() as f32).0.iter().map(|rank| (rank.id, rank.coverage)).collect()
    }

    #[test]
    fn the_greatest_coverage_is_first_and_of_equal_ones_the_lesser_id() {
        let none = (0.0, 0.0);
        assert_eq!(ranked(&[3.0, -5.0, 3.0, 1e30]), [(3.0, 0.5), (-5.0, 0.25), (1e30, 0.25), none, none, none]);
        assert_eq!(ranked(&[7.0; 4]), [(7.0, 1.0), none, none, none, none, none]);
    }

    #[test]
    fn a_seventh_thing_is_left_out() {
        let seen = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 6.0];
        let ids: Vec<f32> = ranked(&seen).into_iter().map(|(id, _)| id).collect();
        assert_eq!(ids, [6.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
    }
}
