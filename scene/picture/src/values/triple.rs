//! Three numbers, such as a point: each with its own motion, or all with one track.

use std::fmt;
use std::marker::PhantomData;
use std::sync::Arc;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::PeekedMap;
use super::motion::{Motion, OfKind, RangedNumber};
use super::path::{MovingAlong, PathSchema, WrittenPath};
use super::track::{self, KeyframeValue, WrittenTrack};
use crate::seek::FrameTime;

/// Deserializes three numbers, or a track of such.
pub(super) fn read<'de, T, D>(deserializer: D) -> Result<[T; 3], D::Error>
where
    T: RangedNumber + Deserialize<'de>,
    D: Deserializer<'de>,
{
    deserializer.deserialize_any(TripleVisitor(PhantomData))
}

struct TripleVisitor<T>(PhantomData<T>);

impl<'de, T: RangedNumber + Deserialize<'de>> Visitor<'de> for TripleVisitor<T> {
    type Value = [T; 3];

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of 3 numbers")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<[T; 3], A::Error> {
        let mut next = |n: usize| list.next_element::<T>()?.ok_or_else(|| A::Error::invalid_length(n, &self));
        Ok([next(0)?, next(1)?, next(2)?])
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<[T; 3], A::Error> {
        let first = map.next_key::<String>()?;
        if first.as_deref() == Some("expr") {
            return Err(A::Error::custom("must be a list of 3 numbers, each of which may be a formula"));
        }
        if let Some(other) = first.as_deref().filter(|key| !["keys", "ease", "loop", "path"].contains(key)) {
            return Err(A::Error::custom(format_args!(
                "must be a list of 3 numbers, or a track: {{\"keys\": [[seconds, [x, y, z]], …]}}, not an object with the key \"{other}\""
            )));
        }
        let is_path = first.as_deref() == Some("path");
        let map = MapAccessDeserializer::new(PeekedMap::new(first, map));
        if is_path {
            return along(WrittenPath::deserialize(map)?.path);
        }
        of_track(&WrittenTrack::<Numbers<T>>::deserialize(map)?, |key, axis| key.0[axis].0.value())
    }
}

/// The coordinates of a point that moves along a path.
fn along<T: RangedNumber, E: Error>(MovingAlong { path, progress }: MovingAlong) -> Result<[T; 3], E> {
    let path = Arc::new(path);
    let coordinate = |axis| Motion::Path { path: Arc::clone(&path), axis, progress: progress.clone() }.start();
    Ok([coordinate(0)?, coordinate(1)?, coordinate(2)?])
}

/// Three numbers of each value of a track.
pub(super) fn of_track<T: RangedNumber, V, E: Error>(
    written: &WrittenTrack<V>,
    number: impl Fn(&V, usize) -> f32,
) -> Result<[T; 3], E> {
    let along = |axis| {
        let motion = Motion::Track(written.track(|value| number(value, axis)));
        let start = motion.at::<T>(&mut FrameTime::at(0, 0.0)).map_err(E::custom)?;
        Ok(T::moving(start, motion))
    };
    Ok([along(0)?, along(1)?, along(2)?])
}

/// A keyframe's numbers.
struct Numbers<T>([OfKind<T>; 3]);

impl<T> KeyframeValue for Numbers<T> {
    const KEY: &'static str = "[seconds, [x, y, z]]";
}

impl<'de, T: RangedNumber> Deserialize<'de> for Numbers<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        <[OfKind<T>; 3]>::deserialize(deserializer).map(Self)
    }
}

/// Schema of three numbers with the schema `number`, a track of such, or a path.
pub(super) fn schema(about: &str, number: &Schema, generator: &mut SchemaGenerator) -> Schema {
    let mut schema = schema_without_path(about, number, generator);
    let path = generator.subschema_for::<PathSchema>();
    if let Some(forms) = schema.get_mut("anyOf").and_then(serde_json::Value::as_array_mut) {
        forms.push(path.into());
    }
    schema
}

/// Schema of three numbers with the schema `number`, or a track of such.
pub(super) fn schema_without_path(about: &str, number: &Schema, generator: &mut SchemaGenerator) -> Schema {
    let list = json_schema!({ "type": "array", "items": number, "minItems": 3, "maxItems": 3 });
    let track = generator.subschema_for::<PointTrack>();
    json_schema!({ "description": about, "anyOf": [list, track] })
}

/// Schema of three numbers over time.
struct PointTrack;

impl JsonSchema for PointTrack {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "PointTrack".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let value = json_schema!({ "type": "array", "items": { "type": "number" }, "minItems": 3, "maxItems": 3 });
        let example = [serde_json::json!([0, 1, 0]), serde_json::json!([1, 1, 0])];
        track::schema("Three numbers over time.", &value, example, generator)
    }
}
