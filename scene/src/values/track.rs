//! Tracks: numbers that change over the frames of a job.
//!
//! A number with a track stores the track, next to the number's value at the time of its last evaluation.

mod keyframes;

use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::ser::SerializeStruct;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use self::keyframes::KeyframeSpan;
use super::PeekedMap;
use crate::limits::{MAX_KEYFRAME_SECONDS, MAX_KEYFRAMES};
use crate::materials::Texture;

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

    /// The number for a track of such numbers, at second 0.
    fn on_track(track: Track) -> Self;
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

    fn visit_map<A: MapAccess<'de>>(self, _: A) -> Result<T, A::Error> {
        Err(A::Error::custom("cannot be a track: write a number, the same for all frames"))
    }
}

/// Deserializes a number, or a track.
pub(super) struct NumberOrTrack<T>(PhantomData<T>);

impl<'de, T: RangedNumber> Visitor<'de> for NumberOrTrack<T> {
    type Value = T;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, or a track: {\"keys\": [[seconds, number], …]}")
    }

    visit_numbers!(T);

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<T, A::Error> {
        let first = map.next_key::<String>()?;
        if first.as_deref().is_some_and(Texture::is_name) {
            return Err(A::Error::custom(
                "takes no texture: write a number or a track; a material's numbers take textures",
            ));
        }
        let read = ReadTrack::<T>::deserialize(MapAccessDeserializer::new(PeekedMap::new(first, map)))?;
        Ok(T::on_track(Track { keys: read.keys.0, ease: read.ease }))
    }
}

/// Deserializes a number that cannot be animated.
pub(super) fn read_constant<'de, T: RangedNumber, D: Deserializer<'de>>(d: D) -> Result<T, D::Error> {
    d.deserialize_any(ConstantVisitor(PhantomData))
}

/// Deserializes a number, or a track.
pub(super) fn read<'de, T: RangedNumber, D: Deserializer<'de>>(d: D) -> Result<T, D::Error> {
    d.deserialize_any(NumberOrTrack(PhantomData))
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

/// Interpolation between two keyframes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Ease {
    /// Linear.
    #[default]
    Linear,
    /// Smooth: s²(3 − 2s) for the fraction s of the interval.
    Smooth,
    /// Constant: the earlier keyframe's number until the next keyframe.
    Step,
}

impl Ease {
    fn apply(self, share: f64) -> f64 {
        match self {
            Self::Linear => share,
            Self::Smooth => share * share * (3.0 - 2.0 * share),
            Self::Step => 0.0,
        }
    }
}

/// A number over time.
#[derive(Debug)]
pub(crate) struct Track {
    /// Keyframes in the order of time: seconds and number; one or more.
    keys: Vec<(f64, f32)>,
    ease: Ease,
}

impl Track {
    /// Times of its keyframes.
    pub(super) fn keyframe_times(&self) -> impl Iterator<Item = f64> {
        self.keys.iter().map(|&(seconds, _)| seconds)
    }

    /// The number at a time. `is_in_range` returns whether a number is in range.
    pub(super) fn at(&self, now: f64, holds: fn(f32) -> bool) -> f32 {
        let next = self.keys.partition_point(|&(seconds, _)| seconds <= now);
        let (from, before) = self.keys[next.saturating_sub(1)];
        let (to, after) = self.keys[next.min(self.keys.len() - 1)];
        let length = to - from;
        if length <= 0.0 || now <= from {
            return before;
        }
        let share = self.ease.apply((now - from) / length);
        let (low, high) = (f64::from(before), f64::from(after));
        let value = ((low + (high - low) * share) as f32).clamp(before.min(after), before.max(after)) + 0.0;
        if holds(value) {
            return value;
        }
        // If the range has a gap, as between 0 and the minimum size, the nearer keyframe is used.
        if share < 0.5 { before } else { after }
    }
}

/// A track as it is parsed.
#[derive(Deserialize)]
#[serde(rename = "Track", deny_unknown_fields, bound(deserialize = "T: RangedNumber"))]
struct ReadTrack<T> {
    keys: KeyframeSpan<T>,
    #[serde(default)]
    ease: Ease,
}

