//! The pictures of a job: their size, format, channels and layers, and the frames.

mod display;
mod region;

use std::borrow::Cow;
use std::ops::Range;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use crate::light_groups::{LightGroup, REST};
use crate::limits::{MAX_EDGE_PX, MAX_FRAMES, MAX_LIGHT_GROUPS, MIN_REWEIGHTED_SAMPLES};
use crate::sample_count::SampleCount;
use crate::seek::Seek;
use crate::values::{ExposureStops, FrameRate, Shutter, integer_in_range};

pub use display::DisplayTransform;
pub use region::{Crop, Region};

/// A picture's size and file format.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Image {
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
    /// Part of the picture that is rendered; all of it when absent. A job that has been parsed has `crop` instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<Region>,
    /// The region and the whole picture's size, if only a region is rendered: width and height are the region's.
    #[serde(skip_deserializing, skip_serializing_if = "Option::is_none")]
    #[schemars(skip)]
    pub crop: Option<Crop>,
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

/// A layer (AOV) of an EXR, sampled at the pixel's center.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum Layer {
    /// `Z`: distance along the ray; infinite where nothing is hit.
    Depth,
    /// `N.X N.Y N.Z`: the normal.
    Normal,
    /// `P.X P.Y P.Z`: the position.
    Position,
    /// `albedo.R albedo.G albedo.B`: the surface's own color, without lighting.
    Albedo,
    /// `id`: index into the objects; −1 where nothing is hit.
    Object,
    /// `steps`: steps of the march.
    Steps,
    /// `samples`: the samples of the pixel, which differ with adaptive ones.
    Samples,
    /// `noisy.R noisy.G noisy.B`: the colors as sampled, before the denoiser, and with all light of fireflies.
    Noisy,
    /// `motion.X motion.Y`: the way in the picture until the next frame, in pixels to the right and up.
    Motion,
    /// `CryptoObject00` to `CryptoObject02`: a matte of the objects, for Cryptomatte.
    CryptoObject,
    /// `CryptoMaterial00` to `CryptoMaterial02`: a matte of the materials, for Cryptomatte.
    CryptoMaterial,
}

/// Number and rate of the pictures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields, default)]
pub struct Frames {
    /// Number of frames.
    #[serde(deserialize_with = "frame_count")]
    #[schemars(range(min = 1, max = MAX_FRAMES))]
    pub count: u32,
    /// Frames per second: frame i is at i/fps seconds.
    pub fps: FrameRate,
    /// Motion blur: the time that the shutter is open, as a fraction of a frame; 0.5 is usual in film. It opens at the
    /// time of the frame.
    pub shutter: Shutter,
}

/// Levels of brightness by which fireflies are reweighted, above level 0.
pub const BRIGHTNESS_LEVELS: usize = 5;

/// The channel of a rendered pixel with its number of samples, by which fireflies are reweighted.
pub const COUNT_CHANNEL: &str = "levels.samples";

/// The channels of a rendered pixel that only the denoiser reads: albedo, normal and inverse depth
/// (`Guides` of the integrator), and the standard error of the brightness.
pub const GUIDE_CHANNELS: [&str; 8] = [
    "guide.albedo.R",
    "guide.albedo.G",
    "guide.albedo.B",
    "guide.normal.X",
    "guide.normal.Y",
    "guide.normal.Z",
    "guide.inverse_depth",
    "guide.error",
];

impl Default for Frames {
    fn default() -> Self {
        Self {
            count: 1,
            fps: FrameRate::new(24.0).expect("24 is in range"),
            shutter: Shutter::new(0.0).expect("0 is in range"),
        }
    }
}

impl Frames {
    /// Time of a frame, or of an instant between two frames, in seconds.
    pub(crate) fn time_of(&self, frame: f64) -> f64 {
        frame / f64::from(self.fps.get())
    }
}

/// Channels of a matte: two pairs of an id and a coverage in each of three sets.
macro_rules! matte_channels {
    ($name:literal) => {
        [
            concat!($name, "00.R"),
            concat!($name, "00.G"),
            concat!($name, "00.B"),
            concat!($name, "00.A"),
            concat!($name, "01.R"),
            concat!($name, "01.G"),
            concat!($name, "01.B"),
            concat!($name, "01.A"),
            concat!($name, "02.R"),
            concat!($name, "02.G"),
            concat!($name, "02.B"),
            concat!($name, "02.A"),
        ]
    };
}

impl Layer {
    /// Whether it is a matte: of the samples, and not of the pixel's center.
    pub fn is_matte(self) -> bool {
        matches!(self, Self::CryptoObject | Self::CryptoMaterial)
    }

