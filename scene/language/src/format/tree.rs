//! The entries of a text, and the comments that belong to each.
//!
//! A comment on the line of a value belongs to that value; other comments belong to what comes after them.

use std::ops::Range;

use super::lexer::{Kind, Lexer};
use super::width;
use crate::json::Tree;

/// A comment.
#[derive(Clone, Debug)]
pub(super) struct Comment {
    /// Its bytes in the text.
    pub range: Range<usize>,
    pub form: Form,
    /// Whether a blank line is before it.
    pub follows_blank: bool,
    /// Whether something else is before it on its line.
    shares_start: bool,
    /// Whether nothing is after it on its line.
    is_last: bool,
}

/// Form of a comment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    /// It ends with its line.
    Line,
    /// A block on one line.
    Block,
    /// A block of several lines.
    LongBlock,
}

impl Comment {
    /// Whether a value may be after it on its line, wherever it is written.
    pub(super) fn is_block(&self) -> bool {
        self.form == Form::Block
    }

    /// Whether nothing may be after it on its line.
    pub(super) fn is_own_line(&self) -> bool {
        !self.is_block() || self.is_last
    }
}

/// Comments of an entry; few entries have any.
#[derive(Debug, Default)]
pub(super) struct Comments {
    /// Before the entry.
    pub leading: Vec<Comment>,
    /// Between its key and its value: blocks on one line.
    pub inside: Vec<Comment>,
    /// After the entry, on its last line.
    pub trailing: Vec<Comment>,
}

/// A value, with its key in an object.
#[derive(Debug)]
pub(super) struct Entry {
    /// Bytes of the key, with its quotes.
    pub key: Option<Range<usize>>,
    pub value: Value,
    comments: Option<Box<Comments>>,
    /// Whether a blank line is before it.
    pub follows_blank: bool,
}

impl Entry {
    /// The comments, if there are any.
    pub(super) fn comments(&self) -> Option<&Comments> {
        self.comments.as_deref()
    }
}

/// A value.
#[derive(Debug)]
pub(super) enum Value {
    /// A string, a number or a word: its bytes.
    Scalar(Range<usize>),
    /// A list or an object.
    Container(Box<Container>),
}

/// A list, an object, or the whole text, which has one entry.
#[derive(Debug)]
pub(super) struct Container {
    pub is_object: bool,
    pub entries: Vec<Entry>,
    /// After the opening bracket, on its line.
    pub open_comments: Vec<Comment>,
    /// Before the closing bracket, after the last entry.
    pub end_comments: Vec<Comment>,
    /// Its length on one line, in characters; none if a comment needs a line for itself.
    pub flat_chars: Option<usize>,
}

impl Container {
    /// The opening bracket.
    pub(super) fn open(&self) -> &'static str {
        if self.is_object { "{" } else { "[" }
    }

    /// The closing bracket.
    pub(super) fn close(&self) -> &'static str {
        if self.is_object { "}" } else { "]" }
    }

    /// Whether nothing is between its brackets.
    pub(super) fn is_bare(&self) -> bool {
        self.entries.is_empty() && self.end_comments.is_empty() && self.open_comments.is_empty()
    }

    /// Whether its lines are filled: a list of numbers, strings, or short lists of them, without comments.
    pub(super) fn is_filled(&self, max_chars: usize) -> bool {
        let is_simple = |entry: &Entry| match &entry.value {
            Value::Scalar(_) => entry.comments.is_none(),
            Value::Container(inside) => {
                let is_flat = |entry: &Entry| matches!(entry.value, Value::Scalar(_));
                entry.comments.is_none()
                    && !inside.is_object
                    && inside.flat_chars.is_some_and(|chars| chars <= max_chars)
                    && inside.entries.iter().all(is_flat)
            }
        };
        let has_comments = !self.open_comments.is_empty() || !self.end_comments.is_empty();
        !self.is_object && !self.entries.is_empty() && !has_comments && self.entries.iter().all(is_simple)
    }
}

/// Reads a tree that nests less than the stack allows.
pub(super) fn read(tree: &Tree<'_>) -> Container {
    let mut reader = TreeReader { text: tree.text(), lexer: Lexer::new(tree) };
    let leading = reader.comments();
    let mut file = Container {
        is_object: false,
        entries: Vec::new(),
        open_comments: Vec::new(),
        end_comments: Vec::new(),
        flat_chars: None,
    };
    if let Some(mut entry) = reader.entry(leading, false) {
        let (trailing, end) = on_line(reader.comments());
        entry.with(|comments| &mut comments.trailing, trailing);
        file.entries.push(entry);
        file.end_comments = end;
    }
    file
}

struct TreeReader<'a> {
    text: &'a str,
    lexer: Lexer<'a>,
}

