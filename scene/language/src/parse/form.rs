//! Deserializes a text as a type: the first serde error, reworded for users.

use std::fmt::Write as _;

use serde::de::DeserializeOwned;
use serde_path_to_error::{Path, Segment};

use super::strict::Strict;
use super::{messages, suggest};
use crate::error::ValidationError;
use crate::json_scan;
use crate::json_text;
use crate::names::nearest_name;

/// An error of the form of a text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct FormError {
    /// JSON pointer in the text.
    pub(super) pointer: String,
    /// Whether the error is at the key, not at the value.
    pub(super) is_key: bool,
    /// Kind of error.
    pub(super) kind: FormErrorKind,
    /// The problem and its fix.
    pub(super) message: String,
}

impl FormError {
    /// The error with its position in the text.
    pub(super) fn placed(self, text: &str) -> ValidationError {
        let place = if self.is_key { ValidationError::at_member } else { ValidationError::at_value };
        place(text, self.pointer, self.message)
    }
}

/// Information that a repair needs about an error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum FormErrorKind {
    /// An unknown key, and the key that was probably meant.
    UnknownKey(Option<String>),
    /// An unknown name, and the name that was probably meant.
    UnknownName(Option<String>),
    /// A missing key.
    MissingKey(String),
    /// An invalid value.
    Value,
}

/// Deserializes valid JSON; fails with the first error of its form. A list in place of an object is one.
pub(super) fn read<T: DeserializeOwned>(text: &str) -> Result<T, FormError> {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    deserializer.disable_recursion_limit();
    serde_path_to_error::deserialize(Strict(&mut deserializer))
        .map_err(|error| fault(text, pointer(error.path()), strip_position(&error.inner().to_string())))
}

/// The error of serde at a pointer.
fn fault(text: &str, pointer: String, message: String) -> FormError {
    if let Some((name, known)) = suggest::unknown(&message, "unknown variant `") {
        let meant = nearest_name(name, &known).map(str::to_owned);
        let message = suggest::unknown_name(name, &known);
        let (pointer, is_key) = place_of_name(text, pointer, name);
        return FormError { pointer, is_key, kind: FormErrorKind::UnknownName(meant), message };
    }
    if let Some((key, known)) = suggest::unknown(&message, "unknown field `") {
        let meant = nearest_name(key, &known).map(str::to_owned);
        let message = suggest::unknown_key(key, &known);
        // A visitor that looks at the first key to decide on a type loses the key's place.
        let inside = format!("{pointer}/{}", json_text::escape(key));
        let is_inside = last(&pointer) != json_text::escape(key) && json_scan::locate_member(text, &inside).is_some();
        let pointer = if is_inside { inside } else { pointer };
        let is_key = json_scan::locate_member(text, &pointer).is_some();
        return FormError { pointer, is_key, kind: FormErrorKind::UnknownKey(meant), message };
    }
    if let Some(key) = message.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`')) {
        let kind = FormErrorKind::MissingKey(key.to_owned());
        let message = format!("lacks the key `{key}`: add it");
        return FormError { pointer, is_key: false, kind, message };
    }
    let (pointer, message) = messages::rewrite_serde_error(text, pointer, message);
    FormError { pointer, is_key: false, kind: FormErrorKind::Value, message }
}

/// Position of an unknown name: as a key, or as a value.
fn place_of_name(text: &str, pointer: String, name: &str) -> (String, bool) {
    let key = format!("{pointer}/{}", json_text::escape(name));
    if json_scan::locate_member(text, &key).is_some() {
        return (key, true);
    }
    if last(&pointer) == json_text::escape(name) && json_scan::locate_member(text, &pointer).is_some() {
        return (pointer, true);
    }
    // If the path ends in the choice itself, the text has no such position.
    let place = if json_scan::locate_value(text, &pointer).is_some() { &pointer } else { parent(&pointer) };
    (place.to_owned(), false)
}

/// A message without the line and column that serde appends.
pub(super) fn strip_position(message: &str) -> String {
    message.rsplit_once(" at line ").map_or(message, |(message, _)| message).to_owned()
}

pub(super) fn parent(pointer: &str) -> &str {
    pointer.rsplit_once('/').map_or("", |(parent, _)| parent)
}

pub(super) fn last(pointer: &str) -> &str {
    pointer.rsplit_once('/').map_or("", |(_, last)| last)
}

fn pointer(path: &Path) -> String {
    path.iter().fold(String::new(), |mut pointer, segment| {
        match segment {
            Segment::Seq { index } => write!(pointer, "/{index}"),
            Segment::Map { key } | Segment::Enum { variant: key } => write!(pointer, "/{}", json_text::escape(key)),
            Segment::Unknown => Ok(()),
        }
        .expect("a String takes all that is written");
        pointer
    })
}
