//! Suggestions for unknown names, such as "did you mean `sphere`?": the nearest known name.

use serde::de::DeserializeOwned;

use super::form::{self, FormErrorKind};
use super::names::nearest_name;
use crate::json::Tree;
use crate::materials::Material;
use crate::names::MAX_COMPARED_CHARS;
use crate::nodes::Node;

/// Maximum length of a list of names in a message.
const MAX_LISTED: usize = 16;
/// The unknown name in a message of serde, and the known names; `prefix` begins the message.
pub(super) fn unknown<'a>(message: &'a str, prefix: &str) -> Option<(&'a str, Vec<&'a str>)> {
    let rest = message.strip_prefix(prefix)?;
    if let Some((name, known)) = rest.rsplit_once("`, expected ") {
        return Some((name, known.split('`').skip(1).step_by(2).collect()));
    }
    let (name, _) = rest.rsplit_once("`, there are no ")?;
    Some((name, Vec::new()))
}

/// Message for an unknown name.
pub(super) fn unknown_name(name: &str, known: &[&str]) -> String {
    let name = shortened(name);
    match nearest_name(&name, known) {
        Some(meant) => format!("there is no `{name}`: did you mean `{meant}`?"),
        None if name == "type" || name == "kind" => {
            format!("there is no `{name}`: the kind is the key itself, so write {{ \"KIND\": {{ … }} }}")
        }
        None if name.starts_with('#') && known.contains(&"color") => {
            format!("there is no `{name}`: write {{ \"color\": \"{name}\" }}")
        }
        None if known.len() > MAX_LISTED => {
            format!("there is no `{name}`: choose one of the {} in docs/nodes.md, or in `sdfarm schema`", known.len())
        }
        None => format!("there is no `{name}`: choose {}", listed(known)),
    }
}

/// Message for an unknown key of an object.
pub(super) fn unknown_key(key: &str, known: &[&str]) -> String {
    let key = shortened(key);
    match nearest_name(&key, known) {
        Some(meant) => format!("unknown key `{key}`: did you mean `{meant}`?"),
        None if known == ["material", "shape"] && is_kind::<Node>(&key) => {
            format!("unknown key `{key}`: write {{ \"shape\": {{ \"{key}\": {{ … }} }} }}")
        }
        None if known.is_empty() => format!("unknown key `{key}`: leave it out, because no keys are allowed here"),
        None => format!("unknown key `{key}`: leave it out, or choose {}", listed(known)),
    }
}

/// Message for a material name that is not defined.
pub(super) fn unknown_material(name: &str, known: &[&str]) -> String {
    if is_kind::<Material>(name) {
        return format!(
            "\"{name}\" is not in /scene/materials: write {{ \"{name}\": {{ … }} }} for a material in place"
        );
    }
    undefined(name, known, "materials", "material")
}

/// Message for a name of a shape that is not defined.
pub(super) fn unknown_shape(name: &str, known: &[&str]) -> String {
    if is_kind::<Node>(name) {
        return format!("\"{name}\" is not in /scene/shapes: write {{ \"{name}\": {{ … }} }} without `use`");
    }
    undefined(name, known, "shapes", "shape")
}

/// Whether a choice has a kind of this name.
fn is_kind<T: DeserializeOwned>(name: &str) -> bool {
    let text = format!("{{{}:{{}}}}", serde_json::Value::from(name));
    let fault = Tree::read(&text).ok().and_then(|tree| form::read::<T>(&tree).err());
    fault.is_none_or(|fault| !matches!(fault.kind, FormErrorKind::UnknownName(_)))
}

/// Message for a name that is not a key of an object of the scene.
fn undefined(name: &str, known: &[&str], object: &str, kind: &str) -> String {
    let name = shortened(name);
    let cure = match nearest_name(&name, known) {
        Some(meant) => format!("did you mean \"{meant}\"?"),
        None if known.is_empty() => format!("define it there, or write a {kind} in place"),
        None if known.len() > MAX_LISTED => {
            format!("define it there, or use one of the {} that are defined", known.len())
        }
        None => format!("choose one of {}", known.join(", ")),
    };
    format!("\"{name}\" is not in /scene/{object}: {cure}")
}

/// "`a`", "`a` or `b`", "one of `a`, `b`, `c`".
fn listed(known: &[&str]) -> String {
    let quoted: Vec<String> = known.iter().map(|name| format!("`{name}`")).collect();
    match quoted.as_slice() {
        [one, other] => format!("{one} or {other}"),
        [_, _, ..] => format!("one of {}", quoted.join(", ")),
        rest => rest.concat(),
    }
}

/// A name, shortened for a message.
fn shortened(name: &str) -> String {
    if name.chars().count() <= MAX_COMPARED_CHARS {
        return name.to_owned();
    }
    let start: String = name.chars().take(MAX_COMPARED_CHARS).collect();
    format!("{start}…")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn name_lists_of_any_length_are_parsed() {
        let of = |message| unknown(message, "unknown field `");
        assert_eq!(of("unknown field `x`, expected `a`"), Some(("x", vec!["a"])));
        assert_eq!(of("unknown field `x`, expected `a` or `b`"), Some(("x", vec!["a", "b"])));
        assert_eq!(of("unknown field `x`, expected one of `a`, `b`, `c`"), Some(("x", vec!["a", "b", "c"])));
        assert_eq!(of("unknown field `x`, there are no fields"), Some(("x", vec![])));
        assert_eq!(of("unknown field ``, expected ``, expected `a`"), Some(("`, expected `", vec!["a"])));
        assert_eq!(of("missing field `x`"), None);
    }

    #[test]
    fn long_lists_are_not_printed() {
        let names: Vec<String> = (0..99).map(|number| format!("name_{number}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let reported = unknown_name("zzz", &names);
        assert!(reported.contains("docs/nodes.md") && reported.contains("99") && reported.len() < 120, "{reported}");
        assert!(unknown_name("zzz", &names[..3]).contains("one of `name_0`, `name_1`, `name_2`"));
        assert!(unknown_key("zzz", &[]).contains("no key"));
    }
}
