//! Light by its group: what the layers of light groups are made of.
//!
//! A picture's groups are part of the structure of its formulas: without any, nothing here adds a number to them.

use super::Integrator;
use super::colors::Colors;
use crate::limits::MAX_LIGHT_GROUPS;
use crate::real::{Real, vec3};
use crate::scene::LightGroups;

/// Light of each group of a picture, and after those the light of no listed group; nothing if the picture has no groups.
pub type GroupedLight<R> = Colors<R, { MAX_LIGHT_GROUPS + 1 }>;

/// The light groups of a picture, as its formulas ask for them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct GroupPlaces {
    groups: LightGroups,
    /// Objects of listed groups, see [`LightGroups::runs_of_objects`].
    runs: Vec<([usize; 2], usize)>,
}

impl GroupPlaces {
    pub(super) fn new(groups: LightGroups) -> Self {
        let runs = groups.runs_of_objects();
        Self { groups, runs }
    }
}

impl Integrator<'_> {
    /// No light.
    pub(super) fn no_grouped_light<R: Real>(&self, zero: R) -> GroupedLight<R> {
        GroupedLight::of(std::iter::repeat_n(vec3(zero, zero, zero), self.group_count()))
    }

    /// Number of the picture's light groups, with the rest.
    pub(super) fn group_count(&self) -> usize {
        self.light_groups.as_ref().map_or(0, |places| places.groups.rest() + 1)
    }

    /// Whether the group of a surface's own light depends on the object.
    pub(super) fn has_groups_of_objects(&self) -> bool {
        self.light_groups.as_ref().is_some_and(|places| !places.runs.is_empty())
    }

    /// Place of the group of an object's own light.
    pub(super) fn group_of_object<R: Real>(&self, object: R) -> Option<R> {
        let GroupPlaces { groups, runs } = self.light_groups.as_ref()?;
        let rest = object.constant(groups.rest() as f32);
        Some(runs.iter().fold(rest, |place, &([first, last], own)| {
            let is_in = object.above(first as f32 - 0.5) & object.below(last as f32 + 0.5);
            R::select(is_in, object.constant(own as f32), place)
        }))
    }

    /// Place of a group of the picture; any if it has none.
    pub(super) fn group(&self, place: impl FnOnce(&LightGroups) -> usize) -> usize {
        self.light_groups.as_ref().map_or(0, |places| place(&places.groups))
    }

    /// Place of a group of the picture as a number; `None` if it has none.
    pub(super) fn group_number<R: Real>(&self, like: R, place: impl FnOnce(&LightGroups) -> usize) -> Option<R> {
        self.light_groups.as_ref().map(|places| like.constant(place(&places.groups) as f32))
    }
}
