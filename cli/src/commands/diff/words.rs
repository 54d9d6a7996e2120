//! Describes a difference in words.

use serde_json::Value;

use super::compare::{Change, Difference};

/// Maximum number of characters of a value in a line.
const MAX_CHARS: usize = 60;

/// Formats a difference as a line.
pub(super) fn line(difference: &Difference<'_>) -> String {
    let Difference { path, change } = difference;
    match change {
        Change::Added(value) => match name(value) {
            Some(name) => format!("{path}: added ({name})"),
            None => format!("{path}: added, {}", short(value)),
        },
        Change::Removed(value) => match name(value) {
            Some(name) => format!("{path}: removed ({name})"),
            None => format!("{path}: removed, was {}", short(value)),
        },
        Change::Changed(from, to) => format!("{path}: {} became {}", short(from), short(to)),
    }
}

/// The material and the kind of an object, or the kind of a shape, a material or a light.
fn name(value: &Value) -> Option<String> {
    let map = value.as_object()?;
    if let Some(shape) = map.get("shape") {
        let kind = kind(shape)?;
        let material = map.get("material").and_then(Value::as_str);
        return Some(material.map_or_else(|| kind.to_owned(), |material| format!("{material} {kind}")));
    }
    kind(value).map(str::to_owned)
}

/// The kind of a shape, without the transforms around it.
fn kind(mut value: &Value) -> Option<&str> {
    loop {
        let map = value.as_object().filter(|map| map.len() == 1)?;
        let (kind, inside) = map.iter().next()?;
        match inside.get("child").filter(|child| child.as_object().is_some_and(|child| child.len() == 1)) {
            Some(child) => value = child,
            None => return Some(kind),
        }
    }
}

fn short(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() <= MAX_CHARS {
        return text;
    }
    text.chars().take(MAX_CHARS).chain(['…']).collect()
}
