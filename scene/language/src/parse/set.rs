//! Sets values in the text of a job from outside, so that a job is a template. The rest of the text, comments too, keeps
//! its bytes.

use super::expand::scan::{end_of, member, members, skip_space, string};
use super::plain_json;
use crate::names::nearest_name;

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
    let plain = plain_json(text);
    if let Err(error) = serde_json::from_str::<serde::de::IgnoredAny>(&plain) {
        let fault = super::syntax::fault(&plain, &error);
        return Err(format!("cannot be set, because the job is not JSON: {fault}"));
    }
    if path.contains(['/', '[']) || path.split('.').any(str::is_empty) {
        return Err(format!(
            "\"{path}\" is no path: write keys and indices with dots between, such as scene.objects.0.shape"
        ));
    }
    let is_json = serde_json::from_str::<serde::de::IgnoredAny>(value).is_ok();
    let value = if is_json { value.to_owned() } else { serde_json::Value::from(value).to_string() };
    let path = if path.starts_with("numbers.") { format!("scene.{path}") } else { path.to_owned() };
    let mut at = skip_space(&plain, 0);
    let keys: Vec<&str> = path.split('.').collect();
    for (depth, key) in keys.iter().enumerate() {
        let here = || if depth == 0 { "the job".to_owned() } else { keys[..depth].join(".") };
        let found = match plain.as_bytes().get(at) {
            Some(b'{') => member(&plain, at, key),
            Some(b'[') => key.parse().ok().and_then(|index| entry(&plain, at, index)),
            _ => None,
        };
        at = match found {
            Some(found) => found,
            None if depth + 1 == keys.len()
                && plain.as_bytes()[at] == b'{'
                && keys[..depth] != ["scene", "numbers"] =>
            {
                let is_empty = members(&plain, at).next().is_none();
                let comma = if is_empty { "" } else { ", " };
                let added = format!("{}: {value}{comma}", serde_json::Value::from(*key));
                return Ok(format!("{}{added}{}", &text[..=at], &text[at + 1..]));
            }
            None => {
                let known: Vec<String> = members(&plain, at).map(|(known, _)| string(&plain, &known)).collect();
                let names: Vec<&str> = known.iter().map(String::as_str).collect();
                let meant = nearest_name(key, &names).map(|meant| format!("; did you mean {meant}?"));
                let has = match plain.as_bytes()[at] {
                    b'{' if names.is_empty() => ": it is empty, so use another path".to_owned(),
                    b'{' => format!(", only {}", names.join(", ")),
                    b'[' if entry(&plain, at, 0).is_none() => ": it is an empty list, so use another path".to_owned(),
                    b'[' => ": it is a list, so use an index from 0".to_owned(),
                    _ => format!(": it is one value, so set {} itself", here()),
                };
                return Err(format!("{} has no {key}{}", here(), meant.unwrap_or(has)));
            }
        };
    }
    let end = end_of(&plain, at);
    Ok(format!("{}{value}{}", &text[..at], &text[end..]))
}

/// Position of an entry of the list that begins at a position.
fn entry(text: &str, list: usize, index: usize) -> Option<usize> {
    let mut at = skip_space(text, list + 1);
    for _ in 0..index {
        let end = end_of(text, at);
        at = super::expand::scan::skip_separator(text, end.max(at + 1));
        if text.as_bytes().get(at).is_none_or(|byte| *byte == b']') {
            return None;
        }
    }
    text.as_bytes().get(at).is_some_and(|byte| *byte != b']').then_some(at)
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
