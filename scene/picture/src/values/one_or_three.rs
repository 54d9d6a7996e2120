//! Tracks of values that are one number or three: all keys of a track are of one kind.

use std::fmt;
use std::marker::PhantomData;

use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::motion::{self, Motion, OfKind, RangedNumber};
use super::track::{KeyframeValue, WrittenTrack};
use super::triple;

/// A type of values that are one number or three.
pub(super) trait OneOrThree {
    /// Kind of the one number.
    type One: RangedNumber;
    /// Kind of the three numbers.
    type Three: RangedNumber;
    /// Form of a keyframe, for messages.
    const KEY: &'static str;
    /// Description of a keyframe's value, for messages.
    const EXPECTED: &'static str;
    /// The kinds of keys that one track has not together, for messages.
    const KINDS: &'static str;
}

/// A value of a type, with its track.
pub(super) enum Tracked<T: OneOrThree> {
    /// One number.
    One(T::One),
    /// Three numbers.
    Three([T::Three; 3]),
}

/// Reads a track of such values.
pub(super) fn read_track<'de, T: OneOrThree, A: MapAccess<'de>>(map: A) -> Result<Tracked<T>, A::Error> {
    let written = WrittenTrack::<Key<T>>::deserialize(MapAccessDeserializer::new(map))?;
    let is_one = |key: &Key<T>| matches!(key, Key::One(_));
    if written.values().all(is_one) {
        let one = |key: &Key<T>| match key {
            Key::One(number) => number.0.value(),
            Key::Three([first, ..]) => first.0.value(),
        };
        return Motion::Track(written.track(one)).start().map(Tracked::One);
    }
    if written.values().any(is_one) {
        return Err(A::Error::custom(format_args!("has {}: write the same in all", T::KINDS)));
    }
    let three = |key: &Key<T>, axis: usize| match key {
        Key::One(number) => number.0.value(),
        Key::Three(numbers) => numbers[axis].0.value(),
    };
    triple::of_track(&written, three).map(Tracked::Three)
}

/// A keyframe's number, or its three.
enum Key<T: OneOrThree> {
    One(OfKind<T::One>),
    Three([OfKind<T::Three>; 3]),
}

impl<T: OneOrThree> KeyframeValue for Key<T> {
    const KEY: &'static str = T::KEY;
}

impl<'de, T: OneOrThree> Deserialize<'de> for Key<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(KeyVisitor(PhantomData))
    }
}

struct KeyVisitor<T>(PhantomData<T>);

impl<'de, T: OneOrThree> Visitor<'de> for KeyVisitor<T> {
    type Value = Key<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(T::EXPECTED)
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Key<T>, E> {
        motion::number(value).map(|number| Key::One(OfKind(number)))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Key<T>, E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Key<T>, E> {
        self.visit_f64(value as f64)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Key<T>, A::Error> {
        Deserialize::deserialize(SeqAccessDeserializer::new(list)).map(Key::Three)
    }
}
