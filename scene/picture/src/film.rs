//! The pictures of a job: their size, format, channels and layers, and the frames.
//!
//! An [`ImageSpec`] is what a job asks for; its [`Film`] is the layout of the rendered picture.

mod display;
mod region;
mod spec;

use std::borrow::Cow;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use crate::light_groups::{LightGroup, REST};
use crate::limits::MAX_FRAMES;
use crate::seek::Seek;
use crate::values::{FrameRate, Shutter, integer_in_range};

pub use display::DisplayTransform;
pub use region::Region;
pub use spec::{Bits, Format, ImageSpec, Precision, ToneMap};

/// Layout of a rendered picture: its part of the whole one, and the channels of its pixels.
#[derive(Clone, Copy, Debug)]
pub struct Film<'a> {
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
    /// Column and row of the top left in the whole picture, in pixels.
    pub origin: [u32; 2],
    light_groups: &'a [LightGroup],
    layers: &'a [Layer],
    /// Whether light is also summed by its brightness.
    has_levels: bool,
    has_guides: bool,
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
pub(crate) const COUNT_CHANNEL: &str = "levels.samples";

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

impl ImageSpec {
    /// The layout of its rendered picture.
    pub fn film(&self) -> Film<'_> {
        let Region { x, y, width, height } = self.rendered();
        Film {
            width,
            height,
            origin: [x, y],
            light_groups: &self.light_groups,
            layers: &self.layers,
            has_levels: self.is_reweighted(),
            has_guides: self.is_denoised(),
        }
    }
}

impl Film<'_> {
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
    /// the end `COUNT_CHANNEL`, if fireflies are reweighted; and then [`GUIDE_CHANNELS`] if the picture is denoised.
    pub fn rendered_channels(&self) -> Vec<Cow<'static, str>> {
        let mut channels = self.channels();
        let layers = channels.split_off(self.light_channels());
        if self.has_levels {
            let of_level = |level| ["R", "G", "B"].map(|channel| Cow::Owned(format!("levels.{level}.{channel}")));
            channels.extend((1..=BRIGHTNESS_LEVELS).flat_map(of_level));
        }
        channels.extend(layers);
        channels.extend(self.has_levels.then_some(Cow::Borrowed(COUNT_CHANNEL)));
        let guides = self.has_guides.then_some(GUIDE_CHANNELS);
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
        self.light_channels() + if self.has_levels { 3 * BRIGHTNESS_LEVELS } else { 0 }
    }

    /// Whether light is summed by light groups or by brightness, too.
    pub(crate) fn has_parts_of_light(&self) -> bool {
        self.sum_channels() > 4
    }

    /// Whether a rendered pixel has more channels than light.
    pub fn has_layers(&self) -> bool {
        self.rendered_channels().len() > self.sum_channels()
    }

    /// Index among the rendered channels of the standard error of the brightness, if the picture is denoised.
    pub fn error_plane(&self) -> Option<usize> {
        self.has_guides.then(|| self.rendered_channels().len() - 1)
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

    /// Number of pixels.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

fn frame_count<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 1, MAX_FRAMES, "frames")
}
