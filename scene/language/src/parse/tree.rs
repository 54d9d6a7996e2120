//! A JSON text as a tree with the position of each value, in which parts can be replaced. The text itself is not
//! changed, so an error found after a repair still has its position in the user's text.

use crate::json_scan::container_end;
use crate::json_text::escape;
use crate::limits::MAX_JSON_DEPTH;

/// A value of the text.
#[derive(Clone, Debug)]
pub(super) struct Value {
    /// Byte offset of its start in the text.
    pub(super) start: usize,
    /// Byte offset of its end in the text.
    end: usize,
    /// Content of the value.
    pub(super) body: Body,
}

/// Content of a value.
#[derive(Clone, Debug)]
pub(super) enum Body {
    /// A number, a string, or a word, as written in the text.
    Scalar,
    /// A list.
    Array(Vec<Value>),
    /// An object.
    Object(Vec<Member>),
    /// JSON that replaces an invalid value.
    StandIn(String),
}

/// A key of an object, and its value.
#[derive(Clone, Debug)]
pub(super) struct Member {
    /// Byte offset of the start of the key in the text.
    pub(super) start: usize,
    /// The key in the text.
    pub(super) key: String,
    /// The key that is parsed instead.
    pub(super) read_as: String,
    /// Whether it is left out.
    pub(super) is_removed: bool,
    /// Whether the key is unknown to its object.
    pub(super) is_unknown: bool,
    /// Whether it was added and is missing in the text.
    pub(super) is_added: bool,
    /// Its value.
    pub(super) value: Value,
}

/// An error of the text's structure: the path to the member or the value.
#[derive(Debug)]
pub(super) enum TreeError {
    /// A key that the object has already; the later one is left out.
    DuplicateMember { path: Vec<usize>, start: usize },
    /// A value that nests too deep; it is not parsed.
    TooDeep { path: Vec<usize>, start: usize },
}

/// The tree of a text that is valid JSON, and at most `limit` structural errors.
pub(super) fn read(text: &str, limit: usize) -> (Value, Vec<TreeError>) {
    let mut reader = Reader { bytes: text.as_bytes(), text, at: 0, path: Vec::new(), misfits: Vec::new(), limit };
    let root = reader.value();
    (root, reader.misfits)
}

struct Reader<'a> {
    bytes: &'a [u8],
    text: &'a str,
    at: usize,
    path: Vec<usize>,
    misfits: Vec<TreeError>,
    limit: usize,
}

impl Reader<'_> {
    fn skip(&mut self, skipped: &[u8]) {
        while self.bytes.get(self.at).is_some_and(|byte| skipped.contains(byte)) {
            self.at += 1;
        }
    }

    fn string(&mut self) {
        self.at += 1;
        while let Some(&byte) = self.bytes.get(self.at) {
            self.at += if byte == b'\\' { 2 } else { 1 };
            if byte == b'"' {
                return;
            }
        }
    }

    fn value(&mut self) -> Value {
        self.skip(b" \t\r\n,:");
        let start = self.at;
        let body = match self.bytes.get(self.at) {
            Some(b'[' | b'{') if self.path.len() >= MAX_JSON_DEPTH => {
                self.at = container_end(self.bytes, self.at);
                if self.misfits.len() < self.limit {
                    self.misfits.push(TreeError::TooDeep { path: self.path.clone(), start });
                }
                Body::StandIn("null".to_owned())
            }
            Some(b'[') => self.array(),
            Some(b'{') => self.object(),
            Some(b'"') => {
                self.string();
                Body::Scalar
            }
            Some(_) | None => {
                while self.bytes.get(self.at).is_some_and(|byte| !b" \t\r\n,]}".contains(byte)) {
                    self.at += 1;
                }
                Body::Scalar
            }
        };
        Value { start, end: self.at, body }
    }

    /// Whether the list or object ends here; if so, moves past its bracket.
    fn ends(&mut self) -> bool {
        self.skip(b" \t\r\n,");
        let ends = self.bytes.get(self.at).is_none_or(|byte| b"]}".contains(byte));
        self.at += usize::from(ends);
        ends
    }

    fn array(&mut self) -> Body {
        self.at += 1;
        let mut entries = Vec::new();
        while !self.ends() {
            self.path.push(entries.len());
            entries.push(self.value());
            self.path.pop();
        }
        Body::Array(entries)
    }

    fn object(&mut self) -> Body {
        self.at += 1;
        let mut members: Vec<Member> = Vec::new();
        let mut known = std::collections::HashSet::new();
        while !self.ends() {
            let start = self.at;
            self.string();
            let key: String = serde_json::from_str(&self.text[start..self.at]).unwrap_or_default();
            self.path.push(members.len());
            let is_removed = !known.insert(key.clone());
            if is_removed && self.misfits.len() < self.limit {
                self.misfits.push(TreeError::DuplicateMember { path: self.path.clone(), start });
            }
            let value = self.value();
            self.path.pop();
            members.push(Member {
                start,
                read_as: key.clone(),
                key,
                is_removed,
                is_unknown: false,
                is_added: false,
                value,
            });
        }
        Body::Object(members)
    }
}

