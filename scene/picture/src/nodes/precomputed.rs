//! Primitives with derived values that cost more than the formula itself.

use std::ops::Deref;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::seek::{FrameTime, Seek, SeekError};

/// Parameters of a primitive, as in JSON.
pub trait Precompute {
    /// Values that its formula uses.
    type Derived: Clone + std::fmt::Debug;

    /// Derives the values.
    fn derive(&self) -> Self::Derived;
}

/// A primitive's parameters, with the values derived from them once, when the job is parsed.
// Boxed, so that nodes stay small.
#[derive(Debug)]
pub struct Precomputed<G: Precompute>(Box<GivenAndDerived<G>>);

#[derive(Debug)]
struct GivenAndDerived<G: Precompute> {
    given: G,
    derived: G::Derived,
}

impl<G: Precompute> Precomputed<G> {
    /// Derived values.
    pub(super) fn derive(&self) -> &G::Derived {
        &self.0.derived
    }
}

impl<G: Precompute> From<G> for Precomputed<G> {
    fn from(given: G) -> Self {
        let derived = given.derive();
        Self(Box::new(GivenAndDerived { given, derived }))
    }
}

/// The parameters.
impl<G: Precompute> Deref for Precomputed<G> {
    type Target = G;

    fn deref(&self) -> &G {
        &self.0.given
    }
}

impl<G: Precompute + Seek> Seek for Precomputed<G> {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        let GivenAndDerived { given, derived } = &mut *self.0;
        let is_animated = given.seek(clock)?;
        if is_animated {
            *derived = given.derive();
        }
        Ok(is_animated)
    }
}

impl<G: Precompute + Clone> Clone for Precomputed<G> {
    fn clone(&self) -> Self {
        let GivenAndDerived { given, derived } = &*self.0;
        Self(Box::new(GivenAndDerived { given: given.clone(), derived: derived.clone() }))
    }
}

impl<G: Precompute + PartialEq> PartialEq for Precomputed<G> {
    fn eq(&self, other: &Self) -> bool {
        self.0.given == other.0.given
    }
}

impl<'de, G: Precompute + Deserialize<'de>> Deserialize<'de> for Precomputed<G> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        G::deserialize(deserializer).map(Self::from)
    }
}

impl<G: Precompute + Serialize> Serialize for Precomputed<G> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.given.serialize(serializer)
    }
}

impl<G: Precompute + JsonSchema> JsonSchema for Precomputed<G> {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        G::schema_name()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        G::json_schema(generator)
    }
}
