//! JSON merge patches (RFC 7396) of a job's file. Members that a patch does not name keep their exact bytes, so
//! that no number is parsed and rewritten.

use std::collections::BTreeMap;

use serde_json::value::RawValue;

use crate::http::body;
use crate::http::error::ApiError;

/// Maximum nesting of a patch: each level of the file above a change is parsed once.
const MAX_DEPTH: usize = 64;

type Members = BTreeMap<String, Box<RawValue>>;

/// Text of a valid file with a patch applied.
pub(in crate::http) fn apply(file: &str, patch: &[u8]) -> Result<String, ApiError> {
    let patch: Box<RawValue> = serde_json::from_slice(patch).map_err(|error| body::not_json(&error))?;
    if members(&patch).is_none() {
        return Err(body::invalid_body(
            "",
            "the patch is not an object: send an object with the members to change".to_owned(),
        ));
    }
    let file: Option<Box<RawValue>> = serde_json::from_str(file).ok();
    merged(file, &patch, 0).map(|merged| Box::<str>::from(merged).into_string())
}

/// The members of an object; `None` for anything else.
fn members(value: &RawValue) -> Option<Members> {
    value.get().starts_with('{').then(|| serde_json::from_str(value.get()).ok()).flatten()
}

/// The target is taken, so that no level of it stays in memory while those in it are merged.
fn merged(target: Option<Box<RawValue>>, patch: &RawValue, depth: usize) -> Result<Box<RawValue>, ApiError> {
    let Some(changes) = members(patch) else { return Ok(patch.to_owned()) };
    if depth == MAX_DEPTH {
        return Err(body::invalid_body(
            "",
            format!("nested deeper than {MAX_DEPTH} objects: submit a new job file instead"),
        ));
    }
    let mut target = target.and_then(|target| members(&target)).unwrap_or_default();
    for (key, change) in changes {
        if change.get() == "null" {
            target.remove(&key);
        } else {
            let before = target.remove(&key);
            target.insert(key, merged(before, &change, depth + 1)?);
        }
    }
    serde_json::value::to_raw_value(&target).map_err(|error| ApiError::Internal(Box::new(error)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn patched(file: &str, patch: &str) -> serde_json::Value {
        let text = apply(file, patch.as_bytes()).unwrap_or_else(|_| panic!("{patch} is a patch"));
        serde_json::from_str(&text).expect("JSON")
    }

    #[test]
    fn patches_are_applied_according_to_rfc_7396() {
        // Cases of RFC 7396, appendix A, whose patch is an object.
        for (file, patch, wanted) in [
            (r#"{"a":"b"}"#, r#"{"a":"c"}"#, r#"{"a":"c"}"#),
            (r#"{"a":"b"}"#, r#"{"b":"c"}"#, r#"{"a":"b","b":"c"}"#),
            (r#"{"a":"b"}"#, r#"{"a":null}"#, "{}"),
            (r#"{"a":"b","b":"c"}"#, r#"{"a":null}"#, r#"{"b":"c"}"#),
            (r#"{"a":["b"]}"#, r#"{"a":"c"}"#, r#"{"a":"c"}"#),
            (r#"{"a":"c"}"#, r#"{"a":["b"]}"#, r#"{"a":["b"]}"#),
            (r#"{"a":{"b":"c"}}"#, r#"{"a":{"b":"d","c":null}}"#, r#"{"a":{"b":"d"}}"#),
            (r#"{"a":[{"b":"c"}]}"#, r#"{"a":[1]}"#, r#"{"a":[1]}"#),
            (r#"["a","b"]"#, r#"{"a":"b"}"#, r#"{"a":"b"}"#),
            (r#"{"e":null}"#, r#"{"a":1}"#, r#"{"e":null,"a":1}"#),
            (r"[1,2]", r#"{"a":"b","c":null}"#, r#"{"a":"b"}"#),
            ("{}", r#"{"a":{"bb":{"ccc":null}}}"#, r#"{"a":{"bb":{}}}"#),
        ] {
            let wanted: serde_json::Value = serde_json::from_str(wanted).expect("JSON");
            assert_eq!(patched(file, patch), wanted, "{file} with {patch}");
        }
    }

    #[test]
    fn unchanged_numbers_keep_their_digits() {
        let text = apply(r#"{ "a": { "x": 0.1000000000000000055511151231, "y": 1 } }"#, br#"{"a":{"y":2.50}}"#);
        let text = text.unwrap_or_else(|_| panic!("a patch"));
        assert_eq!(text, r#"{"a":{"x":0.1000000000000000055511151231,"y":2.50}}"#);
    }

    #[test]
    fn invalid_patches_are_rejected() {
        let deep = format!("{}1{}", r#"{"a":"#.repeat(MAX_DEPTH + 1), "}".repeat(MAX_DEPTH + 1));
        for patch in ["[1]", "7", "null", "{", "", &deep] {
            assert!(apply("{}", patch.as_bytes()).is_err(), "{patch}");
        }
        let fits = format!("{}1{}", r#"{"a":"#.repeat(MAX_DEPTH), "}".repeat(MAX_DEPTH));
        assert!(apply("{}", fits.as_bytes()).is_ok());
    }
}
