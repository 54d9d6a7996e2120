//! Reads keys and comments around the values of a tree.
//!
//! A comment on the line of a value belongs to that value; other comments belong to what comes after them.

use std::ops::Range;

use super::lexer::{Kind, Lexer, Token};
use crate::json::Tree;

/// A comment.
#[derive(Clone, Debug)]
pub(super) struct Comment {
    /// Its bytes in the text.
    pub range: Range<usize>,
    form: Form,
    /// Whether a blank line is before it.
    pub follows_blank: bool,
    /// Whether something else is before it on its line.
    shares_start: bool,
    /// Whether nothing is after it on its line.
    is_last: bool,
}

/// Form of a comment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
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

/// Start of an entry, before its value.
#[derive(Debug)]
pub(super) struct Start {
    /// Comments before the entry.
    pub leading: Vec<Comment>,
    /// Bytes of the key, with its quotes; none in a list.
    pub key: Option<Range<usize>>,
    /// Comments between key and value: blocks on one line.
    pub inside: Vec<Comment>,
    /// Whether a blank line is before the entry.
    pub follows_blank: bool,
}

/// Reads a tree in the order of its text.
#[derive(Debug)]
pub(super) struct Entries<'a> {
    text: &'a str,
    lexer: Lexer<'a>,
}

impl<'a> Entries<'a> {
    pub(super) fn new(tree: &'a Tree<'a>) -> Self {
        Self { text: tree.text(), lexer: Lexer::new(tree) }
    }

    /// The next token.
    pub(super) fn peek(&self) -> Option<&Token> {
        self.lexer.peek()
    }

    /// Takes the comments before the next other token.
    pub(super) fn comments(&mut self) -> Vec<Comment> {
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

    /// Reads up to the value of an entry, whose first comments have been read.
    pub(super) fn start(&mut self, mut leading: Vec<Comment>, has_key: bool) -> Start {
        let mut follows_blank = self.lexer.peek().is_some_and(|next| next.breaks > 1);
        let (mut key, mut between) = (None, Vec::new());
        if has_key {
            key = self.lexer.take_if(Kind::Scalar).map(|key| key.range);
            between = self.comments();
            self.lexer.take_if(Kind::Colon);
            between.extend(self.comments());
        }
        // A comment that cannot be on the line of its value is moved before the key, and those before it, too.
        let last = between.iter().rposition(|comment| !comment.is_block());
        let inside = between.split_off(last.map_or(0, |last| last + 1));
        for comment in &mut between {
            comment.follows_blank = std::mem::take(&mut follows_blank);
        }
        leading.append(&mut between);
        Start { leading, key, inside, follows_blank }
    }

    /// Takes a value, or the opening bracket of one.
    pub(super) fn value(&mut self) -> Option<Token> {
        self.lexer.take()
    }

    /// Reads after an opening bracket: the comments on its line, and the comments before the first entry or the end.
    pub(super) fn open(&mut self) -> (Vec<Comment>, Vec<Comment>) {
        let (mut on_line, mut pending) = on_line(self.comments());
        if on_line.last().is_some_and(|comment| !comment.is_last) {
            on_line.append(&mut pending);
            pending = std::mem::take(&mut on_line);
        }
        (on_line, pending)
    }

    /// Reads after a value, with its comma: the comments on its line, and the comments before the next entry or the end.
    pub(super) fn end(&mut self) -> (Vec<Comment>, Vec<Comment>) {
        let (mut trailing, mut pending) = on_line(self.comments());
        if self.lexer.take_if(Kind::Comma).is_some() {
            let (mut more, after) = on_line(self.comments());
            let ends_line = more.last().is_some_and(|comment| comment.is_last)
                || (after.is_empty() && self.lexer.kind() == Some(Kind::Close));
            let has_room = pending.is_empty() && trailing.last().is_none_or(|comment| comment.form != Form::Line);
            let moved_to = if ends_line && has_room { &mut trailing } else { &mut pending };
            moved_to.append(&mut more);
            pending.extend(after);
        }
        (trailing, pending)
    }

    /// Takes a closing bracket, if it is next.
    pub(super) fn close(&mut self) -> bool {
        self.lexer.take_if(Kind::Close).is_some() || self.lexer.peek().is_none()
    }
}

/// Comments on the line of the token before them, and the others.
fn on_line(mut comments: Vec<Comment>) -> (Vec<Comment>, Vec<Comment>) {
    let count = comments.iter().take_while(|comment| comment.shares_start).count();
    let others = comments.split_off(count);
    (comments, others)
}
