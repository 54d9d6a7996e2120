//! Builds a tree from another: its values, and text that is made.

use super::{KEY, Node, Origin, Outline, Reader, Tree, Value};

/// A tree in the making.
#[derive(Debug)]
pub(crate) struct Builder<'a> {
    source: &'a Tree<'a>,
    made: String,
    nodes: Vec<Node>,
    origins: Vec<Origin>,
    /// Indices of open lists and objects.
    open: Vec<usize>,
}

/// Nodes that were taken out of a builder.
#[derive(Debug)]
pub(crate) struct Detached {
    at: usize,
    nodes: Vec<Node>,
}

impl<'a> Builder<'a> {
    /// An empty tree.
    pub(crate) fn new(source: &'a Tree<'a>) -> Self {
        debug_assert!(source.inherited.is_empty(), "a tree is built from one that is read, or that is built from one");
        Self { source, made: String::new(), nodes: Vec::new(), origins: Vec::new(), open: Vec::new() }
    }

    /// Adds a value or a key of the source, with all that is in it.
    pub(crate) fn copy(&mut self, value: Value<'a>) {
        self.nodes.extend_from_slice(value.nodes());
    }

    /// Opens a list or an object of the source.
    pub(crate) fn open(&mut self, value: Value<'a>) {
        self.open_at(value.start() as u32);
    }

    /// Closes the list or object of the source that was opened.
    pub(crate) fn close(&mut self, value: Value<'a>) {
        self.close_at(value.close().start() as u32);
    }

    /// Adds a key, written with its quotes.
    pub(crate) fn key(&mut self, text: &str, from: usize) {
        let start = self.make(text, from);
        self.nodes.push(Node { start, size: text.len() as u32 | KEY });
    }

    /// Opens a list, or an object, by its bracket.
    pub(crate) fn open_made(&mut self, bracket: &str, from: usize) {
        let start = self.make(bracket, from);
        self.open_at(start);
    }

    /// Closes what was opened, by its bracket.
    pub(crate) fn close_made(&mut self, bracket: &str, from: usize) {
        let start = self.make(bracket, from);
        self.close_at(start);
    }

    /// Adds a value that is given as JSON and stands for what is at an offset; null if it is no JSON.
    pub(crate) fn json(&mut self, text: &str, from: usize) {
        match Reader::read(text, self.next_offset()) {
            Ok(reader) => {
                self.make(text, from);
                self.nodes.extend(reader.nodes);
            }
            Err(_) => self.json("null", from),
        }
    }

    /// Number of nodes so far.
    pub(crate) fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Takes away the nodes from a position on.
    pub(crate) fn split_off(&mut self, at: usize) -> Detached {
        Detached { at, nodes: self.nodes.split_off(at) }
    }

    /// Adds nodes that were taken away. `around` are the indices of what is around all that was added since.
    pub(crate) fn append(&mut self, rest: Detached, around: &[usize]) {
        for &index in around {
            self.nodes[index].size += (self.nodes.len() - rest.at) as u32;
        }
        self.nodes.extend(rest.nodes);
    }

    /// The tree, which stands for a text of some length.
    pub(crate) fn finish(self, length: usize) -> Tree<'a> {
        let Self { source, made, nodes, origins, open: _ } = self;
        let (text, inherited) = (source.text, source.made.as_str());
        let (comments, language_keys, outline) = (Vec::new(), Vec::new(), Outline::default());
        Tree { text, inherited, made, nodes, comments, language_keys, has_formulas: false, origins, length, outline }
    }

    fn next_offset(&self) -> u32 {
        (self.source.text.len() + self.source.made.len() + self.made.len()) as u32
    }

    fn make(&mut self, text: &str, from: usize) -> u32 {
        let start = self.next_offset();
        self.made.push_str(text);
        let from = from as u32;
        if self.origins.last().is_none_or(|last| last.from != from) {
            self.origins.push(Origin { start, from });
        }
        start
    }

    fn open_at(&mut self, start: u32) {
        self.open.push(self.nodes.len());
        self.nodes.push(Node { start, size: 0 });
    }

    fn close_at(&mut self, start: u32) {
        self.nodes.push(Node { start, size: 1 });
        if let Some(open) = self.open.pop() {
            self.nodes[open].size = (self.nodes.len() - open) as u32;
        }
    }
}
