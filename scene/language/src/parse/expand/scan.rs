//! Finds values in a text that is valid JSON, without making a tree of it.

use std::ops::Range;

use crate::error::{LineIndex, ValidationError};
use crate::json_scan::container_end;
use crate::json_text::escape;

/// Position after white space.
pub(in super::super) fn skip_space(text: &str, mut at: usize) -> usize {
    while text.as_bytes().get(at).is_some_and(|byte| b" \t\r\n".contains(byte)) {
        at += 1;
    }
    at
}

/// Position after white space and a comma.
pub(in super::super) fn skip_separator(text: &str, at: usize) -> usize {
    let at = skip_space(text, at);
    if text.as_bytes().get(at) == Some(&b',') { skip_space(text, at + 1) } else { at }
}

/// End of the string that begins at a position.
pub(in super::super) fn string_end(text: &str, start: usize) -> usize {
    let bytes = text.as_bytes();
    let mut at = start + 1;
    while let Some(byte) = bytes.get(at) {
        match byte {
            b'"' => return at + 1,
            b'\\' => at += 2,
            _ => at += 1,
        }
    }
    bytes.len()
}

/// End of the value that begins at a position.
pub(in super::super) fn end_of(text: &str, start: usize) -> usize {
    let bytes = text.as_bytes();
    match bytes.get(start) {
        Some(b'"') => string_end(text, start),
        Some(b'{' | b'[') => container_end(bytes, start),
        _ => {
            let rest = bytes.get(start..).unwrap_or_default();
            start + rest.iter().position(|byte| b" \t\r\n,]}".contains(byte)).unwrap_or(rest.len())
        }
    }
}

/// Byte ranges of the keys, with their quotes, and of the values of the object that begins at a position; none if it is
/// no object.
pub(in super::super) fn members(text: &str, start: usize) -> impl Iterator<Item = (Range<usize>, Range<usize>)> {
    let is_object = text.as_bytes().get(start) == Some(&b'{');
    let mut at = if is_object { skip_space(text, start + 1) } else { text.len() };
    std::iter::from_fn(move || {
        if text.as_bytes().get(at) != Some(&b'"') {
            return None;
        }
        let key = at..string_end(text, at);
        let value = skip_space(text, skip_space(text, key.end) + 1);
        let value = value..end_of(text, value);
        at = skip_separator(text, value.end);
        Some((key, value))
    })
}

/// Position of the value of a key in the object that begins at a position.
pub(in super::super) fn member(text: &str, start: usize, key: &str) -> Option<usize> {
    members(text, start).find(|(found, _)| text[found.start + 1..found.end - 1] == *key).map(|(_, value)| value.start)
}

/// The text of a string, given with its quotes.
pub(in super::super) fn string(text: &str, range: &Range<usize>) -> String {
    serde_json::from_str(&text[range.clone()]).unwrap_or_default()
}

/// Byte offset in the text of an offset in a string, given with its quotes.
pub(in super::super) fn offset_in_string(text: &str, range: &Range<usize>, offset: usize) -> usize {
    let mut parsed = 0;
    let mut at = range.start + 1;
    while parsed < offset && at < range.end {
        let length = match &text.as_bytes()[at..] {
            [b'\\', b'u', ..] => 6,
            [b'\\', ..] => 2,
            _ => text[at..].chars().next().map_or(1, char::len_utf8),
        };
        parsed += string(text, &(at..at + length)).len().max(1);
        if text.as_bytes()[at] != b'\\' {
            parsed += length - 1;
        }
        at += length;
    }
    at
}

/// The string of `{ "expr": string }`, if this is the object that begins at a position.
pub(in super::super) fn formula(text: &str, start: usize) -> Option<Range<usize>> {
    // The first key decides, before the value is scanned: every object is asked.
    let key = (text.as_bytes().get(start) == Some(&b'{')).then(|| skip_space(text, start + 1))?;
    if !text[key..].starts_with("\"expr\"") {
        return None;
    }
    let mut all = members(text, start);
    let (_, value) = all.next()?;
    let is_formula = text.as_bytes()[value.start] == b'"' && all.next().is_none();
    is_formula.then_some(value)
}

/// The string of a formula, or a string alone.
pub(in super::super) fn formula_or_string(text: &str, value: &Range<usize>) -> Option<Range<usize>> {
    let is_string = text.as_bytes()[value.start] == b'"';
    if is_string { Some(value.clone()) } else { formula(text, value.start) }
}

/// Whether placements count their copies: they are an object with a count, but not along a line.
pub(in super::super) fn is_counted(text: &str, start: usize) -> bool {
    member(text, start, "count").is_some() && member(text, start, "along").is_none()
}

/// Errors at some byte offsets.
pub(in super::super) fn faults_at(text: &str, faults: &[(usize, String)]) -> Vec<ValidationError> {
    let lines = LineIndex::new(text);
    faults.iter().map(|(at, message)| lines.fault(*at, pointer_at(text, *at), message.clone())).collect()
}

/// JSON pointer of the innermost value that contains a position, or of the member whose key begins there.
pub(in super::super) fn pointer_at(text: &str, at: usize) -> String {
    let (mut pointer, mut value) = (String::new(), skip_space(text, 0));
    'deeper: loop {
        match text.as_bytes().get(value) {
            Some(b'{') => {
                for (key, inside) in members(text, value) {
                    if key.start <= at && at < inside.end {
                        pointer.push('/');
                        pointer.push_str(&escape(&string(text, &key)));
                        // At a key, and at a value itself, it is this member.
                        if at <= inside.start {
                            return pointer;
                        }
                        value = inside.start;
                        continue 'deeper;
                    }
                }
                return pointer;
            }
            Some(b'[') => {
                let mut entry = skip_space(text, value + 1);
                for index in 0_usize.. {
                    if text.as_bytes().get(entry).is_none_or(|byte| *byte == b']') || entry > at {
                        return pointer;
                    }
                    let end = end_of(text, entry);
                    if at < end {
                        pointer = format!("{pointer}/{index}");
                        if at == entry {
                            return pointer;
                        }
                        value = entry;
                        continue 'deeper;
                    }
                    entry = skip_separator(text, end);
                }
            }
            _ => return pointer,
        }
    }
}
