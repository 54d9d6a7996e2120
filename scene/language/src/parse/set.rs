//! Sets values in the text of a job from outside, so that a job is a template. The rest of the text, comments too, keeps
//! its bytes.

use super::names::nearest_name;
use super::syntax;
use crate::json::{Kind, Tree, Value};

/// Maximum length of a value that is set.
const MAX_VALUE_BYTES: usize = 4_096;

/// The text of a job in which the value at `path` is `value`.
///
/// A path is a list of keys and indices with dots between, from the job: `image.samples`, `scene.camera.position.0`; the
/// scene's numbers are `numbers.NAME`. The value is JSON; anything else is a text, such as a formula for a number with a
/// name. A key that is not there is added, except among the numbers: one that no formula uses would be a mistake.
///
/// # Errors
/// Fails with a message if there is no such place in the job, or if the text is not JSON.
pub fn set_value(text: &str, path: &str, value: &str) -> Result<String, String> {
    if path.len() + value.len() > MAX_VALUE_BYTES {
        return Err(format!("is longer than {MAX_VALUE_BYTES} bytes: change the job file instead"));
    }
    let tree = Tree::read(text)
        .map_err(|_| format!("cannot be set, because the job is not JSON: {}", syntax::explain(text)))?;
    if path.contains(['/', '[']) || path.split('.').any(str::is_empty) {
        return Err(format!(
            "\"{path}\" is no path: write keys and indices with dots between, such as scene.objects.0.shape"
        ));
    }
    let is_json = serde_json::from_str::<serde::de::IgnoredAny>(value).is_ok();
    let value = if is_json { value.to_owned() } else { serde_json::Value::from(value).to_string() };
    let path = if path.starts_with("numbers.") { format!("scene.{path}") } else { path.to_owned() };
    let mut at = tree.root();
    let keys: Vec<&str> = path.split('.').collect();
    for (depth, key) in keys.iter().enumerate() {
        let found = match at.kind() {
            Kind::Array => key.parse().ok().and_then(|index| at.entries().nth(index)),
            Kind::Object | Kind::String | Kind::Number | Kind::Word => at.get(key),
        };
        at = match found {
            Some(found) => found,
            None if depth + 1 == keys.len() && at.kind() == Kind::Object && keys[..depth] != ["scene", "numbers"] => {
                let comma = if at.members().next().is_none() { "" } else { ", " };
                let added = format!("{}: {value}{comma}", serde_json::Value::from(*key));
                let inside = at.start() + 1;
                return Ok(format!("{}{added}{}", &text[..inside], &text[inside..]));
            }
            None => {
                let here = if depth == 0 { "the job".to_owned() } else { keys[..depth].join(".") };
                return Err(format!("{here} has no {key}{}", instead(at, &here, key)));
            }
        };
    }
    Ok(format!("{}{value}{}", &text[..at.start()], &text[at.end()..]))
}

/// The right text instead of a key that a value does not have.
fn instead(value: Value<'_>, here: &str, key: &str) -> String {
    let known: Vec<_> = value.members().map(|(known, _)| known.string()).collect();
    let names: Vec<&str> = known.iter().map(AsRef::as_ref).collect();
    if let Some(meant) = nearest_name(key, &names) {
        return format!("; did you mean {meant}?");
    }
    match value.kind() {
        Kind::Object if names.is_empty() => ": it is empty, so use another path".to_owned(),
        Kind::Object => format!(", only {}", names.join(", ")),
        Kind::Array if value.entries().next().is_none() => ": it is an empty list, so use another path".to_owned(),
        Kind::Array => ": it is a list, so use an index from 0".to_owned(),
        Kind::String | Kind::Number | Kind::Word => format!(": it is one value, so set {here} itself"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const JOB: &str = r#"{ "scene": { "numbers": { "r": 1, /* wide */ "gap": "2 * r", }, "camera": { "position": [1, 2, 3] } }, "image": {} }"#;

    #[test]
    fn a_value_is_replaced_and_the_rest_keeps_its_bytes() {
        for (path, value, before, after) in [
            ("numbers.r", "0.3", r#""r": 1,"#, r#""r": 0.3,"#),
            ("scene.numbers.gap", "3 * r", r#""2 * r""#, r#""3 * r""#),
            ("scene.camera.position.1", "7", "[1, 2, 3]", "[1, 7, 3]"),
            ("scene.camera.position", "[0, 0, 9]", "[1, 2, 3]", "[0, 0, 9]"),
            ("image.samples", "16", r#""image": {}"#, r#""image": {"samples": 16}"#),
            ("frames", r#"{"count": 2}"#, r#"{ "scene""#, r#"{"frames": {"count": 2},  "scene""#),
        ] {
            assert_eq!(set_value(JOB, path, value).as_deref(), Ok(JOB.replacen(before, after, 1).as_str()), "{path}");
        }
    }

    #[test]
    fn a_place_that_is_not_there_is_an_error() {
        for (path, words) in [
            ("numbers.gpa", "scene.numbers has no gpa; did you mean gap?"),
            ("numbers.zzz", "scene.numbers has no zzz, only r, gap"),
            ("imgae.samples", "the job has no imgae; did you mean image?"),
            ("scene.camera.position.3", "scene.camera.position has no 3"),
            ("scene.camera.position.x", "has no x"),
            ("scene.camera.position.0.y", "has no y"),
        ] {
            assert!(
                set_value(JOB, path, "1").is_err_and(|message| message.starts_with(words) || message.contains(words)),
                "{path}"
            );
        }
        assert!(set_value("{", "a", "1").is_err_and(|message| message.contains("not JSON")));
        assert!(set_value("[]", "a", "1").is_err_and(|message| message.contains("the job has no a")));
    }
}
