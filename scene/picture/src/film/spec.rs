//! The image of a job, as it is written.

use std::borrow::Cow;
use std::ops::Range;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use super::{Layer, Region};
use crate::light_groups::LightGroup;
use crate::limits::{MAX_EDGE_PX, MAX_LIGHT_GROUPS, MIN_REWEIGHTED_SAMPLES};
use crate::sample_count::SampleCount;
use crate::seek::Seek;
use crate::values::{ExposureStops, integer_in_range};

/// A picture's size and file format.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename = "Image", deny_unknown_fields)]
pub struct ImageSpec {
    /// Width, in pixels.
    #[serde(deserialize_with = "image_edge")]
    #[schemars(range(min = 1, max = MAX_EDGE_PX))]
    pub width: u32,
    /// Height, in pixels.
    #[serde(deserialize_with = "image_edge")]
    #[schemars(range(min = 1, max = MAX_EDGE_PX))]
    pub height: u32,
    /// Rays per pixel.
    #[serde(default = "default_samples")]
    pub samples: SampleCount,
    /// Seed of the sampler: another seed gives other noise.
    #[serde(default, deserialize_with = "seed")]
    #[schemars(range(min = 0, max = u32::MAX))]
    pub seed: u32,
    /// Whether the denoiser averages the light of neighboring pixels that see the same surface, as far as noise explains
    /// the difference between them.
    #[serde(default)]
    pub denoise: bool,
    /// Whether light of the few samples that are much brighter than others around them counts less, as fireflies are: a
    /// biased picture with less noise, which approaches the unbiased one with more samples. False when absent.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub reweight_fireflies: bool,
    /// File format.
    #[serde(default)]
    pub format: Format,
    /// Bits per channel of a PNG.
    #[serde(default)]
    pub bits: Bits,
    /// Precision of the color channels of an EXR.
    #[serde(default)]
    pub precision: Precision,
    /// Layers that an EXR stores in addition to the colors.
    #[serde(default)]
    #[schemars(extend("uniqueItems" = true))]
    pub layers: Vec<Layer>,
    /// Light groups whose light an EXR stores in addition to the colors: `light.NAME.R`, `.G` and `.B` of each, and
    /// `light.rest` of all other light. They sum to the colors. None when absent.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = MAX_LIGHT_GROUPS), extend("uniqueItems" = true))]
    pub light_groups: Vec<LightGroup>,
    /// Exposure of a PNG, in stops above the scene's light.
    #[serde(default = "default_exposure")]
    pub exposure: ExposureStops,
    /// Tone map of a PNG, for light that is too bright for it.
    #[serde(default)]
    pub tone_map: ToneMap,
    /// Part of the picture that is rendered; all of it when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<Region>,
}

/// A file format.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// PNG in sRGB.
    #[default]
    Png,
    /// OpenEXR in linear light.
    Exr,
}

/// Bits per channel of a PNG.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Seek)]
pub enum Bits {
    /// 8 bits.
    #[default]
    Eight,
    /// 16 bits.
    Sixteen,
}

/// Precision of the color channels of an EXR.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// 16-bit floating point.
    #[default]
    Half,
    /// 32-bit floating point.
    Float,
}

/// Tone map from linear light to displayable light, channel by channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum ToneMap {
    /// Clamps light above 1 to 1.
    #[default]
    None,
    /// A filmic curve: slightly deeper shadows, highlights that fade to white.
    Filmic,
}

impl ImageSpec {
    /// Leaves out all layers and light groups, and leaves fireflies as they are.
    pub fn clear_layers(&mut self) {
        self.layers.clear();
        self.clear_parts_of_light();
    }

    /// Leaves out light groups, and leaves fireflies as they are.
    pub fn clear_parts_of_light(&mut self) {
        self.light_groups.clear();
        self.reweight_fireflies = false;
    }

    /// Whether its fireflies are reweighted: a preview may have too few samples for that.
    pub fn is_reweighted(&self) -> bool {
        self.reweight_fireflies && self.samples.min() >= MIN_REWEIGHTED_SAMPLES
    }

    /// Whether it is denoised: a preview may have too few samples for that.
    pub fn is_denoised(&self) -> bool {
        self.denoise && self.samples.max() > 1
    }

    /// The samples of each round. All pixels have the first two rounds.
    pub fn rounds(&self) -> Vec<Range<u32>> {
        match self.samples {
            // The difference of its halves tells a pixel's noise.
            SampleCount::Fixed(count) if self.is_denoised() => vec![0..count / 2, count / 2..count],
            _ => self.samples.rounds(),
        }
    }

    /// Whether a display transform is applied to the scene's light.
    pub fn has_display_transform(&self) -> bool {
        !self.exposure.is_zero() || self.tone_map != ToneMap::None
    }

    /// Camera rays of a picture: with adaptive samples, as many as it may have.
    pub fn rays(&self) -> u64 {
        self.film().pixels() * u64::from(self.samples.max())
    }
}

impl Serialize for Bits {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u32(match self {
            Self::Eight => 8,
            Self::Sixteen => 16,
        })
    }
}

impl<'de> Deserialize<'de> for Bits {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match integer_in_range(deserializer, 8, 16, "bits")? {
            8 => Ok(Self::Eight),
            16 => Ok(Self::Sixteen),
            other => Err(serde::de::Error::custom(format_args!("must be 8 or 16 bits, not {other}"))),
        }
    }
}

impl JsonSchema for Bits {
    fn schema_name() -> Cow<'static, str> {
        "Bits".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "type": "integer", "enum": [8, 16], "description": "Bits per channel of a PNG." })
    }
}

fn default_exposure() -> ExposureStops {
    ExposureStops::new(0.0).expect("0 is in range")
}

fn default_samples() -> SampleCount {
    SampleCount::Fixed(4)
}

fn image_edge<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 1, MAX_EDGE_PX, "pixels")
}

fn seed<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 0, u32::MAX, "as a seed")
}
