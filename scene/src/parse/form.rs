//! Whether a text has the form of a type: serde's first complaint, in our words.

use std::fmt::Write as _;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_path_to_error::{Path, Segment};

use super::{list_form, messages, suggest};
use crate::error::ValidationError;
use crate::json_scan;

/// A fault of the form of a text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct FormError {
    /// JSON pointer in the text.
    pub(super) pointer: String,
    /// Whether it is of the key there, not of the value.
    pub(super) is_key: bool,
    /// What is wrong.
    pub(super) kind: FormErrorKind,
    /// What is wrong and what would be right, in words.
    pub(super) message: String,
}

impl FormError {
    /// The fault at its place in the text.
    pub(super) fn placed(self, text: &str) -> ValidationError {
        let place = if self.is_key { ValidationError::at_member } else { ValidationError::at_value };
        place(text, self.pointer, self.message)
    }
}

/// What a repair must know of a fault.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum FormErrorKind {
    /// A key that its object does not take, and the one that was probably meant.
    UnknownKey(Option<String>),
    /// A name that is none of those there are, and the one that was probably meant.
    UnknownName(Option<String>),
    /// An object lacks this key.
    MissingKey(String),
    /// A value that does not fit.
    Value,
}

/// Reads sound JSON; the first fault of its form otherwise.
pub(super) fn read<T: DeserializeOwned>(text: &str) -> Result<T, FormError> {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    deserializer.disable_recursion_limit();
    serde_path_to_error::deserialize(&mut deserializer)
        .map_err(|error| fault(text, pointer(error.path()), strip_position(&error.inner().to_string())))
}

/// The same, and no list is taken for an object.
pub(super) fn read_strictly<T: DeserializeOwned + Serialize>(text: &str) -> Result<T, FormError> {
    let value = read(text)?;
    match list_form::list_instead_of_object(text, &value) {
        Some(pointer) => {
            let message = "must be an object, not a list: write each value behind its key".to_owned();
            Err(FormError { pointer, is_key: false, kind: FormErrorKind::Value, message })
        }
        None => Ok(value),
    }
}

/// What serde says of a text, at the pointer where it says it.
fn fault(text: &str, pointer: String, message: String) -> FormError {
    if let Some((name, known)) = suggest::unknown(&message, "unknown variant `") {
        let meant = suggest::nearest(name, &known).map(str::to_owned);
        let message = suggest::unknown_name(name, &known, &pointer);
        let (pointer, is_key) = place_of_name(text, pointer, name);
        return FormError { pointer, is_key, kind: FormErrorKind::UnknownName(meant), message };
    }
    if let Some((key, known)) = suggest::unknown(&message, "unknown field `") {
        let meant = suggest::nearest(key, &known).map(str::to_owned);
        let message = suggest::unknown_key(key, &known);
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

/// Where a name that there is not stands: as a key, or as a value.
fn place_of_name(text: &str, pointer: String, name: &str) -> (String, bool) {
    let key = format!("{pointer}/{}", json_scan::escape(name));
    if json_scan::locate_member(text, &key).is_some() {
        return (key, true);
    }
    if last(&pointer) == json_scan::escape(name) && json_scan::locate_member(text, &pointer).is_some() {
        return (pointer, true);
    }
    // Where the path ends in the choice itself, the text has no such place.
    let place = if json_scan::locate_value(text, &pointer).is_some() { &pointer } else { parent(&pointer) };
    (place.to_owned(), false)
}

/// A message without the line and column that serde puts behind it.
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
            Segment::Map { key } | Segment::Enum { variant: key } => write!(pointer, "/{}", json_scan::escape(key)),
            Segment::Unknown => Ok(()),
        }
        .expect("a String takes all that is written");
        pointer
    })
}
