//! Deserializes the keyframes of a track one by one, so that each error has its own pointer.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{DeserializeSeed, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::super::motion::CONSTANT_FORMULA;
use super::Ease;
use crate::limits::{MAX_KEYFRAME_SECONDS, MAX_KEYFRAMES};

/// A keyframe: its time in seconds, its value, and how the value is reached, if that differs from the track's easing.
pub(crate) type Keyframe<V> = (f64, V, Option<Ease>);

/// Keyframes in the order of time, one or more.
pub(crate) struct Keyframes<V>(pub(crate) Vec<Keyframe<V>>);

/// A type of keyframes' values.
pub(crate) trait KeyframeValue {
    /// Form of such a keyframe, for messages.
    const KEY: &'static str;
}

impl<'de, V: Deserialize<'de> + KeyframeValue> Deserialize<'de> for Keyframes<V> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(KeysVisitor(PhantomData))
    }
}

struct KeysVisitor<V>(PhantomData<V>);

impl<'de, V: Deserialize<'de> + KeyframeValue> Visitor<'de> for KeysVisitor<V> {
    type Value = Keyframes<V>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a list of keys: [{}, …]", V::KEY)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Keyframes<V>, A::Error> {
        let mut keys: Vec<Keyframe<V>> = Vec::new();
        let seed = |last: Option<&Keyframe<V>>| KeyframeSeed::<V> { last: last.map(|key| key.0), value: PhantomData };
        while let Some(key) = list.next_element_seed(seed(keys.last()))? {
            if keys.len() == MAX_KEYFRAMES {
                return Err(A::Error::custom(format_args!("has more than {MAX_KEYFRAMES} keys: use fewer")));
            }
            keys.push(key);
        }
        if keys.is_empty() {
            return Err(A::Error::custom(format_args!("is empty: a track needs a key or more: {}", V::KEY)));
        }
        Ok(Keyframes(keys))
    }
}

/// Deserializes a keyframe; its seconds must be more than the previous keyframe's.
struct KeyframeSeed<V> {
    last: Option<f64>,
    value: PhantomData<V>,
}

impl<'de, V: Deserialize<'de> + KeyframeValue> DeserializeSeed<'de> for KeyframeSeed<V> {
    type Value = Keyframe<V>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Keyframe<V>, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de, V: Deserialize<'de> + KeyframeValue> Visitor<'de> for KeyframeSeed<V> {
    type Value = Keyframe<V>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a key: {}", V::KEY)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut key: A) -> Result<Keyframe<V>, A::Error> {
        let is_first = self.last.is_none();
        let seconds = key.next_element_seed(SecondsSeed(self.last))?;
        let seconds = seconds.ok_or_else(|| A::Error::invalid_length(0, &self))?;
        let value = key.next_element::<V>()?.ok_or_else(|| A::Error::invalid_length(1, &self))?;
        let ease = key.next_element::<Ease>()?;
        if key.next_element::<IgnoredAny>()?.is_some() {
            let key = V::KEY.trim_end_matches(']');
            let form = if V::KEY.ends_with("]]") { format!("{key}], easing]") } else { format!("{key}, easing]") };
            return Err(A::Error::custom(format_args!("has more than 3 entries: write {form}")));
        }
        if is_first && ease.is_some() {
            return Err(A::Error::custom(
                "is the first key, and has an easing: an easing is that of the way to its key, so remove it here",
            ));
        }
        Ok((seconds, value, ease))
    }
}

/// Deserializes a keyframe's time, which must be more than the previous one's.
struct SecondsSeed(Option<f64>);

impl<'de> DeserializeSeed<'de> for SecondsSeed {
    type Value = f64;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<f64, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for SecondsSeed {
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

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<f64, A::Error> {
        Err(match map.next_key::<String>()?.as_deref() {
            Some("expr") => A::Error::custom(CONSTANT_FORMULA),
            _ => A::Error::custom("must be a key's time, a number of seconds, not an object"),
        })
    }
}
