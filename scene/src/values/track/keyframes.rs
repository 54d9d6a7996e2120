//! Deserializes the keyframes of a track one by one, so that each error has its own pointer.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{DeserializeSeed, Error, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::{RangedNumber, read_constant};
use crate::limits::{MAX_KEYFRAME_SECONDS, MAX_KEYFRAMES};

/// Keyframes in the order of time, one or more, with numbers in the range of `T`.
pub(super) struct KeyframeSpan<T>(pub(super) Vec<(f64, f32)>, PhantomData<T>);

impl<'de, T: RangedNumber> Deserialize<'de> for KeyframeSpan<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(KeysVisitor(PhantomData))
    }
}

struct KeysVisitor<T>(PhantomData<T>);

impl<'de, T: RangedNumber> Visitor<'de> for KeysVisitor<T> {
    type Value = KeyframeSpan<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of keys: [[seconds, number], …]")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<KeyframeSpan<T>, A::Error> {
        let mut keys: Vec<(f64, f32)> = Vec::new();
        let seed = |last: Option<&(f64, f32)>| KeyframeSeed::<T> { last: last.map(|key| key.0), value: PhantomData };
        while let Some(key) = list.next_element_seed(seed(keys.last()))? {
            if keys.len() == MAX_KEYFRAMES {
                return Err(A::Error::custom(format_args!("has more than {MAX_KEYFRAMES} keys: use fewer")));
            }
            keys.push(key);
        }
        if keys.is_empty() {
            return Err(A::Error::custom("is empty: a track needs a key or more, as in [[0, 1.0], [2, 3.0]]"));
        }
        Ok(KeyframeSpan(keys, PhantomData))
    }
}

/// Deserializes `[seconds, number]`; seconds must be more than the previous keyframe's.
struct KeyframeSeed<T> {
    last: Option<f64>,
    value: PhantomData<T>,
}

impl<'de, T: RangedNumber> DeserializeSeed<'de> for KeyframeSeed<T> {
    type Value = (f64, f32);

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(f64, f32), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de, T: RangedNumber> Visitor<'de> for KeyframeSeed<T> {
    type Value = (f64, f32);

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key: [seconds, number]")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut key: A) -> Result<(f64, f32), A::Error> {
        let expected = "a key: [seconds, number]";
        let seconds = key.next_element_seed(SecondsSeed(self.last))?;
        let seconds = seconds.ok_or_else(|| A::Error::invalid_length(0, &expected))?;
        let value = key.next_element::<Value<T>>()?.ok_or_else(|| A::Error::invalid_length(1, &expected))?;
        if key.next_element::<IgnoredAny>()?.is_some() {
            return Err(A::Error::invalid_length(3, &expected));
        }
        Ok((seconds, value.0.value()))
    }
}

/// A keyframe's number, which cannot be a track.
struct Value<T>(T);

impl<'de, T: RangedNumber> Deserialize<'de> for Value<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        read_constant(deserializer).map(Self)
    }
}

/// Deserializes a keyframe's time, which must be more than the previous one's.
struct SecondsSeed(Option<f64>);

impl<'de> DeserializeSeed<'de> for SecondsSeed {
    type Value = f64;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<f64, D::Error> {
        deserializer.deserialize_f64(self)
    }
}

impl Visitor<'_> for SecondsSeed {
    type Value = f64;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key's time, a number of seconds")
    }

    fn visit_f64<E: Error>(self, seconds: f64) -> Result<f64, E> {
        if seconds.is_nan() || seconds.abs() > MAX_KEYFRAME_SECONDS {
            return Err(E::custom(format_args!("must be seconds within ±{MAX_KEYFRAME_SECONDS}, not {seconds}")));
        }
        match self.0 {
            Some(last) if seconds <= last => Err(E::custom(format_args!(
                "must be more than {last}, the time of the previous key: put keys in the order of time"
            ))),
            Some(_) | None => Ok(seconds),
        }
    }

    fn visit_i64<E: Error>(self, seconds: i64) -> Result<f64, E> {
        self.visit_f64(seconds as f64)
    }

    fn visit_u64<E: Error>(self, seconds: u64) -> Result<f64, E> {
        self.visit_f64(seconds as f64)
    }
}
