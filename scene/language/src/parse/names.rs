//! Names in error messages: names of objects, and the names that were probably meant.

use std::sync::LazyLock;

use crate::backgrounds::Background;
use crate::camera::Projection;
use crate::error::ValidationError;
use crate::json::{Tree, Value};
use crate::kinds::Kind;
use crate::lights::Light;
use crate::limits::MAX_NAME_CHARS;
use crate::materials::{Material, Texture};
use crate::nodes::Node;
use crate::profiles::Profile;

/// The known name that was probably meant.
pub(super) fn nearest_name<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    static KINDS: LazyLock<Vec<Kind>> = LazyLock::new(|| families().concat());
    crate::names::nearest_name(name, known, &KINDS)
}

/// The kinds of each family.
fn families() -> [Vec<Kind>; 7] {
    [
        Node::kinds(),
        Profile::kinds(),
        Material::kinds(),
        Texture::kinds(),
        Light::kinds(),
        Background::kinds(),
        Projection::kinds(),
    ]
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_alias_suggests_its_kind() {
        for family in families() {
            let known: Vec<&str> = family.iter().map(|kind| kind.name.as_str()).collect();
            for kind in &family {
                for alias in kind.aliases {
                    assert_eq!(nearest_name(alias, &known), Some(kind.name.as_str()), "{alias}");
                }
            }
        }
    }
}