/// Schema of a track, whose numbers have the range of the animated number.
struct TrackSchema;

impl JsonSchema for TrackSchema {
    fn schema_name() -> Cow<'static, str> {
        "Track".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let ease = generator.subschema_for::<Ease>();
        json_schema!({
            "description": "A number over time: frame i has its value at i/fps seconds. Before the first keyframe the value is the first keyframe's; after the last, the last keyframe's.",
            "type": "object",
            "properties": {
                "keys": {
                    "description": "Keyframes: pairs of increasing seconds and the number at that time, in the range of the animated number.",
                    "type": "array", "minItems": 1, "maxItems": MAX_KEYFRAMES,
                    "items": {
                        "type": "array", "minItems": 2, "maxItems": 2,
                        "prefixItems": [
                            { "type": "number", "minimum": -MAX_KEYFRAME_SECONDS, "maximum": MAX_KEYFRAME_SECONDS },
                            { "type": "number" }
                        ]
                    }
                },
                "ease": { "description": "Interpolation between keyframes.", "anyOf": [ease], "default": "linear" }
            },
            "required": ["keys"],
            "additionalProperties": false
        })
    }
}

/// Schema of a number, extended to allow a track of such numbers.
pub(super) fn or_track(mut schema: Schema, generator: &mut SchemaGenerator) -> Schema {
    let track = generator.subschema_for::<TrackSchema>();
    // Its range applies to numbers only, so it stays in place.
    if let Some(number) = schema.remove("type") {
        schema.insert("anyOf".to_owned(), serde_json::json!([{ "type": number }, track]));
    }
    schema
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seek::{FrameTime, Seek};
    use crate::values::{Color, Coordinate, Direction, FrameRate, Length, LengthOrZero, Point, Rotation};

    fn at<T: serde::de::DeserializeOwned + Seek>(seconds: f64, text: &str) -> T {
        let mut value: T = serde_json::from_str(text).unwrap_or_else(|error| panic!("{text}: {error}"));
        value.seek(&mut FrameTime::at(seconds)).unwrap_or_else(|misfit| panic!("{text}: {misfit:?}"));
        value
    }

    fn refusal<T: serde::de::DeserializeOwned + fmt::Debug>(text: &str) -> String {
        let mut deserializer = serde_json::Deserializer::from_str(text);
        let error = serde_path_to_error::deserialize::<_, T>(&mut deserializer).expect_err(text);
        format!("{}: {}", error.path(), error.inner())
    }

    #[test]
    fn a_track_clamps_at_its_ends_and_interpolates_between_keyframes() {
        let linear = |seconds| at::<Coordinate>(seconds, r#"{ "keys": [[1, 2], [3, 6], [4, -2]] }"#).get();
        assert_eq!([0.0, 1.0, 1.5, 2.0, 3.0, 3.25, 4.0, 9.0].map(linear), [2.0, 2.0, 3.0, 4.0, 6.0, 4.0, -2.0, -2.0]);
        let step = |seconds| at::<Coordinate>(seconds, r#"{ "ease": "step", "keys": [[1, 2], [3, 6]] }"#).get();
        assert_eq!([0.0, 2.9, 3.0, 5.0].map(step), [2.0, 2.0, 6.0, 6.0]);
        let smooth = |seconds| at::<Coordinate>(seconds, r#"{ "keys": [[0, 0], [4, 64]], "ease": "smooth" }"#).get();
        assert_eq!([0.0, 1.0, 2.0, 3.0, 4.0].map(smooth), [0.0, 10.0, 32.0, 54.0, 64.0]);
    }

    #[test]
    fn an_animated_number_is_animated_at_every_time() {
        const TRACK: &str = r#"{ "keys": [[0, 0], [2, 1]] }"#;
        let [first, later] = [0.0, 1.0].map(|seconds| at::<LengthOrZero>(seconds, TRACK));
        assert!(first.is_animated() && first.get() == 0.0 && !first.is_zero());
        assert!(later.is_animated() && later.get() == 0.5);
        assert!(at::<LengthOrZero>(0.0, "0").is_zero() && !at::<LengthOrZero>(0.0, "0").is_animated());
        assert!(!at::<Color>(0.0, &format!("[0, {TRACK}, 0]")).is_black() && at::<Color>(0.0, "[0, 0, 0]").is_black());
        assert_eq!(at::<Color>(1.0, &format!("[0, {TRACK}, 0]")).get().y, 0.5);
        assert!(at::<Direction>(1.0, &format!("[1, {TRACK}, 0]")).is_animated());
        assert!(at::<Rotation>(1.0, &format!("[0, {TRACK}, 0]")).is_animated());
        assert_eq!(at::<Point>(1.0, &format!("[7, {TRACK}, 0]")).get().y, 0.5);
    }

    #[test]
    fn an_animated_number_survives_a_json_round_trip() {
        let number = at::<Length>(1.0, r#"{ "keys": [[0, 1], [4, 3]] }"#);
        let text = serde_json::to_string(&number).unwrap();
        let again = at::<Length>(9.0, &text);
        assert!(again.is_animated() && again.get() == 1.5, "{text}");
        let color: Color = at(1.0, r#"[1, { "keys": [[0, 1], [4, 3]] }, 0]"#);
        let again: Color = serde_json::from_str(&serde_json::to_string(&color).unwrap()).unwrap();
        assert!(again.is_animated() && again.get() == color.get());
    }

    #[test]
    fn a_value_between_0_and_the_minimum_snaps_to_one() {
        let amount = |seconds| at::<LengthOrZero>(seconds, r#"{ "keys": [[0, 0], [1, 1]] }"#).get();
        assert_eq!(amount(1e-7), 0.0);
        assert_eq!(amount(0.5), 0.5);
        let amount = |seconds| at::<LengthOrZero>(seconds, r#"{ "keys": [[0, 0], [1, 1e-6]] }"#).get();
        assert_eq!([0.25, 0.75].map(amount), [0.0, 1e-6]);
    }

    #[test]
    fn an_error_in_a_track_has_its_pointer() {
        for (text, place, words) in [
            (r#"{ "keys": [] }"#, "keys", "needs a key"),
            (r#"{ "keys": [[0, 1], [2, -3]] }"#, "keys[1][1]", "from 1e-6"),
            (r#"{ "keys": [[0, 1], [2, 2], [2, 3]] }"#, "keys[2][0]", "order of time"),
            (r#"{ "keys": [[0, 1], ["2", 2]] }"#, "keys[1][0]", "seconds"),
            (r#"{ "keys": [[1e12, 1]] }"#, "keys[0][0]", "seconds"),
            (r#"{ "keys": [[0]] }"#, "keys[0]", "[seconds, number]"),
            (r#"{ "keys": [[0, 1, 2]] }"#, "keys[0]", "[seconds, number]"),
            (r#"{ "keys": [[0, { "keys": [[0, 1]] }]] }"#, "keys[0][1]", "a number"),
            (r#"{ "keys": [[0, 1]], "ease": "bounce" }"#, "ease", "smooth"),
            (r#"{ "keys": [[0, 1]], "loop": true }"#, "loop", "unknown"),
            (r#"{ "ease": "linear" }"#, ".", "keys"),
            (r#""1""#, ".", "a number, or a track"),
        ] {
            let told = refusal::<Length>(text);
            assert!(told.starts_with(&format!("{place}: ")) && told.contains(words), "{text}: {told}");
        }
        let long: Vec<String> = (0..=MAX_KEYFRAMES).map(|key| format!("[{key}, 1]")).collect();
        let told = refusal::<Length>(&format!(r#"{{ "keys": [{}] }}"#, long.join(",")));
        assert!(told.starts_with("keys: ") && told.contains("10000"), "{told}");
    }

    #[test]
    fn frame_counts_cannot_be_tracks() {
        assert!(refusal::<FrameRate>(r#"{ "keys": [[0, 24]] }"#).contains("a number"));
    }
}