impl TreeReader<'_> {
    /// Takes the comments before the next other token.
    fn comments(&mut self) -> Vec<Comment> {
        let mut comments = Vec::new();
        while matches!(self.lexer.kind(), Some(Kind::LineComment | Kind::BlockComment)) {
            let Some(token) = self.lexer.take() else { break };
            let form = match token.kind {
                Kind::LineComment => Form::Line,
                _ if self.text[token.range.clone()].contains('\n') => Form::LongBlock,
                _ => Form::Block,
            };
            comments.push(Comment {
                form,
                follows_blank: token.breaks > 1,
                shares_start: token.breaks == 0,
                is_last: form == Form::Line || self.lexer.peek().is_none_or(|next| next.breaks > 0),
                range: token.range,
            });
        }
        comments
    }

    /// Reads a key and a value, or a value alone.
    fn entry(&mut self, leading: Vec<Comment>, has_key: bool) -> Option<Entry> {
        let mut follows_blank = self.lexer.peek()?.breaks > 1;
        let (mut key, mut between) = (None, Vec::new());
        if has_key {
            key = Some(self.lexer.take_if(Kind::Scalar)?.range);
            between = self.comments();
            self.lexer.take_if(Kind::Colon)?;
            between.extend(self.comments());
        }
        // A comment that cannot be on the line of its value is moved before the key, and those before it, too.
        let last = between.iter().rposition(|comment| !comment.is_block());
        let inside = between.split_off(last.map_or(0, |last| last + 1));
        let mut moved = between;
        for comment in &mut moved {
            comment.follows_blank = std::mem::take(&mut follows_blank);
        }
        let token = self.lexer.take()?;
        let value = match token.kind {
            Kind::Open => Value::Container(Box::new(self.container(self.text[token.range].starts_with('{')))),
            _ => Value::Scalar(token.range),
        };
        let mut entry = Entry { key, value, comments: None, follows_blank };
        entry.with(|comments| &mut comments.leading, leading.into_iter().chain(moved).collect());
        entry.with(|comments| &mut comments.inside, inside);
        Some(entry)
    }

    /// Reads a list or an object after its opening bracket.
    fn container(&mut self, is_object: bool) -> Container {
        let (mut open_comments, mut pending) = on_line(self.comments());
        if open_comments.last().is_some_and(|comment| !comment.is_last) {
            open_comments.append(&mut pending);
            pending = std::mem::take(&mut open_comments);
        }
        let mut entries = Vec::new();
        while !matches!(self.lexer.kind(), Some(Kind::Close) | None) {
            let Some(mut entry) = self.entry(std::mem::take(&mut pending), is_object) else { break };
            let (mut trailing, after) = on_line(self.comments());
            pending = after;
            if self.lexer.take_if(Kind::Comma).is_some() {
                let (mut more, after) = on_line(self.comments());
                let ends_line = more.last().is_some_and(|comment| comment.is_last)
                    || (after.is_empty() && self.lexer.kind() == Some(Kind::Close));
                let has_room =
                    pending.is_empty() && trailing.last().is_none_or(|comment: &Comment| comment.form != Form::Line);
                let moved_to = if ends_line && has_room { &mut trailing } else { &mut pending };
                moved_to.append(&mut more);
                pending.extend(after);
            }
            entry.with(|comments| &mut comments.trailing, trailing);
            entries.push(entry);
        }
        self.lexer.take_if(Kind::Close);
        let mut container = Container { is_object, entries, open_comments, end_comments: pending, flat_chars: None };
        container.flat_chars = self.flat_chars(&container);
        container
    }

    fn flat_chars(&self, container: &Container) -> Option<usize> {
        let Container { is_object, entries, open_comments, end_comments, flat_chars: _ } = container;
        let needs_lines = |comment: &Comment| comment.is_own_line();
        let is_split = !open_comments.is_empty()
            || (!entries.is_empty() && !end_comments.is_empty())
            || end_comments.iter().any(needs_lines)
            || entries.iter().filter_map(Entry::comments).any(|comments| comments.leading.iter().any(needs_lines));
        if is_split {
            return None;
        }
        let comments = width::of_comments(self.text, end_comments)?.saturating_sub(1);
        let pads = if *is_object && !container.is_bare() { 2 } else { 0 };
        let separators = 2 * entries.len().saturating_sub(1);
        entries
            .iter()
            .try_fold(2 + pads + separators + comments, |chars, entry| Some(chars + width::of_entry(self.text, entry)?))
    }
}

impl Entry {
    /// Adds comments.
    fn with(&mut self, place: impl Fn(&mut Comments) -> &mut Vec<Comment>, comments: Vec<Comment>) {
        if !comments.is_empty() {
            place(self.comments.get_or_insert_default()).extend(comments);
        }
    }
}

/// Comments on the line of the token before them, and the others.
fn on_line(mut comments: Vec<Comment>) -> (Vec<Comment>, Vec<Comment>) {
    let count = comments.iter().take_while(|comment| comment.shares_start).count();
    let others = comments.split_off(count);
    (comments, others)
}
