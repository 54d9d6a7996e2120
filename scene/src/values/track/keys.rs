//! The keys of a track: read one after another, of which only those around the time of the reading are kept.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{DeserializeSeed, Error, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::{Ease, Ranged, note_key, now, read_still};
use crate::limits::{MAX_KEY_SECONDS, MAX_KEYS};

/// The keys around the time of the reading; before the first and behind the last, that one twice.
pub(super) struct Keys<T> {
    before: (f64, T),
    after: (f64, T),
    seconds: f64,
}

impl<T: Ranged> Keys<T> {
    /// The number at the time of the reading.
    pub(super) fn between(&self, ease: Ease) -> T {
        let ((from, before), (to, after)) = (self.before, self.after);
        let length = to - from;
        if length <= 0.0 || self.seconds <= from {
            return before;
        }
        let share = ease.eased((self.seconds - from) / length);
        let (low, high) = (f64::from(before.value()), f64::from(after.value()));
        let value = (low + (high - low) * share) as f32;
        let value = value.clamp(before.value().min(after.value()), before.value().max(after.value()));
        // Where a range has a hole, as between 0 and the least size, the nearer key is in it.
        T::ranged(value + 0.0).unwrap_or(if share < 0.5 { before } else { after })
    }
}

impl<'de, T: Ranged> Deserialize<'de> for Keys<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(KeysVisitor(PhantomData))
    }
}

struct KeysVisitor<T>(PhantomData<T>);

impl<'de, T: Ranged> Visitor<'de> for KeysVisitor<T> {
    type Value = Keys<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of keys: [[seconds, number], …]")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Keys<T>, A::Error> {
        let now = now();
        let (mut count, mut last, mut around) = (0, None, None::<Keys<T>>);
        while let Some(key) = list.next_element_seed(KeySeed { last, value: PhantomData })? {
            count += 1;
            if count > MAX_KEYS {
                return Err(A::Error::custom(format_args!("has more than {MAX_KEYS} keys: use fewer")));
            }
            last = Some(key.0);
            note_key(key.0);
            around = Some(match around {
                None => Keys { before: key, after: key, seconds: now },
                Some(keys) if key.0 <= now => Keys { before: key, after: key, ..keys },
                Some(keys) if keys.after.0 <= now => Keys { after: key, ..keys },
                Some(keys) => keys,
            });
        }
        around.ok_or_else(|| A::Error::custom("is empty: a track needs a key or more, as in [[0, 1.0], [2, 3.0]]"))
    }
}

/// Reads `[seconds, number]`; seconds must be more than the last key's.
struct KeySeed<T> {
    last: Option<f64>,
    value: PhantomData<T>,
}

impl<'de, T: Ranged> DeserializeSeed<'de> for KeySeed<T> {
    type Value = (f64, T);

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(f64, T), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de, T: Ranged> Visitor<'de> for KeySeed<T> {
    type Value = (f64, T);

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key: [seconds, number]")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut key: A) -> Result<(f64, T), A::Error> {
        let expected = "a key: [seconds, number]";
        let seconds = key.next_element_seed(SecondsSeed(self.last))?;
        let seconds = seconds.ok_or_else(|| A::Error::invalid_length(0, &expected))?;
        let Value(value) = key.next_element()?.ok_or_else(|| A::Error::invalid_length(1, &expected))?;
        if key.next_element::<IgnoredAny>()?.is_some() {
            return Err(A::Error::invalid_length(3, &expected));
        }
        Ok((seconds, value))
    }
}

/// A key's number, which is no track itself.
struct Value<T>(T);

impl<'de, T: Ranged> Deserialize<'de> for Value<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        read_still(deserializer).map(Self)
    }
}

/// Reads a key's time, which is more than the last one's.
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
        if seconds.is_nan() || seconds.abs() > MAX_KEY_SECONDS {
            return Err(E::custom(format_args!("must be seconds within ±{MAX_KEY_SECONDS}, not {seconds}")));
        }
        match self.0 {
            Some(last) if seconds <= last => Err(E::custom(format_args!(
                "must be more than {last}, the time of the key before: put keys in the order of time"
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
