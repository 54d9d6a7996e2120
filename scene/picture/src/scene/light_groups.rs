//! Lights, objects and backgrounds of each light group of a picture.

use serde::Serialize;

use super::Scene;
use crate::light_groups::LightGroup;

/// The light groups of a picture, and what belongs to each: as the group's place in the picture's list, or the place after
/// the last for light of no listed group.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LightGroups {
    names: Vec<LightGroup>,
    /// Of each light.
    pub lights: Vec<usize>,
    /// Of each object.
    pub objects: Vec<usize>,
    /// Of the sky and the background.
    pub sky: usize,
}

impl LightGroups {
    /// The light groups with these names of a scene; `None` if there are no names.
    pub fn of(names: &[LightGroup], scene: &Scene) -> Option<Self> {
        if names.is_empty() {
            return None;
        }
        let place = |group: Option<&LightGroup>| {
            group.and_then(|group| names.iter().position(|name| name == group)).unwrap_or(names.len())
        };
        let lights: Vec<usize> = scene.lights.iter().map(|light| place(light.options().group)).collect();
        let sky = scene.sky_lights().next().map_or(names.len(), |index| lights[index]);
        let objects = scene.objects.iter().map(|object| place(object.light_group.as_ref())).collect();
        Some(Self { names: names.to_vec(), lights, objects, sky })
    }

    /// The place of light of no listed group.
    pub fn rest(&self) -> usize {
        self.names.len()
    }

    /// Objects of listed groups: the first and the last of those that follow one another, and their group's place.
    pub fn runs_of_objects(&self) -> Vec<([usize; 2], usize)> {
        let mut runs: Vec<([usize; 2], usize)> = Vec::new();
        for (index, &place) in self.objects.iter().enumerate().filter(|(_, place)| **place < self.rest()) {
            match runs.last_mut().filter(|([_, last], of_last)| *of_last == place && last + 1 == index) {
                Some(([_, last], _)) => *last = index,
                None => runs.push(([index; 2], place)),
            }
        }
        runs
    }
}