impl Member {
    /// A key that is missing in the text, with a stand-in as its value.
    pub(super) fn added(key: &str, at: usize, json: &str) -> Self {
        let value = Value { start: at, end: at, body: Body::StandIn(json.to_owned()) };
        let (key, read_as) = (key.to_owned(), key.to_owned());
        Self { start: at, key, read_as, is_removed: false, is_unknown: false, is_added: true, value }
    }
}

impl Value {
    /// Whether a key in it is `use`.
    pub(super) fn has_use(&self) -> bool {
        match &self.body {
            Body::Array(entries) => entries.iter().any(Self::has_use),
            Body::Object(members) => members.iter().any(|member| member.read_as == "use" || member.value.has_use()),
            Body::Scalar | Body::StandIn(_) => false,
        }
    }

    /// The value at a path of indices in lists and objects.
    pub(super) fn at(&self, path: &[usize]) -> Option<&Value> {
        path.iter().try_fold(self, |value, &index| match &value.body {
            Body::Array(entries) => entries.get(index),
            Body::Object(members) => members.get(index).map(|member| &member.value),
            Body::Scalar | Body::StandIn(_) => None,
        })
    }

    /// Mutable access to that value.
    pub(super) fn at_mut(&mut self, path: &[usize]) -> Option<&mut Value> {
        path.iter().try_fold(self, |value, &index| match &mut value.body {
            Body::Array(entries) => entries.get_mut(index),
            Body::Object(members) => members.get_mut(index).map(|member| &mut member.value),
            Body::Scalar | Body::StandIn(_) => None,
        })
    }

    /// The member that ends a path, if it ends in an object.
    pub(super) fn member_at(&self, path: &[usize]) -> Option<&Member> {
        let (&index, parent) = path.split_last()?;
        self.at(parent)?.members().get(index)
    }

    /// Mutable access to that member.
    pub(super) fn member_at_mut(&mut self, path: &[usize]) -> Option<&mut Member> {
        let (&index, parent) = path.split_last()?;
        match &mut self.at_mut(parent)?.body {
            Body::Object(members) => members.get_mut(index),
            Body::Scalar | Body::Array(_) | Body::StandIn(_) => None,
        }
    }

    /// Its members; empty if it is not an object.
    pub(super) fn members(&self) -> &[Member] {
        match &self.body {
            Body::Object(members) => members,
            Body::Scalar | Body::Array(_) | Body::StandIn(_) => &[],
        }
    }

