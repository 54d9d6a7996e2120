//! Motions: what gives a number another value in each frame, a track or a formula.
//!
//! A number with a motion stores it next to the number's value at the time of its last evaluation.

use std::fmt;
use std::marker::PhantomData;
use std::sync::Arc;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::ser::SerializeStruct;
use serde::{Deserialize, Deserializer, Serializer};

use super::PeekedMap;
use super::path::Path;
use super::track::{KeyframeValue, Track, TrackSchema, WrittenTrack};
use crate::names::nearest_name;
use crate::seek::FrameTime;
use crate::values::formula::Formula;

/// A kind of number, with its range.
pub(super) trait RangedNumber: Sized {
    /// Range of a number of this kind, worded for messages.
    const EXPECTED: &'static str;

    /// Whether a value is in range.
    fn is_in_range(value: f32) -> bool;

    /// The number, if it is in range.
    fn in_range(value: f32) -> Option<Self>;

    /// The value.
    fn value(&self) -> f32;

    /// The number with a motion, and its value at second 0.
    fn moving(value: f32, motion: Motion) -> Self;
}

/// Source of a number's value in each frame.
#[derive(Debug)]
pub(super) enum Motion {
    /// Keyframes.
    Track(Track),
    /// Arithmetic.
    Formula(Formula),
    /// One coordinate of a point on a path, and the fraction of the path's length over time.
    Path { path: Arc<Path>, axis: usize, progress: Track },
}

impl Motion {
    /// The number in a frame.
    ///
    /// # Errors
    /// Fails if a formula's value is not in range.
    pub(super) fn at<T: RangedNumber>(&self, clock: &mut FrameTime<'_>) -> Result<f32, String> {
        match self {
            Self::Track(track) => {
                clock.record_keyframes(track.keyframe_times());
                Ok(track.at(clock.seconds, T::is_in_range))
            }
            Self::Path { path, axis, progress } => {
                clock.record_keyframes(progress.keyframe_times());
                let fraction = f64::from(progress.at(clock.seconds, f32::is_finite));
                let value = path.at(fraction)[*axis] as f32 + 0.0;
                if T::is_in_range(value) { Ok(value) } else { Err(format!("must be {}, not {value}", T::EXPECTED)) }
            }
            Self::Formula(formula) => {
                formula.tracks().for_each(|track| clock.record_keyframes(track.keyframe_times()));
                let value = formula.at(clock.frame, clock.seconds) + 0.0;
                if !value.is_finite() {
                    return Err("has no finite value: a formula divides by 0, takes the root of a number below 0, or becomes too large; use max, min or clamp there".to_owned());
                }
                if !T::is_in_range(value) {
                    return Err(format!("must be {}, not {value}", T::EXPECTED));
                }
                Ok(value)
            }
        }
    }

    /// The number at second 0.
    pub(super) fn start<T: RangedNumber, E: Error>(self) -> Result<T, E> {
        let value = self.at::<T>(&mut FrameTime::at(0, 0.0)).map_err(E::custom)?;
        Ok(T::moving(value, self))
    }
}

/// Converts a JSON number to this kind; fails with the expected range if it is not finite or not in range.
pub(super) fn number<T: RangedNumber, E: Error>(value: f64) -> Result<T, E> {
    let number = value as f32;
    if !number.is_finite() {
        return Err(E::custom(format_args!("{value:e} is too large: numbers go up to 3.4e38")));
    }
    // No result depends on the sign of a zero, and no cache key should either.
    T::in_range(number + 0.0).ok_or_else(|| E::custom(format_args!("must be {}, not {}", T::EXPECTED, number + 0.0)))
}

macro_rules! visit_numbers {
    ($Value:ty) => {
        fn visit_f64<E: Error>(self, value: f64) -> Result<$Value, E> {
            number(value)
        }

        fn visit_i64<E: Error>(self, value: i64) -> Result<$Value, E> {
            number(value as f64)
        }

        fn visit_u64<E: Error>(self, value: u64) -> Result<$Value, E> {
            number(value as f64)
        }
    };
}

/// Deserializes a number that cannot be animated.
pub(super) struct ConstantVisitor<T>(PhantomData<T>);

impl<'de, T: RangedNumber> Visitor<'de> for ConstantVisitor<T> {
    type Value = T;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number")
    }

    visit_numbers!(T);

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<T, A::Error> {
        Err(A::Error::custom(match map.next_key::<String>()?.as_deref() {
            Some("expr") => CONSTANT_FORMULA,
            _ => "cannot be a track: write a number, the same for all frames",
        }))
    }
}

