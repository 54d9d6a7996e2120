//! Deserializes a tree as a type: the first serde error, reworded for users.

use std::fmt::Write as _;

use serde::de::DeserializeOwned;
use serde_path_to_error::{Path, Segment};

use super::names::nearest_name;
use super::{messages, suggest};
use crate::error::Fault;
use crate::json::Tree;
use crate::json_text;

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
    /// The error with its position in the tree.
    pub(super) fn placed(self, tree: &Tree<'_>) -> Fault {
        if self.is_key {
            return Fault::at_key(tree, self.pointer, self.message);
        }
        Fault::at_value(tree, self.pointer, self.message)
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

/// Deserializes a tree; fails with the first error of its form. A list in place of an object is one.
pub(super) fn read<T: DeserializeOwned>(tree: &Tree<'_>) -> Result<T, FormError> {
    serde_path_to_error::deserialize(tree.root())
        .map_err(|error| fault(tree, pointer(error.path()), message(error.inner())))
}

/// The error of serde at a pointer.
fn fault(tree: &Tree<'_>, pointer: String, message: String) -> FormError {
    if let Some((name, known)) = suggest::unknown(&message, "unknown variant `") {
        let meant = nearest_name(name, &known).map(str::to_owned);
        let message = suggest::unknown_name(name, &known);
        let (pointer, is_key) = place_of_name(tree, pointer, name);
        return FormError { pointer, is_key, kind: FormErrorKind::UnknownName(meant), message };
    }
    if let Some((key, known)) = suggest::unknown(&message, "unknown field `") {
        let meant = nearest_name(key, &known).map(str::to_owned);
        let message = suggest::unknown_key(key, &known);
        // A visitor that looks at the first key to decide on a type loses the key's place.
        let inside = format!("{pointer}/{}", json_text::escape(key));
        let is_inside = last(&pointer) != json_text::escape(key) && tree.key_at(&inside).is_some();
        let pointer = if is_inside { inside } else { pointer };
        let is_key = tree.key_at(&pointer).is_some();
        return FormError { pointer, is_key, kind: FormErrorKind::UnknownKey(meant), message };
    }
    if let Some(key) = message.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`')) {
        let kind = FormErrorKind::MissingKey(key.to_owned());
        let message = format!("lacks the key `{key}`: add it");
        return FormError { pointer, is_key: false, kind, message };
    }
    let (pointer, message) = messages::rewrite_serde_error(tree, pointer, message);
    FormError { pointer, is_key: false, kind: FormErrorKind::Value, message }
}

/// Position of an unknown name: as a key, or as a value.
fn place_of_name(tree: &Tree<'_>, pointer: String, name: &str) -> (String, bool) {
    let key = format!("{pointer}/{}", json_text::escape(name));
    if tree.key_at(&key).is_some() {
        return (key, true);
    }
    if last(&pointer) == json_text::escape(name) && tree.key_at(&pointer).is_some() {
        return (pointer, true);
    }
    // If the path ends in the choice itself, the text has no such position.
    let place = if tree.value_at(&pointer).is_some() { &pointer } else { parent(&pointer) };
    (place.to_owned(), false)
}

/// The message of an error, without the line and column that serde appends: they are of a number or a string alone.
pub(super) fn message(error: &serde_json::Error) -> String {
    let message = error.to_string();
    let position = message.rfind(" at line ").filter(|_| error.line() > 0);
    message[..position.unwrap_or(message.len())].to_owned()
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
