//! Parameters of materials: each is one value, or a texture that varies it.

use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::{F64Deserializer, MapAccessDeserializer, SeqAccessDeserializer, StrDeserializer};
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::ShadingPoint;
use super::texture::Texture;
use crate::limits::MAX_TEXTURE_DEPTH;
use crate::real::{Real, Vec3, vec3};
use crate::seek::{FrameTime, Seek, SeekError};
use crate::values::{Color, Fraction, PeekedMap, RefractiveIndex, Shininess};

/// Color: constant, or from a texture.
#[derive(Clone, Debug, PartialEq)]
pub enum ColorParam {
    /// Constant color.
    Constant(Color),
    /// Color from a texture.
    Textured(Box<Texture>),
}

impl ColorParam {
    /// Constant color: red, green, blue in linear light.
    pub const fn constant(red: f32, green: f32, blue: f32) -> Self {
        Self::Constant(Color::new(red, green, blue))
    }

    /// Black everywhere.
    pub const fn black() -> Self {
        Self::constant(0.0, 0.0, 0.0)
    }

    /// White everywhere.
    pub const fn white() -> Self {
        Self::constant(1.0, 1.0, 1.0)
    }

    /// The color, if it is constant.
    pub(crate) fn as_constant(&self) -> Option<&Color> {
        match self {
            Self::Constant(color) => Some(color),
            Self::Textured(_) => None,
        }
    }

    /// The texture, if there is one.
    pub fn texture(&self) -> Option<&Texture> {
        match self {
            Self::Constant(_) => None,
            Self::Textured(texture) => Some(texture),
        }
    }

    /// Whether it is black everywhere, so that a formula may leave it out.
    pub(crate) fn is_black(&self) -> bool {
        matches!(self, Self::Constant(color) if color.is_black())
    }

    /// The color at a shading point.
    pub fn at<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        match self {
            Self::Constant(color) => Vec3::uniform(place.normal.x, color.get()),
            Self::Textured(texture) => texture.color(place),
        }
    }
}

/// Deserializes a color like [`Color`], or a texture; errors inside keep their pointers.
struct ColorParamVisitor;

impl<'de> Visitor<'de> for ColorParamVisitor {
    type Value = ColorParam;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a color: [red, green, blue] in linear light, \"#rrggbb\" in sRGB, or a texture")
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<ColorParam, E> {
        Color::deserialize(StrDeserializer::new(text)).map(ColorParam::Constant)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, channels: A) -> Result<ColorParam, A::Error> {
        Color::deserialize(SeqAccessDeserializer::new(channels)).map(ColorParam::Constant)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ColorParam, A::Error> {
        let first = map.next_key::<String>()?;
        let is_color = first.as_deref().is_some_and(|key| ["kelvin", "keys", "ease", "loop", "expr"].contains(&key));
        let map = PeekedMap::new(first, map);
        if is_color {
            return Color::deserialize(MapAccessDeserializer::new(map)).map(ColorParam::Constant);
        }
        let texture = Texture::deserialize(MapAccessDeserializer::new(map))?;
        let depth = texture.depth();
        if depth > MAX_TEXTURE_DEPTH {
            let message = format_args!("nests textures {depth} deep: nest at most {MAX_TEXTURE_DEPTH}");
            return Err(A::Error::custom(message));
        }
        Ok(ColorParam::Textured(Box::new(texture)))
    }
}

impl<'de> Deserialize<'de> for ColorParam {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ColorParamVisitor)
    }
}

impl Serialize for ColorParam {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Constant(color) => color.serialize(serializer),
            Self::Textured(texture) => texture.serialize(serializer),
        }
    }
}

impl Seek for ColorParam {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        match self {
            Self::Constant(color) => color.seek(clock),
            Self::Textured(texture) => texture.seek(clock),
        }
    }
}

impl JsonSchema for ColorParam {
    fn schema_name() -> Cow<'static, str> {
        "ColorOrTexture".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let (color, texture) = (generator.subschema_for::<Color>(), generator.subschema_for::<Texture>());
        json_schema!({ "description": "A color, or a texture that varies it.", "anyOf": [color, texture] })
    }
}

/// Kind of number that a texture may vary.
pub trait ScalarKind: Clone + fmt::Debug + PartialEq + Serialize + JsonSchema + for<'de> Deserialize<'de> {
    /// The value.
    fn value(&self) -> f32;

    /// Whether it is 0 in every frame.
    fn is_zero(&self) -> bool;
}

macro_rules! parameters {
    ($($Number:ident),*) => { $(
        impl ScalarKind for $Number {
            fn value(&self) -> f32 {
                self.in_frame()
            }

            fn is_zero(&self) -> bool {
                self.is_zero()
            }
        }
    )* };
}