/// Message for a formula that depends on time where a number may not.
pub(super) const CONSTANT_FORMULA: &str =
    "is the same for all frames: use a formula without t, frame and numbers that change";

/// First keys of a formula and of a track.
const FORMS: [&str; 4] = ["expr", "keys", "ease", "loop"];

/// Message for an object that begins with another key.
fn of_no_form(key: Option<&str>) -> String {
    let meant = key.and_then(|key| nearest_name(key, &FORMS, &[])).map(|meant| format!("; did you mean \"{meant}\"?"));
    let written = key.map_or_else(|| "an empty object".to_owned(), |key| format!("an object with the key \"{key}\""));
    format!(
        "must be a number, a track: {{\"keys\": [[seconds, number], …]}}, or a formula: {{\"expr\": text}}, not {written}{}",
        meant.unwrap_or_default()
    )
}

/// Deserializes a number, a track or a formula.
pub(super) struct NumberOrMotion<T>(PhantomData<T>);

impl<'de, T: RangedNumber> Visitor<'de> for NumberOrMotion<T> {
    type Value = T;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, a track: {\"keys\": [[seconds, number], …]}, or a formula: {\"expr\": text}")
    }

    visit_numbers!(T);

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<T, A::Error> {
        let first = map.next_key::<String>()?;
        if first.as_deref().is_none_or(|key| !FORMS.contains(&key)) {
            return Err(A::Error::custom(of_no_form(first.as_deref())));
        }
        let is_formula = first.as_deref() == Some("expr");
        let map = MapAccessDeserializer::new(PeekedMap::new(first, map));
        if is_formula {
            return Motion::Formula(WrittenFormula::deserialize(map)?.expr).start();
        }
        let written = WrittenTrack::<OfKind<T>>::deserialize(map)?;
        Motion::Track(written.track(|key| key.0.value())).start()
    }
}

/// A formula as it is parsed.
#[derive(Deserialize)]
#[serde(rename = "Formula", deny_unknown_fields)]
struct WrittenFormula {
    expr: Formula,
}

/// A keyframe's number of a kind, which cannot be a track.
pub(super) struct OfKind<T>(pub(super) T);

impl<T> KeyframeValue for OfKind<T> {
    const KEY: &'static str = "[seconds, number]";
}

impl<'de, T: RangedNumber> Deserialize<'de> for OfKind<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        read_constant(deserializer).map(Self)
    }
}

/// Deserializes a number that cannot be animated.
pub(super) fn read_constant<'de, T: RangedNumber, D: Deserializer<'de>>(d: D) -> Result<T, D::Error> {
    d.deserialize_any(ConstantVisitor(PhantomData))
}

/// Deserializes a number, a track or a formula.
pub(super) fn read<'de, T: RangedNumber, D: Deserializer<'de>>(d: D) -> Result<T, D::Error> {
    d.deserialize_any(NumberOrMotion(PhantomData))
}

/// Serializes a number; an animated one as a track with one keyframe, so that it is still animated when it is parsed
/// again.
pub(super) fn write<S: Serializer>(value: f32, is_animated: bool, serializer: S) -> Result<S::Ok, S::Error> {
    if !is_animated {
        return serializer.serialize_f32(value);
    }
    let mut track = serializer.serialize_struct("Track", 1)?;
    track.serialize_field("keys", &[(0, value)])?;
    track.end()
}

/// Schema of a formula.
pub(crate) struct FormulaSchema;

impl JsonSchema for FormulaSchema {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Formula".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "A number as arithmetic.",
            "examples": [{ "expr": "1 + 0.2 * sin(360 * t)" }],
            "type": "object",
            "properties": {
                "expr": { "type": "string", "minLength": 1, "maxLength": crate::values::formula::MAX_FORMULA_BYTES,
                    "description": "The formula: + - * / % ^, comparisons, the scene's numbers, t (seconds), frame, frames, pi, i and n among counted copies, and functions; angles in degrees.",
                    "examples": ["0.2 * sin(360 * t)", "r + gap / 2"] }
            },
            "required": ["expr"],
            "additionalProperties": false
        })
    }
}

/// Schema of a number, extended to allow a track of such numbers, or a formula.
pub(super) fn or_motion(mut schema: Schema, generator: &mut SchemaGenerator) -> Schema {
    let track = generator.subschema_for::<TrackSchema>();
    let formula = generator.subschema_for::<FormulaSchema>();
    // Its range applies to numbers only, so it stays in place.
    if let Some(number) = schema.remove("type") {
        schema.insert("anyOf".to_owned(), serde_json::json!([{ "type": number }, track, formula]));
    }
    schema
}
