//! Scan of a JSON text: its nesting depth, long and duplicate members, and the positions of the values of JSON pointers.
//!
//! It does not check syntax: it stops at a syntax error, and the parser reports it. It does not enter an array or object
//! that nests deeper than a job may, because millions of open ones would take gigabytes.

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};

use crate::json_text::{escape, unescape};
use crate::limits::{MAX_JSON_DEPTH, MAX_KEY_BYTES};

/// Error found by the scan.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct ScanError {
    /// Byte offset in the text.
    pub offset: usize,
    /// JSON pointer to the error.
    pub pointer: String,
    /// Kind of error: nesting too deep, or a duplicate or too long member.
    pub kind: ScanErrorKind,
}

/// Kind of error found by the scan.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum ScanErrorKind {
    /// Arrays and objects nest deeper than allowed.
    TooDeep,
    /// A member name has this many bytes, more than allowed.
    LongMember(usize),
    /// An object has this member twice.
    DuplicateMember(String),
}

/// Number of keys of an object that are compared one by one; more are hashed.
const MAX_COMPARED_KEYS: usize = 8;

/// Open array or object, and the position in it.
enum OpenContainer<'a> {
    Array { index: usize },
    Object { key: Option<Cow<'a, str>>, seen: SeenKeys<'a> },
}

/// Keys of an object so far.
#[derive(Default)]
struct SeenKeys<'a> {
    few: Vec<Cow<'a, str>>,
    many: HashSet<Cow<'a, str>>,
}

impl<'a> SeenKeys<'a> {
    /// Adds a key; false if it is there already.
    fn insert(&mut self, key: Cow<'a, str>) -> bool {
        if self.few.contains(&key) {
            return false;
        }
        if self.few.len() < MAX_COMPARED_KEYS {
            self.few.push(key);
            return true;
        }
        self.many.insert(key)
    }
}

/// One step of the scan.
enum JsonToken<'a> {
    /// A member name at this offset.
    Key { offset: usize, key: Cow<'a, str> },
    /// A value begins at this offset.
    Value { offset: usize },
}

/// Scans for errors that a parser would not detect or not survive.
pub(crate) fn check(text: &str, max_depth: usize) -> Result<(), ScanError> {
    let mut fault = None;
    walk(text, |levels, event| {
        let (offset, kind) = match event {
            JsonToken::Value { offset } => {
                if levels.len() <= max_depth {
                    return true;
                }
                (offset, ScanErrorKind::TooDeep)
            }
            JsonToken::Key { offset, key } if key.len() > MAX_KEY_BYTES => {
                let inside = &levels[..levels.len().saturating_sub(1)];
                fault =
                    Some(ScanError { offset, pointer: pointer(inside), kind: ScanErrorKind::LongMember(key.len()) });
                return false;
            }
            JsonToken::Key { offset, key } => {
                let is_new = match levels.last_mut() {
                    Some(OpenContainer::Object { seen, .. }) => seen.insert(key.clone()),
                    Some(OpenContainer::Array { .. }) | None => true,
                };
                if is_new {
                    return true;
                }
                (offset, ScanErrorKind::DuplicateMember(key.into_owned()))
            }
        };
        // A pointer thousands of levels deep would not help.
        let shown = levels.len().min(max_depth);
        fault = Some(ScanError { offset, pointer: pointer(&levels[..shown]), kind });
        false
    });
    fault.map_or(Ok(()), Err)
}

/// Scans for values that nest too deep, also after other errors.
pub(crate) fn check_depth(text: &str, max_depth: usize) -> Result<(), ScanError> {
    let mut fault = None;
    walk(text, |levels, event| {
        if let JsonToken::Value { offset } = event
            && levels.len() > max_depth
        {
            let pointer = pointer(&levels[..max_depth]);
            fault = Some(ScanError { offset, pointer, kind: ScanErrorKind::TooDeep });
        }
        fault.is_none()
    });
    fault.map_or(Ok(()), Err)
}

/// Whether a text has more values than this, counting those in arrays and objects.
pub(crate) fn has_more_values_than(text: &str, limit: usize) -> bool {
    let mut count = 0;
    walk(text, |_, event| {
        count += usize::from(matches!(event, JsonToken::Value { .. }));
        count <= limit
    });
    count > limit
}

