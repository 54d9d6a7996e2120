//! Regions in which copies are scattered, around the origin.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::real::{Vec3, vec3};
use crate::seek::{FrameTime, Seek, SeekError};
use crate::values::{ConstantLength, ConstantLengthOrZero};

/// Region around the origin, the same in all frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ScatterRegion {
    /// See [`BoxRegion`].
    Box(BoxRegion),
    /// See [`DiscRegion`].
    Disc(DiscRegion),
    /// See [`BallRegion`].
    Sphere(BallRegion),
}

/// The inside of a box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BoxRegion {
    /// Size along x, y and z, in scene units; 0 for a flat one.
    size: [ConstantLengthOrZero; 3],
}

/// A horizontal disc, at height 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DiscRegion {
    /// Radius, in scene units.
    radius: ConstantLength,
}

/// The inside of a sphere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BallRegion {
    /// Radius, in scene units.
    radius: ConstantLength,
}

impl ScatterRegion {
    /// Half its size along x, y and z.
    pub(super) fn half_size(&self) -> Vec3<f32> {
        match self {
            Self::Box(BoxRegion { size: [x, y, z] }) => vec3(0.5 * x.get(), 0.5 * y.get(), 0.5 * z.get()),
            Self::Disc(DiscRegion { radius }) => vec3(radius.get(), 0.0, radius.get()),
            Self::Sphere(BallRegion { radius }) => vec3(radius.get(), radius.get(), radius.get()),
        }
    }

    /// The point of its box at these fractions, from 0 to 1, if that is in the region.
    pub(super) fn point(&self, fractions: [f32; 3]) -> Option<Vec3<f32>> {
        let [x, y, z] = fractions.map(|fraction| 2.0 * fraction - 1.0);
        let in_unit = match self {
            Self::Box(_) => true,
            Self::Disc(_) => x * x + z * z <= 1.0,
            Self::Sphere(_) => x * x + y * y + z * z <= 1.0,
        };
        in_unit.then(|| self.half_size().mul_elementwise(vec3(x, y, z)))
    }

    /// Place of a point along a curve on which points near each other are mostly near each other, so that the bounding
    /// volume hierarchy of a list in this order is tight: Guy M. Morton, "A computer oriented geodetic data base", IBM,
    /// 1966.
    pub(super) fn place_along_curve(&self, p: Vec3<f32>) -> u64 {
        let (half, p) = (<[f32; 3]>::from(self.half_size()), <[f32; 3]>::from(p));
        let widest = half.iter().fold(f32::MIN_POSITIVE, |widest, c| widest.max(*c));
        let steps = p.map(|c| ((c / widest).clamp(-1.0, 1.0) * 1023.0 + 1024.0) as u64);
        (0..11).fold(0, |place, bit| {
            let [x, y, z] = steps.map(|step| (step >> bit) & 1);
            place | (x | y << 1 | z << 2) << (3 * bit)
        })
    }
}

/// The same in all frames.
impl Seek for ScatterRegion {
    fn seek(&mut self, _: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        Ok(false)
    }
}
