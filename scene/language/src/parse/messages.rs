//! Rewrites serde's error messages for authors of job files.

use super::form::{last, parent};
use crate::json::{Kind, MORE_ENTRIES, MORE_MEMBERS, NO_CHOICE, Tree, Value};
use crate::materials::Texture;

/// Pointer and message of an error in a tree, from serde's pointer and message.
pub(super) fn rewrite_serde_error(tree: &Tree<'_>, pointer: String, message: String) -> (String, String) {
    let place = |pointer: &str| tree.value_at(pointer);
    match message.as_str() {
        "number out of range" => (pointer, "is too large: numbers go up to 3.4e38".to_owned()),
        "invalid type: unit variant, expected newtype variant" => {
            let name = last(&pointer);
            let message = format!("needs its parameters: write {{ \"{name}\": {{ … }} }}");
            (if place(&pointer).is_some() { pointer } else { parent(&pointer).to_owned() }, message)
        }
        "invalid type: map, expected unit" => {
            let message = format!("has no parameters: write \"{}\" alone", last(&pointer));
            (parent(&pointer).to_owned(), message)
        }
        NO_CHOICE | MORE_MEMBERS | MORE_ENTRIES | "invalid type: map, expected enum" => {
            let message = place(&pointer).map_or_else(|| message.clone(), |value| shape_error(value, &message));
            (pointer, message)
        }
        _ => {
            let message = type_error(&message).or_else(|| texture_error(&message)).unwrap_or(message);
            let cure = other_node(&pointer, &message).unwrap_or_default();
            (pointer, message + cure)
        }
    }
}

/// The node that does what other programs do by a factor of `scale`.
fn other_node(pointer: &str, message: &str) -> Option<&'static str> {
    let is_factor = |node: &str| pointer.rsplit_once(node).is_some_and(|(_, rest)| !rest.contains(char::is_alphabetic));
    if is_factor("/scale/by") && message.ends_with("not a list") {
        return Some("; a factor for each axis is written in stretch");
    }
    let is_negative = message.starts_with("must be a factor") && message.contains("not -");
    (is_negative && (is_factor("/scale/by") || is_factor("/stretch/by"))).then_some("; mirror reflects a shape")
}

/// Message about a value for which serde only reports that it expected something else: an object of one key, or a list
/// with fewer entries.
fn shape_error(value: Value<'_>, message: &str) -> String {
    match (value.kind(), value.entries().count(), value.members().count()) {
        (Kind::Object, _, 0) => "is empty: write one key, the name of its kind, with its parameters inside".to_owned(),
        (Kind::Object, _, keys) => format!("has {keys} keys: keep only the one that names its kind"),
        (Kind::Array, entries, _) if message == MORE_ENTRIES && entries > 4 => {
            format!("has {entries} entries, too many: leave out the others, and write numbers with a point, as in 0.5")
        }
        (Kind::Array, entries, _) if message == MORE_ENTRIES => format!("has {entries} entries: leave out the last"),
        (Kind::Array | Kind::String | Kind::Number | Kind::Word, ..) => {
            "must be an object of one key, the name of its kind, with its parameters inside; a kind without parameters is its name in double quotes"
                .to_owned()
        }
    }
}

/// Rewrites "invalid type: string "one", expected a number" as "must be a number, not "one"".
fn type_error(message: &str) -> Option<String> {
    let (got, wanted) = message.split_once(", expected ")?;
    if let Some(length) = got.strip_prefix("invalid length ") {
        let entries = if length == "1" { "entry" } else { "entries" };
        return Some(format!("has {length} {entries}: write {}", expected_form(wanted)));
    }
    let got = got.strip_prefix("invalid type: ").or_else(|| got.strip_prefix("invalid value: "))?;
    Some(format!("must be {}, not {}", expected_form(wanted), actual_form(got)))
}

/// Message for a texture in place of a number or a color that takes none.
fn texture_error(message: &str) -> Option<String> {
    let (wanted, key) = message.split_once(", not an object with the key \"")?;
    if !Texture::is_name(key.split('"').next()?) {
        return None;
    }
    let form = if wanted.starts_with("must be a color") {
        "[red, green, blue], where a channel may be a track; a material's colors take textures"
    } else {
        "a number or a track; a material's numbers take textures"
    };
    Some(format!("takes no texture: write {form}"))
}

/// The expected form, without the names of Rust types.
fn expected_form(wanted: &str) -> String {
    if wanted.starts_with("struct ") {
        return "an object".to_owned();
    }
    if wanted.starts_with("tuple struct Point") {
        return "a list of 3 numbers".to_owned();
    }
    if let Some(length) = wanted.strip_prefix("an array of length ") {
        return format!("a list of {length} numbers");
    }
    match (wanted.strip_prefix("a tuple of size "), wanted) {
        (Some(length), _) => format!("a list of {length}"),
        (None, "f64" | "f32") => "a number".to_owned(),
        (None, "a boolean") => "true or false".to_owned(),
        (None, "a string") => "a text in double quotes".to_owned(),
        (None, "a sequence") => "a list".to_owned(),
        (None, "a map") => "an object".to_owned(),
        (None, wanted) => wanted.to_owned(),
    }
}

/// The actual form.
fn actual_form(got: &str) -> &str {
    let quoted = got.split_once('`').and_then(|(_, rest)| rest.strip_suffix('`'));
    match (quoted, got) {
        (Some(value), _) => value,
        (None, "map") => "an object",
        (None, "sequence") => "a list",
        (None, got) => got.strip_prefix("string ").unwrap_or(got),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str, pointer: &str, message: &str) -> (String, String) {
        let tree = Tree::read(text).unwrap_or_else(|error| panic!("{error:?}"));
        rewrite_serde_error(&tree, pointer.to_owned(), message.to_owned())
    }

    #[test]
    fn messages_use_json_type_names() {
        for (serde, ours) in [
            (r#"invalid type: string "one", expected a number"#, r#"must be a number, not "one""#),
            ("invalid type: integer `3`, expected struct Surface", "must be an object, not 3"),
            ("invalid type: map, expected a sequence", "must be a list, not an object"),
            (
                "invalid length 2, expected tuple struct Point with 3 elements",
                "has 2 entries: write a list of 3 numbers",
            ),
            ("missing field `by`", "missing field `by`"),
        ] {
            assert_eq!(of("{}", "", serde).1, ours);
        }
    }

    #[test]
    fn wrong_list_lengths_are_reported_with_their_count() {
        let counted = |text: &str, serde: &str| of(text, "/a", serde).1;
        assert!(counted(r#"{"a": {}}"#, "expected value").contains("is empty"));
        assert!(counted(r#"{"a": {"b": 1, "c": 2}}"#, "trailing comma").contains("has 2 keys"));
        assert!(counted(r#"{"a": [1, 2, 3, 4]}"#, "trailing characters").contains("has 4 entries"));
        assert!(counted(r#"{"a": 7}"#, "expected value").contains("one key"));
    }

    #[test]
    fn a_name_without_parameters_has_its_position() {
        let serde = "invalid type: unit variant, expected newtype variant";
        let (pointer, message) = of(r#"{"shape": "sphere"}"#, "/shape/sphere", serde);
        assert_eq!(pointer, "/shape");
        assert!(message.contains(r#"{ "sphere": { … } }"#), "{message}");
    }
}
