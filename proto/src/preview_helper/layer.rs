//! Layers of pictures, by their names.

use std::borrow::Cow;
use std::fmt;

use scene::Layer;
use scene::light_groups::{LightGroup, REST};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};

/// Layer of a picture that can be shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PictureLayer {
    /// The colors.
    #[default]
    Color,
    /// Distance from the camera: near is bright, far is dark.
    Depth,
    /// Normals: each coordinate from -1 to 1 as a color channel.
    Normal,
    /// Positions: each coordinate within the picture's range as a color channel.
    Position,
    /// Colors of the surfaces, without light.
    Albedo,
    /// Objects, each in a color of its own.
    Object,
    /// Steps of the rays, as a heat map.
    Steps,
    /// Samples of the pixels, as a heat map.
    Samples,
    /// The colors before the denoiser.
    Noisy,
    /// Ways until the next frame: to the right as red, up as green, and gray where nothing moves.
    Motion,
    /// The object that covers most of each pixel, each in a color of its own.
    CryptoObject,
    /// The material that covers most of each pixel, each in a color of its own.
    CryptoMaterial,
}

impl PictureLayer {
    /// All of them, in the order of their names in the schema of jobs.
    pub const ALL: [Self; 12] = [
        Self::Color,
        Self::Depth,
        Self::Normal,
        Self::Position,
        Self::Albedo,
        Self::Object,
        Self::Steps,
        Self::Samples,
        Self::Noisy,
        Self::Motion,
        Self::CryptoObject,
        Self::CryptoMaterial,
    ];

    /// Its name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Color => "color",
            Self::Depth => "depth",
            Self::Normal => "normal",
            Self::Position => "position",
            Self::Albedo => "albedo",
            Self::Object => "object",
            Self::Steps => "steps",
            Self::Samples => "samples",
            Self::Noisy => "noisy",
            Self::Motion => "motion",
            Self::CryptoObject => "crypto_object",
            Self::CryptoMaterial => "crypto_material",
        }
    }

    /// Layer of an EXR that it shows; `None` for the colors, which each picture has.
    pub fn of_exr(self) -> Option<Layer> {
        match self {
            Self::Color => None,
            Self::Depth => Some(Layer::Depth),
            Self::Normal => Some(Layer::Normal),
            Self::Position => Some(Layer::Position),
            Self::Albedo => Some(Layer::Albedo),
            Self::Object => Some(Layer::Object),
            Self::Steps => Some(Layer::Steps),
            Self::Samples => Some(Layer::Samples),
            Self::Noisy => Some(Layer::Noisy),
            Self::Motion => Some(Layer::Motion),
            Self::CryptoObject => Some(Layer::CryptoObject),
            Self::CryptoMaterial => Some(Layer::CryptoMaterial),
        }
    }
}

/// Layer of a stored picture: one that every picture can have, or the light of a light group.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum StoredLayer {
    /// A layer of the list.
    Listed(PictureLayer),
    /// The light of a group, by the group's name.
    Light(String),
}

impl StoredLayer {
    /// Name of the layer of a group is that of its channels: this, and the group's name.
    const LIGHT: &str = "light.";

    /// The layers whose channels an EXR has.
    pub fn of_channels(channels: &[String]) -> Vec<Self> {
        let has = |name: &str| channels.iter().any(|known| known == name);
        let listed = PictureLayer::ALL.into_iter().map(Self::Listed);
        let groups = channels.iter().filter_map(|name| name.strip_suffix(".R")?.to_owned().try_into().ok());
        let lights = groups.filter(|layer| matches!(layer, Self::Light(_)));
        let layers = listed.chain(lights);
        layers.filter(|layer| layer.channels().iter().all(|name| has(name))).collect()
    }

    /// Names of its channels in an EXR.
    pub fn channels(&self) -> Vec<String> {
        let owned = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
        match self {
            Self::Listed(layer) => match layer.of_exr() {
                None => owned(&["R", "G", "B"]),
                Some(layer) => owned(layer.channels()),
            },
            Self::Light(_) => ["R", "G", "B"].map(|color| format!("{self}.{color}")).into(),
        }
    }
}

impl fmt::Display for StoredLayer {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Listed(layer) => formatter.write_str(layer.name()),
            Self::Light(group) => write!(formatter, "{}{group}", Self::LIGHT),
        }
    }
}

impl From<StoredLayer> for String {
    fn from(layer: StoredLayer) -> Self {
        layer.to_string()
    }
}

impl TryFrom<String> for StoredLayer {
    type Error = serde_json::Error;

    fn try_from(name: String) -> Result<Self, Self::Error> {
        let Some(group) = name.strip_prefix(Self::LIGHT) else {
            return serde_json::from_value(name.into()).map(Self::Listed);
        };
        if group != REST {
            let _: LightGroup = serde_json::from_value(group.into())?;
        }
        Ok(Self::Light(group.to_owned()))
    }
}

impl JsonSchema for StoredLayer {
    fn schema_name() -> Cow<'static, str> {
        "StoredLayer".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "anyOf": [
                generator.subschema_for::<PictureLayer>(),
                {
                    "description": "The light of a light group, or of no listed group (light.rest).",
                    "type": "string",
                    "pattern": "^light\\.[A-Za-z0-9_-]{1,64}$"
                }
            ]
        })
    }
}
