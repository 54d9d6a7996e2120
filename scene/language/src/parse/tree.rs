//! A tree in which parts can be replaced. Each value knows its node in the tree that it was made of, so an error found
//! after a repair still has its position in the user's text.

use std::collections::HashSet;

use crate::json::{self, Builder, Kind, Tree};
use crate::json_text::escape;
use crate::limits::MAX_JSON_DEPTH;

/// A value of the tree.
#[derive(Clone, Debug)]
pub(super) struct Value {
    /// Its node in the tree.
    pub(super) node: u32,
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
    /// Node of the key in the tree.
    pub(super) node: u32,
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

/// An error of the text's structure: the path to the member or the value, and its node.
#[derive(Debug)]
pub(super) enum TreeError {
    /// A key that the object has already; the later one is left out.
    DuplicateMember { path: Vec<usize>, node: u32 },
    /// A value that nests too deep; it is not parsed.
    TooDeep { path: Vec<usize>, node: u32 },
}

/// The values of a tree, and at most `limit` structural errors.
pub(super) fn read(tree: &Tree<'_>, limit: usize) -> (Value, Vec<TreeError>) {
    let mut reader = TreeReader { path: Vec::new(), misfits: Vec::new(), limit };
    let root = reader.value(tree.root());
    (root, reader.misfits)
}

struct TreeReader {
    path: Vec<usize>,
    misfits: Vec<TreeError>,
    limit: usize,
}

impl TreeReader {
    fn report(&mut self, misfit: impl FnOnce(Vec<usize>) -> TreeError) {
        if self.misfits.len() < self.limit {
            self.misfits.push(misfit(self.path.clone()));
        }
    }

    fn value(&mut self, value: json::Value<'_>) -> Value {
        let node = value.index();
        let body = match value.kind() {
            Kind::Array | Kind::Object if self.path.len() >= MAX_JSON_DEPTH => {
                self.report(|path| TreeError::TooDeep { path, node });
                Body::StandIn("null".to_owned())
            }
            Kind::Array => Body::Array(value.entries().enumerate().map(|(at, entry)| self.inside(at, entry)).collect()),
            Kind::Object => {
                let mut known = HashSet::new();
                let member = |(at, (key, inside)): (usize, (json::Value<'_>, json::Value<'_>))| {
                    let (node, read_as) = (key.index(), key.string().into_owned());
                    let is_removed = !known.insert(read_as.clone());
                    if is_removed {
                        self.path.push(at);
                        self.report(|path| TreeError::DuplicateMember { path, node });
                        self.path.pop();
                    }
                    let value = self.inside(at, inside);
                    let key = read_as.clone();
                    Member { node, key, read_as, is_removed, is_unknown: false, is_added: false, value }
                };
                Body::Object(value.members().enumerate().map(member).collect())
            }
            Kind::String | Kind::Number | Kind::Word => Body::Scalar,
        };
        Value { node, body }
    }

    fn inside(&mut self, at: usize, value: json::Value<'_>) -> Value {
        self.path.push(at);
        let value = self.value(value);
        self.path.pop();
        value
    }
}

impl Member {
    /// A key that is missing in the text, with a stand-in as its value.
    pub(super) fn added(key: &str, node: u32, json: &str) -> Self {
        let value = Value { node, body: Body::StandIn(json.to_owned()) };
        let (key, read_as) = (key.to_owned(), key.to_owned());
        Self { node, key, read_as, is_removed: false, is_unknown: false, is_added: true, value }
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

    /// The tree of the value with its repairs; `cut` returns the stand-in for a value that is parsed separately, from
    /// its path.
    pub(super) fn build<'t>(
        &self,
        tree: &'t Tree<'t>,
        cut: &impl Fn(&[String], &Value) -> Option<&'static str>,
    ) -> Tree<'t> {
        let (builder, path) = (Builder::new(tree), Vec::new());
        let mut repaired = Repaired { tree, builder, length: 0, path, cut };
        repaired.value(self);
        let Repaired { builder, length, .. } = repaired;
        builder.finish(length)
    }
}

