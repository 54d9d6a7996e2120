//! Lengths of values on one line, in characters.

use super::tree::{Comment, Entry, Value};

/// Length of a value on one line; none if it needs several.
pub(super) fn of_value(text: &str, value: &Value) -> Option<usize> {
    match value {
        Value::Scalar(range) => Some(text[range.clone()].chars().count()),
        Value::Container(container) => container.flat_chars,
    }
}

/// Length of an entry on one line, with its comments; none if it needs several.
pub(super) fn of_entry(text: &str, entry: &Entry) -> Option<usize> {
    let key = entry.key.as_ref().map_or(0, |key| text[key.clone()].chars().count() + 2);
    let comments = match entry.comments() {
        None => 0,
        Some(comments) => of_comments(text, &comments.leading)?
            .checked_add(of_comments(text, &comments.inside)?)?
            .checked_add(of_comments(text, &comments.trailing)?)?,
    };
    Some(key + comments + of_value(text, &entry.value)?)
}

/// Length of comments on one line, each with a space; none if one of them needs a line for itself.
pub(super) fn of_comments(text: &str, comments: &[Comment]) -> Option<usize> {
    comments.iter().try_fold(0, |chars, comment| {
        comment.is_block().then(|| chars + text[comment.range.clone()].chars().count() + 1)
    })
}