    /// Names of the layer's EXR channels, in the order of its values.
    pub fn channels(self) -> &'static [&'static str] {
        match self {
            Self::Depth => &["Z"],
            Self::Normal => &["N.X", "N.Y", "N.Z"],
            Self::Position => &["P.X", "P.Y", "P.Z"],
            Self::Albedo => &["albedo.R", "albedo.G", "albedo.B"],
            Self::Object => &["id"],
            Self::Steps => &["steps"],
            Self::Samples => &["samples"],
            Self::Noisy => &["noisy.R", "noisy.G", "noisy.B"],
            Self::Motion => &["motion.X", "motion.Y"],
            Self::CryptoObject => &matte_channels!("CryptoObject"),
            Self::CryptoMaterial => &matte_channels!("CryptoMaterial"),
        }
    }
}

impl Image {
    /// The channels of a finished pixel: red, green, blue, alpha, then the light groups', then the layers'.
    pub fn channels(&self) -> Vec<Cow<'static, str>> {
        let mut channels = ["R", "G", "B", "A"].map(Cow::Borrowed).to_vec();
        if !self.light_groups.is_empty() {
            for group in self.light_groups.iter().map(LightGroup::name).chain([REST]) {
                channels.extend(["R", "G", "B"].map(|channel| Cow::Owned(format!("light.{group}.{channel}"))));
            }
        }
        channels.extend(self.layers.iter().flat_map(|layer| layer.channels()).copied().map(Cow::Borrowed));
        channels
    }

    /// The channels of a rendered pixel. After the light of a finished pixel come the light by its brightness, and at
    /// the end [`COUNT_CHANNEL`], if fireflies are reweighted; and then [`GUIDE_CHANNELS`] if the picture is denoised.
    pub fn rendered_channels(&self) -> Vec<Cow<'static, str>> {
        let mut channels = self.channels();
        let layers = channels.split_off(self.light_channels());
        if self.is_reweighted() {
            let of_level = |level| ["R", "G", "B"].map(|channel| Cow::Owned(format!("levels.{level}.{channel}")));
            channels.extend((1..=BRIGHTNESS_LEVELS).flat_map(of_level));
        }
        channels.extend(layers);
        channels.extend(self.is_reweighted().then_some(Cow::Borrowed(COUNT_CHANNEL)));
        let guides = self.is_denoised().then_some(GUIDE_CHANNELS);
        channels.extend(guides.into_iter().flatten().map(Cow::Borrowed));
        channels
    }

    /// Number of the first channels of a finished pixel, which are means of light over its samples: the colors, alpha, and
    /// the light groups' channels.
    pub fn light_channels(&self) -> usize {
        if self.light_groups.is_empty() { 4 } else { 4 + 3 * (self.light_groups.len() + 1) }
    }

    /// Number of the first channels of a rendered pixel, which are means of light over its samples: the channels of a finished
    /// one, and the channels of the light by its brightness.
    pub fn sum_channels(&self) -> usize {
        self.light_channels() + if self.is_reweighted() { 3 * BRIGHTNESS_LEVELS } else { 0 }
    }

    /// Leaves out all layers and light groups, and leaves fireflies as they are.
    pub fn clear_layers(&mut self) {
        self.layers.clear();
        self.clear_parts_of_light();
    }

    /// Whether light is summed by light groups or by brightness, too.
    pub(crate) fn has_parts_of_light(&self) -> bool {
        self.sum_channels() > 4
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

    /// Whether a rendered pixel has more channels than light.
    pub fn has_layers(&self) -> bool {
        self.rendered_channels().len() > self.sum_channels()
    }

    /// The samples of each round. All pixels have the first two rounds.
    pub fn rounds(&self) -> Vec<Range<u32>> {
        match self.samples {
            // The difference of its halves tells a pixel's noise.
            SampleCount::Fixed(count) if self.is_denoised() => vec![0..count / 2, count / 2..count],
            _ => self.samples.rounds(),
        }
    }

    /// Index among the rendered channels of the standard error of the brightness, if the picture is denoised.
    pub fn error_plane(&self) -> Option<usize> {
        self.is_denoised().then(|| self.rendered_channels().len() - 1)
    }

    /// Indices among the rendered channels of the number of samples.
    pub fn samples_planes(&self) -> [Option<usize>; 2] {
        let channels = self.rendered_channels();
        [Layer::Samples.channels()[0], COUNT_CHANNEL].map(|name| channels.iter().position(|channel| channel == name))
    }

    /// Bytes of a rendered pixel, each channel an `f32`.
    pub fn pixel_bytes(&self) -> u32 {
        4 * self.rendered_channels().len() as u32
    }

    /// Whether a display transform is applied to the scene's light.
    pub fn has_display_transform(&self) -> bool {
        !self.exposure.is_zero() || self.tone_map != ToneMap::None
    }

    /// Camera rays of a picture: with adaptive samples, as many as it may have.
    pub fn rays(&self) -> u64 {
        self.pixels() * u64::from(self.samples.max())
    }

    /// Number of pixels.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
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

fn frame_count<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 1, MAX_FRAMES, "frames")
}
