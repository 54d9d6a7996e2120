//! Peeks at the first member of a map before its type is known.

use serde::de::value::StringDeserializer;
use serde::de::{DeserializeSeed, MapAccess};

/// A map whose first key has been read.
pub(crate) struct PeekedMap<A> {
    first: Option<String>,
    rest: A,
}

impl<A> PeekedMap<A> {
    /// The map from before `first`, its first key if it has one, was read from `rest`.
    pub(crate) fn new(first: Option<String>, rest: A) -> Self {
        Self { first, rest }
    }
}

impl<'de, A: MapAccess<'de>> MapAccess<'de> for PeekedMap<A> {
    type Error = A::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, A::Error> {
        match self.first.take() {
            Some(first) => seed.deserialize(StringDeserializer::new(first)).map(Some),
            None => self.rest.next_key_seed(seed),
        }
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, A::Error> {
        self.rest.next_value_seed(seed)
    }
}