/// Start of the value at `pointer`.
pub fn locate_value(text: &str, pointer: &str) -> Option<usize> {
    locate(text, pointer, |event| match event {
        JsonToken::Key { .. } => None,
        JsonToken::Value { offset } => Some(*offset),
    })
}

/// Starts of the values at several pointers, found in one scan.
pub(crate) fn locate_values(text: &str, pointers: &[&str]) -> Vec<Option<usize>> {
    let mut wanted = vec![WantedStep::default()];
    let ends: Vec<usize> = pointers.iter().map(|pointer| WantedStep::add(&mut wanted, pointer)).collect();
    let mut found = vec![None; wanted.len()];
    // For each open array and object, its step, if a wanted pointer leads there.
    let mut path: Vec<Option<usize>> = Vec::new();
    walk(text, |levels, event| {
        let JsonToken::Value { offset } = event else { return true };
        path.truncate(levels.len());
        let above = path.last().copied().flatten();
        let step = match (levels.last(), above) {
            (None, _) => Some(0),
            (Some(OpenContainer::Object { key: Some(key), .. }), Some(above)) => wanted[above].next(key),
            (Some(OpenContainer::Array { index }), Some(above)) => wanted[above].next(&index.to_string()),
            (Some(_), _) => None,
        };
        if let Some(step) = step {
            found[step].get_or_insert(offset);
        }
        path.push(step);
        true
    });
    ends.into_iter().map(|end| found[end]).collect()
}

/// A step of wanted pointers: the steps after it, by their names.
#[derive(Default)]
struct WantedStep(HashMap<String, usize>);

impl WantedStep {
    /// Adds the steps of a pointer; returns the last.
    fn add(all: &mut Vec<Self>, pointer: &str) -> usize {
        pointer.split('/').skip(1).map(unescape).fold(0, |at, name| {
            let next = all.len();
            let step = *all[at].0.entry(name).or_insert(next);
            if step == next {
                all.push(Self::default());
            }
            step
        })
    }

    fn next(&self, name: &str) -> Option<usize> {
        self.0.get(name).copied()
    }
}

/// Start of the member name of the value at `pointer`.
pub(crate) fn locate_member(text: &str, pointer: &str) -> Option<usize> {
    locate(text, pointer, |event| match event {
        JsonToken::Key { offset, .. } => Some(*offset),
        JsonToken::Value { .. } => None,
    })
}

fn locate(text: &str, pointer: &str, place: impl Fn(&JsonToken<'_>) -> Option<usize>) -> Option<usize> {
    let wanted: Vec<String> = pointer.split('/').skip(1).map(unescape).collect();
    let mut found = None;
    walk(text, |levels, event| {
        if points_at(levels, &wanted) {
            found = place(&event);
        }
        found.is_none()
    });
    found
}

fn points_at(levels: &[OpenContainer<'_>], wanted: &[String]) -> bool {
    levels.len() == wanted.len()
        && levels.iter().zip(wanted).rev().all(|(level, wanted)| match level {
            OpenContainer::Array { index } => wanted.parse() == Ok(*index),
            OpenContainer::Object { key, .. } => key.as_deref() == Some(wanted.as_str()),
        })
}

fn pointer(levels: &[OpenContainer<'_>]) -> String {
    levels
        .iter()
        .map(|level| match level {
            OpenContainer::Array { index } => format!("/{index}"),
            OpenContainer::Object { key, .. } => format!("/{}", escape(key.as_deref().unwrap_or_default())),
        })
        .collect()
}

/// Scans a text while it is valid and `visit` returns true.
fn walk<'a>(text: &'a str, mut visit: impl FnMut(&mut Vec<OpenContainer<'a>>, JsonToken<'a>) -> bool) {
    let bytes = text.as_bytes();
    let mut levels: Vec<OpenContainer<'_>> = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        match bytes[at] {
            b' ' | b'\t' | b'\n' | b'\r' | b':' => at += 1,
            b',' => {
                match levels.last_mut() {
                    Some(OpenContainer::Array { index }) => *index += 1,
                    Some(OpenContainer::Object { key, .. }) => *key = None,
                    None => return,
                }
                at += 1;
            }
            b']' | b'}' => {
                levels.pop();
                at += 1;
            }
            b'"' => {
                let Some(end) = string_end(bytes, at) else { return };
                let wants_key = matches!(levels.last(), Some(OpenContainer::Object { key: None, .. }));
                let go_on = if wants_key {
                    let Some(name) = member_name(&text[at..end]) else { return };
                    if let Some(OpenContainer::Object { key, .. }) = levels.last_mut() {
                        *key = Some(name.clone());
                    }
                    visit(&mut levels, JsonToken::Key { offset: at, key: name })
                } else {
                    visit(&mut levels, JsonToken::Value { offset: at })
                };
                if !go_on {
                    return;
                }
                at = end;
            }
            opening @ (b'[' | b'{') => {
                if !visit(&mut levels, JsonToken::Value { offset: at }) {
                    return;
                }
                if levels.len() > MAX_JSON_DEPTH {
                    at = container_end(bytes, at);
                    continue;
                }
                levels.push(if opening == b'[' {
                    OpenContainer::Array { index: 0 }
                } else {
                    OpenContainer::Object { key: None, seen: SeenKeys::default() }
                });
                at += 1;
            }
            _ => {
                if !visit(&mut levels, JsonToken::Value { offset: at }) {
                    return;
                }
                at = bytes[at..].iter().position(|byte| b" \t\r\n,]}".contains(byte)).map_or(bytes.len(), |n| at + n);
            }
        }
    }
}

