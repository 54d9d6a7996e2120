//! Names of objects in error messages.

use crate::error::ValidationError;
use crate::json::{Tree, Value};
use crate::limits::MAX_NAME_CHARS;

/// Error in the name of an object, if there is one.
pub(super) fn object_name_error(name: &str) -> Option<String> {
    if name.is_empty() {
        return Some("is empty: give the object a name, or leave \"name\" out".to_owned());
    }
    if name.chars().any(char::is_control) {
        return Some("has a line break or another control character: use letters, digits and signs".to_owned());
    }
    (name.chars().count() > MAX_NAME_CHARS).then(|| format!("is longer than {MAX_NAME_CHARS} characters"))
}

/// Adds the name of the object that each error is in, if the text gives the object a name.
pub(super) fn add_object_names(tree: &Tree<'_>, mut errors: Vec<ValidationError>) -> Vec<ValidationError> {
    for error in &mut errors {
        let name = name_pointer(&error.pointer).and_then(|pointer| tree.value_at(&pointer));
        let name = name.map(Value::string).unwrap_or_default();
        if object_name_error(&name).is_none() {
            error.message = format!("{} (in object \"{name}\")", error.message);
        }
    }
    errors
}

/// JSON pointer to the name of the object that a pointer leads into.
fn name_pointer(pointer: &str) -> Option<String> {
    let index = pointer.strip_prefix("/scene/objects/")?.split('/').next()?;
    Some(format!("/scene/objects/{index}/name"))
}
