//! A value of a tree: its kind, text, members and entries.

use std::borrow::Cow;
use std::iter;

use super::{KEY, Node, Tree};

/// A value of a tree, or a key.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Value<'a> {
    tree: &'a Tree<'a>,
    index: usize,
}

/// Kind of value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Object,
    Array,
    String,
    Number,
    /// `true`, `false` or `null`.
    Word,
}

impl<'a> Value<'a> {
    pub(super) fn new(tree: &'a Tree<'a>, index: usize) -> Self {
        Self { tree, index }
    }

    /// The value of a node of a tree.
    pub(crate) fn of(tree: &'a Tree<'a>, index: u32) -> Self {
        Self::new(tree, index as usize)
    }

    /// Index of its node.
    pub(crate) fn index(self) -> u32 {
        self.index as u32
    }

    fn node(self) -> Node {
        self.tree.nodes[self.index]
    }

    pub(super) fn nodes(self) -> &'a [Node] {
        &self.tree.nodes[self.index..self.index + self.span()]
    }

    /// Number of its nodes: of the values and keys in it, and of the brackets.
    pub(crate) fn span(self) -> usize {
        if self.is_container() { self.node().size as usize } else { 1 }
    }

    /// Kind of value.
    pub(crate) fn kind(self) -> Kind {
        match self.tree.byte(self.node().start) {
            b'{' => Kind::Object,
            b'[' => Kind::Array,
            b'"' => Kind::String,
            b't' | b'f' | b'n' => Kind::Word,
            _ => Kind::Number,
        }
    }

    /// Whether it is a list or an object.
    pub(crate) fn is_container(self) -> bool {
        matches!(self.kind(), Kind::Object | Kind::Array)
    }

    /// Byte offset of its start.
    pub(crate) fn start(self) -> usize {
        self.node().start as usize
    }

    /// Byte offset of its end.
    pub(crate) fn end(self) -> usize {
        if self.is_container() { self.close().start() + 1 } else { self.start() + self.length() }
    }

    /// Number of bytes of a value that is no list or object.
    fn length(self) -> usize {
        (self.node().size & !KEY) as usize
    }

    /// The closing bracket of a list or an object.
    pub(super) fn close(self) -> Self {
        Self { index: self.index + self.node().size as usize - 1, ..self }
    }

    /// Text of a value that is no list or object; a bracket for those.
    pub(crate) fn text(self) -> &'a str {
        let length = if self.is_container() { 1 } else { self.length() };
        &self.tree.text_from(self.node().start)[..length]
    }

    /// Text between the quotes of a string or a key, as written.
    pub(crate) fn raw(self) -> &'a str {
        let text = self.text();
        text.get(1..text.len() - 1).unwrap_or_default()
    }

    /// The text of a string or a key; empty for others, and for half of a surrogate pair.
    pub(crate) fn string(self) -> Cow<'a, str> {
        if self.kind() != Kind::String {
            return Cow::Borrowed("");
        }
        if !self.raw().contains('\\') {
            return Cow::Borrowed(self.raw());
        }
        Cow::Owned(serde_json::from_str(self.text()).unwrap_or_default())
    }

    /// Keys and values of an object; none of other values.
    pub(crate) fn members(self) -> impl Iterator<Item = (Self, Self)> {
        let end = if self.kind() == Kind::Object { self.close().index } else { 0 };
        let mut at = self.index + 1;
        iter::from_fn(move || {
            (at < end).then(|| {
                let (key, value) = (Self { index: at, ..self }, Self { index: at + 1, ..self });
                at = value.index + value.span();
                (key, value)
            })
        })
    }

    /// Entries of a list; none of other values.
    pub(crate) fn entries(self) -> impl Iterator<Item = Self> {
        let end = if self.kind() == Kind::Array { self.close().index } else { 0 };
        let mut at = self.index + 1;
        iter::from_fn(move || {
            (at < end).then(|| {
                let entry = Self { index: at, ..self };
                at += entry.span();
                entry
            })
        })
    }

    /// Value of the first member whose key is written so.
    pub(crate) fn get(self, key: &str) -> Option<Self> {
        self.members().find(|(found, _)| found.raw() == key).map(|(_, value)| value)
    }

    /// Whether a key in it is written so.
    pub(crate) fn has_key(self, key: &str) -> bool {
        self.members().any(|(found, value)| found.raw() == key || value.has_key(key))
            || self.entries().any(|entry| entry.has_key(key))
    }

    /// Whether a key of the language's formulas, uses and counted copies is in it.
    pub(crate) fn has_language_keys(self) -> bool {
        let keys = &self.tree.language_keys;
        let next = keys.partition_point(|key| (*key as usize) < self.index);
        keys.get(next).is_some_and(|key| (*key as usize) < self.index + self.span())
    }

    /// The value that some steps lead to, and its key; of several members of one name, the first that has the rest.
    pub(super) fn find(self, key: Option<Self>, steps: &[String]) -> Option<(Option<Self>, Self)> {
        let Some((step, rest)) = steps.split_first() else { return Some((key, self)) };
        if self.kind() == Kind::Array {
            return self.entries().nth(step.parse().ok()?)?.find(None, rest);
        }
        self.members().filter(|(key, _)| key.string() == *step).find_map(|(key, value)| value.find(Some(key), rest))
    }
}
