//! Tracks: numbers that change over the frames of a job, and the one time at which a job is read.
//!
//! A track becomes a plain number at the moment it is read: serde hands no context to what it
//! reads, so the time stands in a thread-local, which the parser alone sets, by a [`Reading`].
//! Where there is none, it is second 0.

mod keys;

use std::borrow::Cow;
use std::cell::RefCell;
use std::fmt;
use std::marker::PhantomData;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::ser::SerializeStruct;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use self::keys::Keys;
use super::Replayed;
use crate::limits::{MAX_KEY_SECONDS, MAX_KEYS};
use crate::materials::Texture;

/// The time that tracks are read for, and what was seen of them.
#[derive(Debug)]
struct Clock {
    seconds: f64,
    key_seconds: Vec<f64>,
}

thread_local! {
    static CLOCK: RefCell<Clock> = const { RefCell::new(Clock { seconds: 0.0, key_seconds: Vec::new() }) };
}

/// Until it ends, what this thread reads stands as it does at a time.
#[derive(Debug)]
pub(crate) struct Reading {
    before: Option<Clock>,
}

impl Reading {
    /// Tracks are read for this time from here on.
    pub(crate) fn at(seconds: f64) -> Self {
        Self { before: Some(CLOCK.replace(Clock { seconds, key_seconds: Vec::new() })) }
    }

    /// Ends it; the times of all keys that were read, none if nothing moves.
    pub(crate) fn end(mut self) -> Vec<f64> {
        self.before.take().map_or_else(Vec::new, |before| CLOCK.replace(before).key_seconds)
    }
}

/// The time of the reading.
fn now() -> f64 {
    CLOCK.with_borrow(|clock| clock.seconds)
}

/// Notes that a key was read.
fn note_key(seconds: f64) {
    CLOCK.with_borrow_mut(|clock| clock.key_seconds.push(seconds));
}

impl Drop for Reading {
    fn drop(&mut self) {
        if let Some(before) = self.before.take() {
            CLOCK.set(before);
        }
    }
}

/// A kind of number, with its range.
pub(super) trait Ranged: Copy {
    /// What a number of this kind must be.
    const WORDS: &'static str;

    /// The number, if it is in range.
    fn ranged(value: f32) -> Option<Self>;

    /// The number.
    fn value(self) -> f32;

    /// The same number, which is another one in other frames.
    fn moving(self) -> Self;
}

/// A number of JSON as one of its kind; finite and in range, or what it should be.
pub(super) fn number<T: Ranged, E: Error>(value: f64) -> Result<T, E> {
    let number = value as f32;
    if !number.is_finite() {
        return Err(E::custom(format_args!("{value:e} is too large: numbers go up to 3.4e38")));
    }
    // No result depends on the sign of a zero, and no key should either.
    T::ranged(number + 0.0).ok_or_else(|| E::custom(format_args!("must be {}, not {}", T::WORDS, number + 0.0)))
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

/// Reads a number that nothing moves.
pub(super) struct Unmoved<T>(PhantomData<T>);

impl<T: Ranged> Visitor<'_> for Unmoved<T> {
    type Value = T;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number")
    }

    visit_numbers!(T);
}

/// Reads a number, or a track as it stands at the time of the reading.
pub(super) struct NumberOrTrack<T>(PhantomData<T>);

impl<'de, T: Ranged> Visitor<'de> for NumberOrTrack<T> {
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
        let Track::<T> { keys, ease } = Track::deserialize(MapAccessDeserializer::new(Replayed::new(first, map)))?;
        Ok(keys.between(ease).moving())
    }
}

/// Reads a number that nothing moves.
pub(super) fn read_still<'de, T: Ranged, D: Deserializer<'de>>(d: D) -> Result<T, D::Error> {
    d.deserialize_f64(Unmoved(PhantomData))
}

/// Reads a number, or a track as it stands at the time of the reading.
pub(super) fn read<'de, T: Ranged, D: Deserializer<'de>>(d: D) -> Result<T, D::Error> {
    d.deserialize_any(NumberOrTrack(PhantomData))
}

/// Writes a number; one that moves as a track that stands still, so that it is read again as it was.
pub(super) fn write<S: Serializer>(value: f32, is_moving: bool, serializer: S) -> Result<S::Ok, S::Error> {
    if !is_moving {
        return serializer.serialize_f32(value);
    }
    let mut track = serializer.serialize_struct("Track", 1)?;
    track.serialize_field("keys", &[(0, value)])?;
    track.end()
}

/// How a number goes from one key to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Ease {
    /// Evenly.
    #[default]
    Linear,
    /// Slowly away from a key and slowly up to the next: s²(3 − 2s) for the share s of the way.
    Smooth,
    /// Not at all: it is the earlier key's until the next one's time.
    Step,
}

impl Ease {
    fn eased(self, share: f64) -> f64 {
        match self {
            Self::Linear => share,
            Self::Smooth => share * share * (3.0 - 2.0 * share),
            Self::Step => 0.0,
        }
    }
}

/// A number over time.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, bound(deserialize = "T: Ranged"))]
struct Track<T> {
    keys: Keys<T>,
    #[serde(default)]
    ease: Ease,
}

/// The schema of a track, whose numbers have the range of what it moves.
struct TrackSchema;

