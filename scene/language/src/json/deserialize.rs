//! Deserializes types of serde from a value of a tree.
//!
//! Numbers, strings and words are read by `serde_json`, so that they and their errors are the same as for any JSON. A list in
//! place of an object is an error: serde would take its entries in the order of the fields, the schema does not.

use serde::de::value::StrDeserializer;
use serde::de::{
    DeserializeSeed, Deserializer, EnumAccess, Error as _, MapAccess, SeqAccess, Unexpected, VariantAccess, Visitor,
};
use serde_json::Error;

use super::value::{Kind, Value};

/// Message for a list in place of an object.
const NO_LIST: &str = "must be an object, not a list: write each value after its key";
/// Messages that `serde_json` has for a list and an object with more than was asked for, and for what is no choice.
/// `messages.rs` replaces them.
pub(crate) const MORE_ENTRIES: &str = "trailing characters";
pub(crate) const MORE_MEMBERS: &str = "trailing comma";
pub(crate) const NO_CHOICE: &str = "expected value";

impl<'de> Value<'de> {
    fn list<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let mut entries = self.entries();
        let value = visitor.visit_seq(Entries(&mut entries))?;
        if entries.next().is_some() { Err(Error::custom(MORE_ENTRIES)) } else { Ok(value) }
    }

    fn object<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let mut members = self.members();
        let value = visitor.visit_map(Members { members: &mut members, value: None })?;
        if members.next().is_some() { Err(Error::custom(MORE_MEMBERS)) } else { Ok(value) }
    }
}

macro_rules! deserialize_scalars {
    ($($method:ident)*) => { $(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            match self.kind() {
                Kind::Object => Err(Error::invalid_type(Unexpected::Map, &visitor)),
                Kind::Array => Err(Error::invalid_type(Unexpected::Seq, &visitor)),
                Kind::String | Kind::Number | Kind::Word => {
                    serde_json::Deserializer::from_str(self.text()).$method(visitor)
                }
            }
        }
    )* };
}

impl<'de> Deserializer<'de> for Value<'de> {
    type Error = Error;

    deserialize_scalars! {
        deserialize_bool deserialize_i8 deserialize_i16 deserialize_i32 deserialize_i64 deserialize_i128
        deserialize_u8 deserialize_u16 deserialize_u32 deserialize_u64 deserialize_u128 deserialize_f32 deserialize_f64
        deserialize_char deserialize_str deserialize_string deserialize_bytes deserialize_byte_buf deserialize_unit
        deserialize_identifier
    }

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        match self.kind() {
            Kind::Object => self.object(visitor),
            Kind::Array => self.list(visitor),
            Kind::String | Kind::Number | Kind::Word => {
                serde_json::Deserializer::from_str(self.text()).deserialize_any(visitor)
            }
        }
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_unit()
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        if self.text() == "null" { visitor.visit_none() } else { visitor.visit_some(self) }
    }

    fn deserialize_unit_struct<V: Visitor<'de>>(self, _: &'static str, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_unit(visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(self, _: &'static str, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        if self.kind() == Kind::Object {
            return Err(Error::invalid_type(Unexpected::Map, &visitor));
        }
        if self.kind() == Kind::Array {
            return self.list(visitor);
        }
        serde_json::Deserializer::from_str(self.text()).deserialize_seq(visitor)
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: usize,
        visitor: V,
    ) -> Result<V::Value, Error> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        if self.kind() == Kind::Array {
            return Err(Error::invalid_type(Unexpected::Seq, &visitor));
        }
        if self.kind() == Kind::Object {
            return self.object(visitor);
        }
        serde_json::Deserializer::from_str(self.text()).deserialize_map(visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        if self.kind() == Kind::Array { Err(Error::custom(NO_LIST)) } else { self.deserialize_map(visitor) }
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        if self.kind() == Kind::String {
            return serde_json::Deserializer::from_str(self.text()).deserialize_enum(name, variants, visitor);
        }
        let mut members = self.members();
        let Some((key, value)) = members.next() else { return Err(Error::custom(NO_CHOICE)) };
        let choice = visitor.visit_enum(Choice { key, value })?;
        if members.next().is_some() { Err(Error::custom(NO_CHOICE)) } else { Ok(choice) }
    }
}

/// Entries of a list that are left.
struct Entries<'i, I>(&'i mut I);

impl<'de, I: Iterator<Item = Value<'de>>> SeqAccess<'de> for Entries<'_, I> {
    type Error = Error;

    fn next_element_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, Error> {
        self.0.next().map(|entry| seed.deserialize(entry)).transpose()
    }
}

/// Members of an object that are left.
struct Members<'i, 'de, I> {
    members: &'i mut I,
    /// The value of the last key.
    value: Option<Value<'de>>,
}

impl<'de, I: Iterator<Item = (Value<'de>, Value<'de>)>> MapAccess<'de> for Members<'_, 'de, I> {
    type Error = Error;

    fn next_key_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, Error> {
        let Some((key, value)) = self.members.next() else { return Ok(None) };
        self.value = Some(value);
        seed.deserialize(key).map(Some)
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, Error> {
        match self.value.take() {
            Some(value) => seed.deserialize(value),
            None => seed.deserialize(StrDeserializer::new("")),
        }
    }
}

/// An object of one member, whose key is the name of its kind.
struct Choice<'de> {
    key: Value<'de>,
    value: Value<'de>,
}

impl<'de> EnumAccess<'de> for Choice<'de> {
    type Error = Error;
    type Variant = Value<'de>;

    fn variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<(S::Value, Value<'de>), Error> {
        Ok((seed.deserialize(self.key)?, self.value))
    }
}

impl<'de> VariantAccess<'de> for Value<'de> {
    type Error = Error;

    fn unit_variant(self) -> Result<(), Error> {
        serde::Deserialize::deserialize(self)
    }

    fn newtype_variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<S::Value, Error> {
        seed.deserialize(self)
    }

    fn tuple_variant<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_seq(visitor)
    }

    fn struct_variant<V: Visitor<'de>>(self, fields: &'static [&'static str], visitor: V) -> Result<V::Value, Error> {
        self.deserialize_struct("", fields, visitor)
    }
}
