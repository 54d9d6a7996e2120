//! A light that belongs to groups.

use std::ops::Deref;

use serde::{Serialize, Serializer};

use super::{Light, LightBody, LightSample, LightShape};
use crate::backgrounds::Day;
use crate::real::{Real, Vec3};
use crate::seek::{FrameTime, Seek, SeekError};
use crate::values::Placement;

/// A light of a scene, and the placements of the groups that it belongs to, the outermost first.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedLight {
    /// The light.
    pub light: Light,
    /// The placements.
    pub placements: Vec<Placement>,
}

impl PlacedLight {
    /// Light that arrives at `p` unoccluded, see `LightSource::sample`.
    pub fn sample_at<R: Real>(
        &self,
        p: Vec3<R>,
        farthest: R,
        day: Option<&Day>,
        pair: impl FnOnce() -> (R, R),
    ) -> Option<(LightSample<R>, R)> {
        let inside = self.placements.iter().fold(p, |p, placement| placement.to_group(p));
        let (sample, distance) = self.light.sample(inside, farthest, day, pair)?;
        let outward = self.placements.iter().rev();
        let direction = outward.fold(sample.direction, |direction, placement| placement.direction_to_scene(direction));
        Some((LightSample { direction, ..sample }, distance))
    }

    /// Center and radius of a ball around it in the scene, if it has a place.
    pub fn place_in_scene(&self) -> Option<(Vec3<f32>, f32)> {
        let (center, radius) = self.light.place()?;
        Some((self.placements.iter().rev().fold(center, |p, placement| placement.to_scene(p)), radius))
    }

    /// Its shape in the scene and its radiance, if it is seen.
    pub fn body_in_scene(&self) -> Option<LightBody> {
        let LightBody { shape, radiance } = self.light.body()?;
        let outward = || self.placements.iter().rev();
        let point = |p| outward().fold(p, |p, placement| placement.to_scene(p));
        let direction = |d| outward().fold(d, |d, placement| placement.direction_to_scene(d));
        let shape = match shape {
            LightShape::Sphere { center, radius } => LightShape::Sphere { center: point(center), radius },
            LightShape::Flat { center, normal, sides, outline } => LightShape::Flat {
                center: point(center),
                normal: direction(normal),
                sides: sides.map(direction),
                outline,
            },
        };
        Some(LightBody { shape, radiance })
    }

    /// About how much light arrives at `p` unoccluded, see `LightSource::strength`.
    pub fn strength_at<R: Real>(&self, p: Vec3<R>, day: Option<&Day>) -> R {
        self.light.strength(self.placements.iter().fold(p, |p, placement| placement.to_group(p)), day)
    }

    /// Precomputes values that all points use.
    pub(crate) fn precompute(&mut self) {
        self.light.precompute();
    }
}

impl From<Light> for PlacedLight {
    fn from(light: Light) -> Self {
        Self { light, placements: Vec::new() }
    }
}

impl Deref for PlacedLight {
    type Target = Light;

    fn deref(&self) -> &Light {
        &self.light
    }
}

impl Seek for PlacedLight {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        let Self { light, placements } = self;
        Ok(light.seek(clock)? | placements.seek(clock)?)
    }
}

/// A light in no group is written as such.
impl Serialize for PlacedLight {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { light, placements } = self;
        if placements.is_empty() { light.serialize(serializer) } else { (light, placements).serialize(serializer) }
    }
}