impl JsonSchema for TrackSchema {
    fn schema_name() -> Cow<'static, str> {
        "Track".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let ease = generator.subschema_for::<Ease>();
        json_schema!({
            "description": "A number over time: frame i shows it at i/fps seconds. Before the first key it is that key's, and behind the last one that one's.",
            "type": "object",
            "properties": {
                "keys": {
                    "description": "Pairs of seconds, which rise, and the number there, in the range of what is moved.",
                    "type": "array", "minItems": 1, "maxItems": MAX_KEYS,
                    "items": {
                        "type": "array", "minItems": 2, "maxItems": 2,
                        "prefixItems": [
                            { "type": "number", "minimum": -MAX_KEY_SECONDS, "maximum": MAX_KEY_SECONDS },
                            { "type": "number" }
                        ]
                    }
                },
                "ease": { "description": "How it goes from one key to the next.", "anyOf": [ease], "default": "linear" }
            },
            "required": ["keys"],
            "additionalProperties": false
        })
    }
}

/// The schema of a number, as that of the number or a track of such numbers.
pub(super) fn or_track(mut schema: Schema, generator: &mut SchemaGenerator) -> Schema {
    let track = generator.subschema_for::<TrackSchema>();
    // Its range says nothing of what is no number, so it stays where it is.
    if let Some(number) = schema.remove("type") {
        schema.insert("anyOf".to_owned(), serde_json::json!([{ "type": number }, track]));
    }
    schema
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::values::{Amount, Color, Coordinate, Direction, FrameRate, Length, Point, Rotation};

    fn at<T: serde::de::DeserializeOwned>(seconds: f64, text: &str) -> T {
        let reading = Reading::at(seconds);
        let value = serde_json::from_str(text).unwrap_or_else(|error| panic!("{text}: {error}"));
        reading.end();
        value
    }

    fn refusal<T: serde::de::DeserializeOwned + fmt::Debug>(text: &str) -> String {
        let mut deserializer = serde_json::Deserializer::from_str(text);
        let error = serde_path_to_error::deserialize::<_, T>(&mut deserializer).expect_err(text);
        format!("{}: {}", error.path(), error.inner())
    }

    #[test]
    fn a_track_holds_its_ends_and_goes_between_its_keys() {
        let linear = |seconds| at::<Coordinate>(seconds, r#"{ "keys": [[1, 2], [3, 6], [4, -2]] }"#).get();
        assert_eq!([0.0, 1.0, 1.5, 2.0, 3.0, 3.25, 4.0, 9.0].map(linear), [2.0, 2.0, 3.0, 4.0, 6.0, 4.0, -2.0, -2.0]);
        let step = |seconds| at::<Coordinate>(seconds, r#"{ "ease": "step", "keys": [[1, 2], [3, 6]] }"#).get();
        assert_eq!([0.0, 2.9, 3.0, 5.0].map(step), [2.0, 2.0, 6.0, 6.0]);
        let smooth = |seconds| at::<Coordinate>(seconds, r#"{ "keys": [[0, 0], [4, 64]], "ease": "smooth" }"#).get();
        assert_eq!([0.0, 1.0, 2.0, 3.0, 4.0].map(smooth), [0.0, 10.0, 32.0, 54.0, 64.0]);
    }

    #[test]
    fn a_number_knows_that_it_moves_wherever_it_stands() {
        const TRACK: &str = r#"{ "keys": [[0, 0], [2, 1]] }"#;
        let [first, later] = [0.0, 1.0].map(|seconds| at::<Amount>(seconds, TRACK));
        assert!(first.is_moving() && first.get() == 0.0 && !first.is_zero());
        assert!(later.is_moving() && later.get() == 0.5);
        assert!(at::<Amount>(0.0, "0").is_zero() && !at::<Amount>(0.0, "0").is_moving());
        assert!(!at::<Color>(0.0, &format!("[0, {TRACK}, 0]")).is_black() && at::<Color>(0.0, "[0, 0, 0]").is_black());
        assert_eq!(at::<Color>(1.0, &format!("[0, {TRACK}, 0]")).get().y, 0.5);
        assert!(at::<Direction>(1.0, &format!("[0, {TRACK}, 0]")).is_moving());
        assert!(at::<Rotation>(1.0, &format!("[0, {TRACK}, 0]")).is_moving());
        assert_eq!(at::<Point>(1.0, &format!("[7, {TRACK}, 0]")).get().y, 0.5);
    }

    #[test]
    fn a_moving_number_survives_the_way_through_json() {
        let number = at::<Length>(1.0, r#"{ "keys": [[0, 1], [4, 3]] }"#);
        let text = serde_json::to_string(&number).unwrap();
        let again = at::<Length>(9.0, &text);
        assert!(again.is_moving() && again.get() == 1.5, "{text}");
        let color: Color = at(1.0, r#"[1, { "keys": [[0, 1], [4, 3]] }, 0]"#);
        let again: Color = serde_json::from_str(&serde_json::to_string(&color).unwrap()).unwrap();
        assert!(again.is_moving() && again.get() == color.get());
    }

    #[test]
    fn an_amount_between_nothing_and_the_least_size_is_one_of_them() {
        let amount = |seconds| at::<Amount>(seconds, r#"{ "keys": [[0, 0], [1, 1]] }"#).get();
        assert_eq!(amount(1e-7), 0.0);
        assert_eq!(amount(0.5), 0.5);
        let amount = |seconds| at::<Amount>(seconds, r#"{ "keys": [[0, 0], [1, 1e-6]] }"#).get();
        assert_eq!([0.25, 0.75].map(amount), [0.0, 1e-6]);
    }

    #[test]
    fn a_fault_of_a_track_is_told_at_its_place() {
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
        let long: Vec<String> = (0..=MAX_KEYS).map(|key| format!("[{key}, 1]")).collect();
        let told = refusal::<Length>(&format!(r#"{{ "keys": [{}] }}"#, long.join(",")));
        assert!(told.starts_with("keys: ") && told.contains("10000"), "{told}");
    }

    #[test]
    fn what_frames_are_counted_by_does_not_move() {
        assert!(refusal::<FrameRate>(r#"{ "keys": [[0, 24]] }"#).contains("a number"));
    }
}