parameters![Fraction, Shininess, RefractiveIndex];

/// A number: constant, or varied by a texture.
#[derive(Clone, Debug, PartialEq)]
pub enum ScalarParam<N> {
    /// Constant number.
    Constant(N),
    /// Number varied by a texture.
    Textured(Box<TexturedScalar<N>>),
}

/// A number that a texture varies: `low` where it is black, `high` where it is white, by luminance between.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields, bound(deserialize = "N: ScalarKind", serialize = "N: ScalarKind"))]
#[schemars(rename = "Textured{N}")]
pub struct TexturedScalar<N> {
    /// The number where the texture is black.
    pub low: N,
    /// The number where the texture is white.
    pub high: N,
    /// The texture.
    pub by: ColorParam,
}

impl<N: ScalarKind> ScalarParam<N> {
    /// The texture, if there is one.
    pub fn texture(&self) -> Option<&Texture> {
        match self {
            Self::Constant(_) => None,
            Self::Textured(varied) => varied.by.texture(),
        }
    }

    /// Whether it is 0 everywhere, so that a formula may leave its term out.
    pub fn is_zero(&self) -> bool {
        matches!(self, Self::Constant(number) if number.is_zero())
    }

    /// The number at a shading point.
    pub fn at<R: Real>(&self, place: &ShadingPoint<R>) -> R {
        let like = place.normal.x;
        match self {
            Self::Constant(number) => like.uniform(number.value()),
            Self::Textured(varied) => {
                let color = varied.by.at(place);
                // Luminance of linear light: ITU-R BT.709.
                let luminance = color.dot(vec3(like.constant(0.2126), like.constant(0.7152), like.constant(0.0722)));
                let (low, high) = (like.uniform(varied.low.value()), like.uniform(varied.high.value()));
                lerp(low, high, luminance.at_most(1.0))
            }
        }
    }
}

/// Linear interpolation: exactly `from` at 0 and exactly `to` at 1, and never below 0 between non-negative
/// numbers.
pub(super) fn lerp<R: Real>(from: R, to: R, share: R) -> R {
    to.mul_add(share, from * (share.constant(1.0) - share))
}

/// Linear interpolation of colors.
pub(super) fn lerp_colors<R: Real>(from: Vec3<R>, to: Vec3<R>, share: R) -> Vec3<R> {
    to.mul_add(share, from * (share.constant(1.0) - share))
}

/// Deserializes a number, or a number varied by a texture.
struct LevelVisitor<N>(PhantomData<N>);

impl<'de, N: ScalarKind> Visitor<'de> for LevelVisitor<N> {
    type Value = ScalarParam<N>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, or {\"low\": number, \"high\": number, \"by\": texture}")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<ScalarParam<N>, E> {
        N::deserialize(F64Deserializer::new(value)).map(ScalarParam::Constant)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<ScalarParam<N>, E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<ScalarParam<N>, E> {
        self.visit_f64(value as f64)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ScalarParam<N>, A::Error> {
        let first = map.next_key::<String>()?;
        let name = first.as_deref().unwrap_or_default();
        if Texture::is_name(name) {
            let message = format_args!(
                "a texture is a color, not a number: to vary a number by it, write {{\"low\": …, \"high\": …, \"by\": {{\"{name}\": …}}}}"
            );
            return Err(A::Error::custom(message));
        }
        // A track and a formula are numbers too.
        let is_number = matches!(name, "keys" | "ease" | "loop" | "expr");
        let map = MapAccessDeserializer::new(PeekedMap::new(first, map));
        if is_number {
            return N::deserialize(map).map(ScalarParam::Constant);
        }
        TexturedScalar::deserialize(map).map(|varied| ScalarParam::Textured(Box::new(varied)))
    }
}

impl<'de, N: ScalarKind> Deserialize<'de> for ScalarParam<N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(LevelVisitor(PhantomData))
    }
}

impl<N: ScalarKind> Serialize for ScalarParam<N> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Constant(number) => number.serialize(serializer),
            Self::Textured(varied) => varied.serialize(serializer),
        }
    }
}

impl<N: Seek> Seek for ScalarParam<N> {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        match self {
            Self::Constant(number) => number.seek(clock),
            Self::Textured(varied) => varied.seek(clock),
        }
    }
}

impl<N: ScalarKind> JsonSchema for ScalarParam<N> {
    fn schema_name() -> Cow<'static, str> {
        format!("{}Level", N::schema_name()).into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let (number, varied) = (generator.subschema_for::<N>(), generator.subschema_for::<TexturedScalar<N>>());
        json_schema!({ "description": "A number, or one that a texture varies.", "anyOf": [number, varied] })
    }
}
