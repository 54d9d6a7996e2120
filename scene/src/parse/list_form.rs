//! Detects objects written as lists: serde accepts values in the order of the fields, the schema does not.

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// JSON pointer of a list in a valid text where `value`, which was parsed from it, has an object.
pub(super) fn list_instead_of_object(text: &str, value: &impl Serialize) -> Option<String> {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    deserializer.disable_recursion_limit();
    let given = Value::deserialize(&mut deserializer).ok()?;
    let meant = serde_json::to_value(value).ok()?;
    let mut pointer = String::new();
    find_mismatch(&given, &meant, &mut pointer).then_some(pointer)
}

/// Walks both values together; returns whether there is a mismatch, at `pointer`.
fn find_mismatch(given: &Value, meant: &Value, pointer: &mut String) -> bool {
    let length = pointer.len();
    let mut inside = |step: &str, given: &Value, meant: &Value| {
        pointer.push('/');
        pointer.push_str(step);
        let found = find_mismatch(given, meant, pointer);
        if !found {
            pointer.truncate(length);
        }
        found
    };
    match (given, meant) {
        (Value::Array(_), Value::Object(_)) => true,
        (Value::Array(given), Value::Array(meant)) => {
            given.iter().zip(meant).enumerate().any(|(index, (given, meant))| inside(&index.to_string(), given, meant))
        }
        (Value::Object(given), Value::Object(meant)) => given.iter().any(|(key, given)| {
            meant.get(key).is_some_and(|meant| inside(&crate::json_scan::escape(key), given, meant))
        }),
        _ => false,
    }
}
