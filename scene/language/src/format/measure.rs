//! Measures the lists and objects of a tree: whether each fits on a line.

use super::entries::{Comment, Entries};
use super::lexer::Kind;
use crate::json::Tree;

/// Maximum length of a list of numbers that shares its line with others of a longer list.
const MAX_FILLED_CHARS: u32 = 40;

/// Measures of a list or an object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measures {
    /// Number of entries.
    pub entries: u32,
    /// Its length on one line, in characters; none if a comment needs a line for itself.
    pub flat_chars: Option<u32>,
    /// Whether its lines are filled: a list of numbers, strings, or short lists of them, without comments.
    pub is_filled: bool,
}

/// Measures of all lists and objects, in the order of their opening brackets. The tree nests less than the stack allows.
pub(super) fn measure(tree: &Tree<'_>) -> Vec<Measures> {
    let mut measurer = Measurer { text: tree.text(), entries: Entries::new(tree), all: Vec::new() };
    measurer.entries.comments();
    measurer.value();
    measurer.all
}

struct Measurer<'a> {
    text: &'a str,
    entries: Entries<'a>,
    all: Vec<Measures>,
}

/// Measures of a value.
struct ValueMeasures {
    flat_chars: Option<u32>,
    /// Whether lines may be filled with such values.
    is_simple: bool,
    is_scalar: bool,
}

impl Measurer<'_> {
    fn value(&mut self) -> ValueMeasures {
        match self.entries.value() {
            Some(token) if token.kind == Kind::Open => self.container(self.text[token.range].starts_with('{')),
            Some(token) => {
                ValueMeasures { flat_chars: Some(chars(&self.text[token.range])), is_simple: true, is_scalar: true }
            }
            None => ValueMeasures { flat_chars: None, is_simple: false, is_scalar: true },
        }
    }

    /// Measures a list or an object after its opening bracket.
    fn container(&mut self, is_object: bool) -> ValueMeasures {
        let index = self.all.len();
        self.all.push(Measures { entries: 0, flat_chars: None, is_filled: false });
        let (open_comments, mut pending) = self.entries.open();
        let starts_bare = open_comments.is_empty();
        let mut flat_chars = starts_bare.then_some(if is_object { 4 } else { 2 });
        let (mut is_filled, mut has_scalars, mut count) = (starts_bare && !is_object, !is_object, 0);
        while !self.entries.close() {
            let start = self.entries.start(pending, is_object);
            let value = self.value();
            let (trailing, after) = self.entries.end();
            pending = after;
            let key_chars = start.key.map_or(0, |key| chars(&self.text[key]) + 2);
            let separator_chars = if count > 0 { 2 } else { 0 };
            let parts = [
                flat_chars.filter(|_| !start.leading.iter().any(Comment::is_own_line)),
                Some(separator_chars + key_chars),
                self.of_comments(&start.leading),
                self.of_comments(&start.inside),
                value.flat_chars,
                self.of_comments(&trailing),
            ];
            flat_chars = parts.into_iter().sum();
            let has_comments = [&start.leading, &start.inside, &trailing].iter().any(|each| !each.is_empty());
            is_filled &= value.is_simple && !has_comments;
            has_scalars &= value.is_scalar;
            count += 1;
        }
        is_filled &= count > 0 && pending.is_empty();
        if count == 0 && pending.is_empty() {
            // Nothing is between the brackets.
            flat_chars = flat_chars.map(|_| 2);
        } else if !pending.is_empty() {
            let has_room = count == 0 && !pending.iter().any(Comment::is_own_line);
            let more = self.of_comments(&pending).filter(|_| has_room);
            flat_chars = flat_chars.zip(more).map(|(chars, more)| chars + more - 1);
        }
        self.all[index] = Measures { entries: count, flat_chars, is_filled };
        let is_simple = has_scalars && flat_chars.is_some_and(|chars| chars <= MAX_FILLED_CHARS);
        ValueMeasures { flat_chars, is_simple, is_scalar: false }
    }

    /// Length of comments on one line, each with a space; none if one of them needs a line for itself.
    fn of_comments(&self, comments: &[Comment]) -> Option<u32> {
        let of_one = |comment: &Comment| comment.is_block().then(|| chars(&self.text[comment.range.clone()]) + 1);
        comments.iter().map(of_one).sum()
    }
}

fn chars(text: &str) -> u32 {
    text.chars().count() as u32
}
