//! Primitives whose formula wants numbers that cost more to derive than the formula itself does.

use std::ops::Deref;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::seek::{Clock, Misfit, Seek};

/// A primitive's numbers as a user gives them.
pub trait Prepare {
    /// Values that its formula uses.
    type Ready: Clone;

    /// Derives it.
    fn ready(&self) -> Self::Ready;
}

/// A primitive's parameters, with the values derived from them once, when it is read.
#[derive(Debug)]
pub struct Prepared<G: Prepare> {
    given: G,
    // Boxed, so that nodes stay small.
    ready: Box<G::Ready>,
}

impl<G: Prepare> Prepared<G> {
    /// Derived values.
    #[inline(always)]
    pub(super) fn ready(&self) -> &G::Ready {
        &self.ready
    }
}

impl<G: Prepare> From<G> for Prepared<G> {
    fn from(given: G) -> Self {
        let ready = Box::new(given.ready());
        Self { given, ready }
    }
}

/// The numbers as given.
impl<G: Prepare> Deref for Prepared<G> {
    type Target = G;

    #[inline(always)]
    fn deref(&self) -> &G {
        &self.given
    }
}

impl<G: Prepare + Seek> Seek for Prepared<G> {
    fn seek(&mut self, clock: &mut Clock<'_>) -> Result<bool, Box<Misfit>> {
        let Self { given, ready } = self;
        let is_animated = given.seek(clock)?;
        if is_animated {
            **ready = given.ready();
        }
        Ok(is_animated)
    }
}

impl<G: Prepare + Clone> Clone for Prepared<G> {
    fn clone(&self) -> Self {
        Self { given: self.given.clone(), ready: self.ready.clone() }
    }
}

impl<G: Prepare + PartialEq> PartialEq for Prepared<G> {
    fn eq(&self, other: &Self) -> bool {
        self.given == other.given
    }
}

impl<'de, G: Prepare + Deserialize<'de>> Deserialize<'de> for Prepared<G> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        G::deserialize(deserializer).map(Self::from)
    }
}

impl<G: Prepare + Serialize> Serialize for Prepared<G> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.given.serialize(serializer)
    }
}

impl<G: Prepare + JsonSchema> JsonSchema for Prepared<G> {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        G::schema_name()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        G::json_schema(generator)
    }
}