    /// The path of a JSON pointer's parts, as far as the values exist, and whether that is all of the pointer.
    pub(super) fn path_of(&self, steps: &[String]) -> (Vec<usize>, bool) {
        let mut path = Vec::new();
        let mut value = self;
        for step in steps {
            let next = match &value.body {
                Body::Array(entries) => step.parse().ok().filter(|&index: &usize| index < entries.len()),
                Body::Object(members) => {
                    members.iter().position(|member| !member.is_removed && member.read_as == *step)
                }
                Body::Scalar | Body::StandIn(_) => None,
            };
            let Some((index, inside)) = next.and_then(|index| Some((index, value.at(&[index])?))) else {
                return (path, false);
            };
            path.push(index);
            value = inside;
        }
        (path, true)
    }

    /// JSON pointer of a path, with the keys of the text or with the keys that are parsed instead.
    pub(super) fn pointer(&self, path: &[usize], as_read: bool) -> String {
        let mut value = self;
        let mut pointer = String::new();
        for &index in path {
            pointer.push('/');
            match &value.body {
                Body::Object(members) if index < members.len() => {
                    let member = &members[index];
                    pointer.push_str(&escape(if as_read { &member.read_as } else { &member.key }));
                }
                _ => pointer.push_str(&index.to_string()),
            }
            let Some(inside) = value.at(&[index]) else { break };
            value = inside;
        }
        pointer
    }

    /// Writes the value with its repairs; `cut` returns the stand-in for a value that is parsed separately, from its
    /// path.
    pub(super) fn write(
        &self,
        text: &str,
        out: &mut String,
        path: &mut Vec<String>,
        cut: &impl Fn(&[String], &Value) -> Option<&'static str>,
    ) {
        if let Some(json) = cut(path, self) {
            out.push_str(json);
            return;
        }
        match &self.body {
            Body::Scalar => out.push_str(&text[self.start..self.end]),
            Body::StandIn(json) => out.push_str(json),
            Body::Array(entries) => {
                out.push('[');
                for (index, entry) in entries.iter().enumerate() {
                    if index > 0 {
                        out.push(',');
                    }
                    path.push(String::new());
                    entry.write(text, out, path, cut);
                    path.pop();
                }
                out.push(']');
            }
            Body::Object(members) => {
                out.push('{');
                for (index, member) in members.iter().filter(|member| !member.is_removed).enumerate() {
                    if index > 0 {
                        out.push(',');
                    }
                    out.push_str(&serde_json::Value::from(member.read_as.as_str()).to_string());
                    out.push(':');
                    path.push(member.read_as.clone());
                    member.value.write(text, out, path, cut);
                    path.pop();
                }
                out.push('}');
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(root: &Value, text: &str) -> String {
        let mut out = String::new();
        root.write(text, &mut out, &mut Vec::new(), &|_, _| None);
        out
    }

    #[test]
    fn an_unchanged_tree_is_written_as_parsed() {
        let text = r#"{ "a" : [1, {"b/c": -2.5e3}, "x\"]"], "d": {}, "e": [], "f": true }"#;
        let (root, misfits) = read(text, 9);
        assert!(misfits.is_empty());
        assert_eq!(written(&root, text), r#"{"a":[1,{"b/c":-2.5e3},"x\"]"],"d":{},"e":[],"f":true}"#);
        let steps = ["a", "1", "b/c"].map(str::to_owned);
        let (path, is_whole) = root.path_of(&steps);
        assert!(is_whole && root.pointer(&path, false) == "/a/1/b~1c");
        assert!(text[root.at(&path).expect("there").start..].starts_with("-2.5e3"));
    }

    #[test]
    fn duplicate_keys_and_deep_values_are_found_and_removed() {
        let text = format!(r#"{{"a": 1, "\u0061": 2, "b": {}{}}}"#, "[".repeat(9000), "]".repeat(9000));
        let (root, misfits) = read(&text, 9);
        assert!(matches!(&misfits[0], TreeError::DuplicateMember { path, start: 9 } if *path == [1]), "{misfits:?}");
        assert!(matches!(&misfits[1], TreeError::TooDeep { path, .. } if path.len() == MAX_JSON_DEPTH), "{misfits:?}");
        assert!(written(&root, &text).starts_with(r#"{"a":1,"b":[["#));
    }
}
