//! The text of a job as a tree: every value, key and comment with its position. The text is read once, here.
//!
//! A tree borrows its text and adds 8 bytes a token, so a text of 30 MB takes about 60 MB. Deserializing, replacing
//! formulas, setting values, formatting and finding positions all walk the tree. What a job becomes with its formulas
//! replaced is another tree of the same text ([`Builder`]). Comments and trailing commas are allowed; any other error of
//! syntax stops the reader. It does not enter what nests deeper than a job may, but checks its syntax.

mod build;
mod deserialize;
mod read;
#[cfg(test)]
mod tests;
mod value;

pub(crate) use self::build::Builder;
pub(crate) use self::deserialize::{MORE_ENTRIES, MORE_MEMBERS, NO_CHOICE};
pub(crate) use self::read::{Outline, OutlineError, OutlineErrorKind, SyntaxError};
pub(crate) use self::value::{Kind, Value};

use self::read::Reader;
use crate::json_text::{escape, unescape};

/// A JSON text, read.
#[derive(Debug)]
pub(crate) struct Tree<'t> {
    /// The user's text.
    text: &'t str,
    /// Text that was made for the tree that this tree was built from; its offsets follow the offsets of the user's text.
    inherited: &'t str,
    /// Text that was made for this tree; its offsets follow.
    made: String,
    nodes: Vec<Node>,
    /// Byte ranges of the comments.
    comments: Vec<(u32, u32)>,
    /// Keys that formulas, uses of shapes and counted copies have.
    language_keys: Vec<u32>,
    has_formulas: bool,
    /// Where the made text stands for, in the order of its offsets.
    origins: Vec<Origin>,
    /// Length of the text that this tree stands for.
    length: usize,
    outline: Outline,
}

/// A token: a key, a string, a number, a word, or a bracket.
#[derive(Clone, Copy, Debug)]
struct Node {
    /// Byte offset of its start.
    start: u32,
    /// Of a list or an object, the number of its nodes with both brackets; of others, the number of bytes, and the flag
    /// of keys.
    size: u32,
}

/// Marks the size of a key.
const KEY: u32 = 1 << 31;

/// The source of made text, from an offset on.
#[derive(Clone, Copy, Debug)]
struct Origin {
    start: u32,
    from: u32,
}

impl<'t> Tree<'t> {
    /// Reads a text.
    ///
    /// # Errors
    /// Fails where the text is not JSON.
    pub(crate) fn read(text: &'t str) -> Result<Self, SyntaxError> {
        let Reader { nodes, comments, language_keys, has_formulas, outline, .. } = Reader::read(text, 0)?;
        let (inherited, made, origins) = ("", String::new(), Vec::new());
        let length = text.len();
        Ok(Self { text, inherited, made, nodes, comments, language_keys, has_formulas, origins, length, outline })
    }

    /// The user's text.
    pub(crate) fn text(&self) -> &'t str {
        self.text
    }

    /// Length in bytes of the text that this tree stands for.
    pub(crate) fn length(&self) -> usize {
        self.length
    }

    /// Errors that a parser would not find or not survive.
    pub(crate) fn outline(&self) -> &Outline {
        &self.outline
    }

    /// Whether formulas, uses of shapes with numbers, or counted copies may be in it.
    pub(crate) fn has_formulas(&self) -> bool {
        self.has_formulas
    }

    /// Byte ranges of the comments.
    pub(crate) fn comments(&self) -> &[(u32, u32)] {
        &self.comments
    }

    /// The value, key or bracket of a node, in the order of the text.
    pub(crate) fn node(&self, index: u32) -> Option<Value<'_>> {
        ((index as usize) < self.nodes.len()).then(|| Value::of(self, index))
    }

    /// The whole.
    pub(crate) fn root(&self) -> Value<'_> {
        Value::new(self, 0)
    }

    /// Number of values, those in lists and objects included.
    pub(crate) fn value_count(&self) -> usize {
        let is_value = |node: &&Node| self.byte(node.start) != b'}' && self.byte(node.start) != b']';
        self.nodes.iter().filter(is_value).filter(|node| self.is_bracket(**node) || node.size & KEY == 0).count()
    }

    /// The value at a JSON pointer.
    pub(crate) fn value_at(&self, pointer: &str) -> Option<Value<'_>> {
        self.find(pointer).map(|(_, value)| value)
    }

    /// The key of the member at a JSON pointer.
    pub(crate) fn key_at(&self, pointer: &str) -> Option<Value<'_>> {
        self.find(pointer).and_then(|(key, _)| key)
    }

    fn find(&self, pointer: &str) -> Option<(Option<Value<'_>>, Value<'_>)> {
        let steps: Vec<String> = pointer.split('/').skip(1).map(unescape).collect();
        self.root().find(None, &steps)
    }

    /// JSON pointer of the innermost value that contains a byte of the user's text, or of the member whose key begins
    /// there.
    pub(crate) fn pointer_at(&self, offset: usize) -> String {
        let (mut pointer, mut value) = (String::new(), self.root());
        'deeper: loop {
            for (key, inside) in value.members().filter(|(key, _)| key.start() <= offset) {
                if offset < inside.end() {
                    pointer = format!("{pointer}/{}", escape(&key.string()));
                    // At a key, and at a value itself, it is this member.
                    if offset <= inside.start() {
                        return pointer;
                    }
                    value = inside;
                    continue 'deeper;
                }
            }
            for (index, inside) in value.entries().enumerate().take_while(|(_, inside)| inside.start() <= offset) {
                if offset < inside.end() {
                    pointer = format!("{pointer}/{index}");
                    if offset == inside.start() {
                        return pointer;
                    }
                    value = inside;
                    continue 'deeper;
                }
            }
            return pointer;
        }
    }

    /// Byte offset in the user's text of what is at an offset, or of what it stands for.
    pub(crate) fn origin(&self, offset: usize) -> usize {
        if offset < self.text.len() {
            return offset;
        }
        let next = self.origins.partition_point(|origin| origin.start as usize <= offset);
        next.checked_sub(1).map_or(0, |index| self.origins[index].from as usize)
    }

    /// The text from an offset on.
    fn text_from(&self, offset: u32) -> &str {
        let offset = offset as usize;
        let Some(offset) = offset.checked_sub(self.text.len()) else { return &self.text[offset..] };
        let Some(offset) = offset.checked_sub(self.inherited.len()) else { return &self.inherited[offset..] };
        &self.made[offset..]
    }

    fn byte(&self, offset: u32) -> u8 {
        self.text_from(offset).as_bytes()[0]
    }

    /// Whether a node opens a list or an object.
    fn is_bracket(&self, node: Node) -> bool {
        matches!(self.byte(node.start), b'{' | b'[')
    }
}
