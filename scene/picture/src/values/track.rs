//! Tracks: values that change over the frames of a job, by keyframes.

mod ease;
mod keyframes;
#[cfg(test)]
mod tests;

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

pub use ease::Ease;
pub(super) use keyframes::{Keyframe, KeyframeValue, Keyframes};

use crate::limits::{MAX_KEYFRAME_SECONDS, MAX_KEYFRAMES};

/// Continuation of a track before its first keyframe and after its last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Loop {
    /// Starts again from the first keyframe.
    Repeat,
    /// Goes back to the first keyframe, and forth again.
    PingPong,
}

/// A number over time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "WrittenTrack<f32>")]
pub struct Track {
    /// Keyframes in the order of time; one or more.
    #[serde(serialize_with = "write_keys")]
    keys: Vec<Keyframe<f32>>,
    ease: Ease,
    #[serde(rename = "loop", skip_serializing_if = "Option::is_none")]
    cycle: Option<Loop>,
}

fn write_keys<S: Serializer>(keys: &[Keyframe<f32>], serializer: S) -> Result<S::Ok, S::Error> {
    #[derive(Serialize)]
    #[serde(untagged)]
    enum Key {
        Plain(f64, f32),
        Eased(f64, f32, Ease),
    }
    serializer.collect_seq(keys.iter().map(|&(seconds, value, ease)| match ease {
        None => Key::Plain(seconds, value),
        Some(ease) => Key::Eased(seconds, value, ease),
    }))
}

/// A track of values as it is parsed.
#[derive(Deserialize)]
#[serde(rename = "Track", deny_unknown_fields, bound(deserialize = "V: Deserialize<'de> + KeyframeValue"))]
pub(super) struct WrittenTrack<V> {
    keys: Keyframes<V>,
    #[serde(default)]
    ease: Ease,
    #[serde(default, rename = "loop")]
    cycle: Option<Loop>,
}

impl KeyframeValue for f32 {
    const KEY: &'static str = "[seconds, number]";
}

impl From<WrittenTrack<f32>> for Track {
    fn from(written: WrittenTrack<f32>) -> Self {
        written.track(|value| *value)
    }
}

impl<V> WrittenTrack<V> {
    /// A track of its parts.
    pub(super) fn new(keys: Keyframes<V>, ease: Ease, cycle: Option<Loop>) -> Self {
        Self { keys, ease, cycle }
    }

    /// Its values.
    pub(super) fn values(&self) -> impl Iterator<Item = &V> {
        self.keys.0.iter().map(|key| &key.1)
    }

    /// The track of one number of each value.
    pub(super) fn track(&self, number: impl Fn(&V) -> f32) -> Track {
        let keys = self.keys.0.iter().map(|(seconds, value, ease)| (*seconds, number(value), *ease));
        Track { keys: keys.collect(), ease: self.ease, cycle: self.cycle }
    }
}

impl Track {
    /// Times of its keyframes.
    pub(crate) fn keyframe_times(&self) -> impl Iterator<Item = f64> {
        self.keys.iter().map(|key| key.0)
    }

    /// The number at a time. `is_in_range` returns whether a number is in range.
    pub fn at(&self, now: f64, is_in_range: fn(f32) -> bool) -> f32 {
        let now = self.in_cycle(now);
        let next = self.keys.partition_point(|key| key.0 <= now);
        let (from, before, _) = self.keys[next.saturating_sub(1)];
        let (to, after, ease) = self.keys[next.min(self.keys.len() - 1)];
        let length = to - from;
        if length <= 0.0 || now <= from {
            return before;
        }
        let share = (now - from) / length;
        let way = ease.unwrap_or(self.ease).apply(share);
        let (low, high) = (f64::from(before), f64::from(after));
        let value = (low + (high - low) * way) as f32 + 0.0;
        // An easing may go beyond its keyframes.
        let value = if (0.0..=1.0).contains(&way) { value.clamp(before.min(after), before.max(after)) } else { value };
        if is_in_range(value) {
            return value;
        }
        // If the range has a gap, as between 0 and the minimum size, or ends here, the nearer keyframe is used.
        if way < 0.5 { before } else { after }
    }

    /// The time within the keyframes, if the track is a loop.
    fn in_cycle(&self, now: f64) -> f64 {
        let (Some(cycle), [first, .., last]) = (self.cycle, self.keys.as_slice()) else { return now };
        let length = last.0 - first.0;
        let turns = (now - first.0) / length;
        let share = match cycle {
            Loop::Repeat => turns - turns.floor(),
            Loop::PingPong => {
                let share = turns - 2.0 * (turns * 0.5).floor();
                if share > 1.0 { 2.0 - share } else { share }
            }
        };
        first.0 + length * share
    }
}

/// Schema of a track, whose values are described by `value`; `example` is a first and a second one.
pub(super) fn schema(about: &str, value: &Schema, example: [Value; 2], generator: &mut SchemaGenerator) -> Schema {
    let [first, second] = example;
    let (ease, cycle) = (generator.subschema_for::<Ease>(), generator.subschema_for::<Loop>());
    json_schema!({
        "description": about,
        "examples": [{ "keys": [[0, first], [2, second]] }],
        "type": "object",
        "properties": {
            "keys": {
                "description": "Keyframes: increasing seconds, the value at that time, and optionally how it is reached.",
                "type": "array", "minItems": 1, "maxItems": MAX_KEYFRAMES,
                "items": {
                    "type": "array", "minItems": 2, "maxItems": 3,
                    "prefixItems": [
                        { "type": "number", "minimum": -MAX_KEYFRAME_SECONDS, "maximum": MAX_KEYFRAME_SECONDS },
                        value,
                        ease
                    ]
                }
            },
            "ease": { "description": "How a value is reached from the keyframe before, unless a key says it.", "anyOf": [ease], "default": "linear" },
            "loop": { "description": "What comes after the last keyframe and before the first: their values if absent.", "anyOf": [cycle] }
        },
        "required": ["keys"],
        "additionalProperties": false
    })
}

/// Schema of a number over time.
pub(super) struct TrackSchema;

impl JsonSchema for TrackSchema {
    fn schema_name() -> Cow<'static, str> {
        "Track".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let about = "A number over time: frame i has its value at i/fps seconds. Before the first keyframe the value is the first keyframe's; after the last, the last keyframe's.";
        schema(about, &json_schema!({ "type": "number" }), [1.into(), 2.into()], generator)
    }
}