/// A repaired tree in the making.
struct Repaired<'t, 'c, C> {
    tree: &'t Tree<'t>,
    builder: Builder<'t>,
    /// Length of what is built as text without spaces.
    length: usize,
    path: Vec<String>,
    cut: &'c C,
}

impl<C: Fn(&[String], &Value) -> Option<&'static str>> Repaired<'_, '_, C> {
    fn value(&mut self, value: &Value) {
        if let Some(json) = (self.cut)(&self.path, value) {
            self.stand_in(json);
            return;
        }
        let written = json::Value::of(self.tree, value.node);
        match &value.body {
            Body::Scalar => {
                self.length += written.text().len();
                self.builder.copy(written);
            }
            Body::StandIn(json) => self.stand_in(json),
            Body::Array(entries) => {
                self.builder.open(written);
                for entry in entries {
                    self.path.push(String::new());
                    self.value(entry);
                    self.path.pop();
                }
                self.builder.close(written);
                self.length += 2 + entries.len().saturating_sub(1);
            }
            Body::Object(members) => {
                self.builder.open(written);
                let mut count = 0;
                for member in members.iter().filter(|member| !member.is_removed) {
                    let key = serde_json::Value::from(member.read_as.as_str()).to_string();
                    self.length += key.len() + 1;
                    self.builder.key(&key, 0);
                    self.path.push(member.read_as.clone());
                    self.value(&member.value);
                    self.path.pop();
                    count += 1;
                }
                self.builder.close(written);
                self.length += 2 + usize::saturating_sub(count, 1);
            }
        }
    }

    fn stand_in(&mut self, json: &str) {
        self.length += json.len();
        self.builder.json(json, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unchanged_tree_is_built_as_parsed() {
        let text = r#"{ "a" : [1, {"b/c": -2.5e3}, "x\"]"], "d": {}, "e": [], "f": true }"#;
        let tree = Tree::read(text).unwrap_or_else(|error| panic!("{error:?}"));
        let (root, misfits) = read(&tree, 9);
        assert!(misfits.is_empty());
        let built = root.build(&tree, &|_, _| None);
        let whole: serde_json::Value = serde::Deserialize::deserialize(built.root()).expect("JSON");
        assert_eq!(whole, serde_json::from_str::<serde_json::Value>(text).expect("JSON"));
        assert_eq!(built.length(), r#"{"a":[1,{"b/c":-2.5e3},"x\"]"],"d":{},"e":[],"f":true}"#.len());
        let steps = ["a", "1", "b/c"].map(str::to_owned);
        let (path, is_whole) = root.path_of(&steps);
        assert!(is_whole && root.pointer(&path, false) == "/a/1/b~1c");
        assert_eq!(json::Value::of(&tree, root.at(&path).expect("there").node).text(), "-2.5e3");
    }

    #[test]
    fn duplicate_keys_and_deep_values_are_found_and_removed() {
        let text = format!(r#"{{"a": 1, "\u0061": 2, "b": {}{}}}"#, "[".repeat(9000), "]".repeat(9000));
        let tree = Tree::read(&text).unwrap_or_else(|error| panic!("{error:?}"));
        let (root, misfits) = read(&tree, 9);
        let start = |node| json::Value::of(&tree, node).start();
        assert!(
            matches!(&misfits[0], TreeError::DuplicateMember { path, node } if *path == [1] && start(*node) == 9),
            "{misfits:?}"
        );
        assert!(matches!(&misfits[1], TreeError::TooDeep { path, .. } if path.len() == MAX_JSON_DEPTH), "{misfits:?}");
        let built = root.build(&tree, &|_, _| None);
        assert_eq!(built.root().members().count(), 2);
    }
}