/// The name that a string stands for; none if the string is invalid.
fn member_name(string: &str) -> Option<Cow<'_, str>> {
    let inside = string.get(1..string.len() - 1)?;
    if inside.bytes().any(|byte| byte == b'\\' || byte < b' ') {
        return serde_json::from_str(string).ok().map(Cow::Owned);
    }
    Some(Cow::Borrowed(inside))
}

/// The byte after the string that begins at `start`.
fn string_end(bytes: &[u8], start: usize) -> Option<usize> {
    let mut at = start + 1;
    loop {
        match bytes.get(at)? {
            b'"' => return Some(at + 1),
            b'\\' => at += 2,
            _ => at += 1,
        }
    }
}

/// The offset after the array or object that begins at an offset; the end of the text if it does not end.
pub(crate) fn container_end(bytes: &[u8], start: usize) -> usize {
    let (mut depth, mut at) = (0_usize, start);
    while let Some(byte) = bytes.get(at) {
        match byte {
            b'"' => {
                let Some(end) = string_end(bytes, at) else { break };
                at = end;
                continue;
            }
            b'[' | b'{' => depth += 1,
            b']' | b'}' => depth -= 1,
            _ => {}
        }
        at += 1;
        if depth == 0 {
            return at;
        }
    }
    bytes.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_values_after_one_that_nests_too_deep() {
        let deep = format!("{}\"]\"{}", "[".repeat(300), "]".repeat(300));
        let text = format!(r#"{{"a": {deep}, "b": {{"c": 1}}}}"#);
        assert_eq!(locate_value(&text, "/b/c"), text.rfind('1'));
        // The first 257 arrays, the object and the values after it are counted.
        assert!(has_more_values_than(&text, 259) && !has_more_values_than(&text, 260));
    }

    #[test]
    fn finds_values_by_pointer() {
        let text = r#"{"a": [1, {"b/c": 22}], "d": "x"}"#;
        let value = |pointer| locate_value(text, pointer).map(|offset| &text[offset..]);
        assert!(value("/a/0").unwrap().starts_with("1,"));
        assert!(value("/a/1/b~1c").unwrap().starts_with("22"));
        assert!(value("/d").unwrap().starts_with("\"x\""));
        assert_eq!(value("/e"), None);
        assert_eq!(value(""), Some(text));
        assert!(text[locate_member(text, "/a/1/b~1c").unwrap()..].starts_with("\"b/c\""));
    }

    #[test]
    fn finds_several_values_in_one_scan() {
        let text = r#"{"a": [1, {"b/c": 22}], "d": {"1": [], "a": 7}, "a2": 1}"#;
        let pointers = ["/d/a", "/a/1/b~1c", "", "/a/1", "/d/1", "/x/1", "/a/2", "/d/a"];
        let found = locate_values(text, &pointers);
        for (pointer, found) in pointers.iter().zip(found) {
            assert_eq!(found, locate_value(text, pointer), "{pointer}");
        }
        assert_eq!(locate_values("[", &["", "/0"]), [Some(0), None]);
    }

    #[test]
    fn long_members_are_errors_of_their_object() {
        let text = format!(r#"{{"a": [{{"{}": 1}}]}}"#, "k".repeat(MAX_KEY_BYTES + 1));
        let fault = check(&text, 9).unwrap_err();
        assert_eq!((fault.pointer.as_str(), fault.offset), ("/a/0", 8));
        assert_eq!(fault.kind, ScanErrorKind::LongMember(MAX_KEY_BYTES + 1));
        assert_eq!(check(&text.replace("kk", "k"), 9), Ok(()));
    }

    #[test]
    fn finds_duplicate_members_with_escapes() {
        let fault = check(r#"{"a": {"b": 1, "\u0062": 2}}"#, 9).unwrap_err();
        assert_eq!(fault.kind, ScanErrorKind::DuplicateMember("b".into()));
        assert_eq!(fault.pointer, "/a/b");
        assert_eq!(fault.offset, 15);
    }

    #[test]
    fn finds_deep_nesting_without_recursion() {
        let deep = "[".repeat(100_000);
        assert_eq!(check(&deep, 64).unwrap_err().kind, ScanErrorKind::TooDeep);
        assert_eq!(check("[[[1]]]", 3), Ok(()));
        assert_eq!(check("[[[1]]]", 2).unwrap_err().offset, 3);
    }

    #[test]
    fn broken_text_is_left_to_the_parser() {
        for text in ["{", "\"abc", "]]", "{\"a\\", "nul", "[1,,2]"] {
            assert_eq!(check(text, 8), Ok(()));
        }
    }

    #[test]
    fn finds_values_past_every_kind_of_value() {
        let text = "{\t\"s\\\"]\": [ true ,\r\n{}, [[], -1.5e3], null ], \"~\" : {\"\\u0041\":\"\\\\\"}, \"z\":0}";
        let value = |pointer| locate_value(text, pointer).map(|offset| &text[offset..]);
        for (pointer, begins) in [
            ("/s\"]", "[ true"),
            ("/s\"]/0", "true ,"),
            ("/s\"]/1", "{}, [["),
            ("/s\"]/2/0", "[], -1.5e3"),
            ("/s\"]/2/1", "-1.5e3]"),
            ("/s\"]/3", "null"),
            ("/~0/A", "\"\\\\\"}"),
            ("/z", "0}"),
        ] {
            assert!(value(pointer).is_some_and(|value| value.starts_with(begins)), "{pointer}: {:?}", value(pointer));
        }
        for pointer in ["/s\"]/4", "/s\"]/x", "/s\"]/2/2", "/~01", "/z/0", "/s"] {
            assert_eq!(value(pointer), None, "{pointer}");
        }
        assert_eq!(locate_member(text, "/s\"]/0"), None, "an entry of a list has no member name");
        assert!(text[locate_member(text, "/z").unwrap()..].starts_with("\"z\":0"));
    }

    #[test]
    fn reports_the_pointer_of_an_error() {
        let doubled = check(r#"{"l": [0, {"a/b": 1, "a/b": 2}]}"#, 9).unwrap_err();
        assert_eq!((doubled.pointer.as_str(), doubled.offset), ("/l/1/a~1b", 21));
        let deep = check(r#"{"a": [{"b": {"c": 1}}]}"#, 3).unwrap_err();
        assert_eq!((deep.kind, deep.pointer.as_str()), (ScanErrorKind::TooDeep, "/a/0/b"));
        assert_eq!(
            check(r#"[{"a": 1}, {"a": 2}, {"b": {"a": 3}}]"#, 9),
            Ok(()),
            "several objects may have the same member"
        );
    }
}
