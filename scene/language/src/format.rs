//! Formats the text of a job file: line breaks, indentation and spaces. Comments, the text of numbers and strings, and the
//! order of keys stay as they are.
//!
//! A list or an object that fits on a line is one line; a longer one has an entry on each line, but a list of numbers
//! fills its lines. A blank line between entries stays. The result depends only on the entries and their comments, so
//! formatting it again changes nothing.

mod entries;
mod lexer;
mod measure;
#[cfg(test)]
mod tests;

use std::ops::Range;

use self::entries::{Comment, Entries, Start};
use self::lexer::Kind;
use self::measure::{Measures, measure};
use crate::error::{Fault, ParseError};
use crate::limits::MAX_BODY_BYTES;
use crate::parse::formattable;

/// Maximum length of a line, in characters, unless one number, string or comment is longer.
const MAX_LINE_CHARS: usize = 100;
const INDENT: &str = "  ";

/// The text of a job, formatted. The job need not be valid, but must be JSON with comments and trailing commas.
///
/// # Errors
/// Fails at the position where the text is not JSON, nests too deep, or is not UTF-8, and if the result would be too
/// large for a job.
pub fn format(text: &[u8]) -> Result<String, ParseError> {
    // The nesting is bounded, so what follows may recurse.
    let tree = formattable(text)?;
    let (text, measures) = (tree.text(), measure(&tree).into_iter());
    let out = String::with_capacity(text.len());
    let mut printer = Printer { text, entries: Entries::new(&tree), measures, out, column: 0, depth: 0 };
    printer.file();
    if printer.out.len() <= MAX_BODY_BYTES {
        return Ok(printer.out);
    }
    let limit = MAX_BODY_BYTES >> 20;
    let message = format!("would be larger than {limit} MiB when formatted, the limit of a job: leave it as it is");
    Err(ParseError::Invalid(Fault::placed(text, vec![Fault { pointer: String::new(), message, at: Some(0) }])))
}

/// Formatted text so far.
struct Printer<'a> {
    text: &'a str,
    /// The rest of the tree, which is not printed yet.
    entries: Entries<'a>,
    /// Measures of the lists and objects that are not printed yet.
    measures: std::vec::IntoIter<Measures>,
    out: String,
    /// Characters of the last line.
    column: usize,
    /// Open lists and objects.
    depth: usize,
}

impl Printer<'_> {
    fn file(&mut self) {
        let leading = self.entries.comments();
        let end_comments = self.line_of(leading, false, "", true);
        self.comment_lines(&end_comments, false);
    }

    /// Prints an entry that has its lines for itself, with the comments before and after it. Returns the comments before
    /// the next.
    fn line_of(&mut self, leading: Vec<Comment>, has_key: bool, comma: &str, is_first: bool) -> Vec<Comment> {
        let start = self.entries.start(leading, has_key);
        self.comments_before(&start.leading, is_first);
        if self.column == 0 {
            self.begin_line(start.follows_blank && !(is_first && start.leading.is_empty()));
        }
        self.key(&start);
        self.value(comma.len());
        self.put(comma);
        let (trailing, pending) = self.entries.end();
        self.comments_after(&trailing);
        self.end_line();
        pending
    }

    fn comments_before(&mut self, comments: &[Comment], is_first: bool) {
        for (index, comment) in comments.iter().enumerate() {
            if self.column == 0 {
                self.begin_line(comment.follows_blank && !(is_first && index == 0));
            }
            self.put_comment(comment);
            if comment.is_own_line() {
                self.end_line();
            } else {
                self.put(" ");
            }
        }
    }

    fn comments_after(&mut self, comments: &[Comment]) {
        for comment in comments {
            self.put(" ");
            self.put_comment(comment);
        }
    }

    fn comment_lines(&mut self, comments: &[Comment], is_first: bool) {
        for (index, comment) in comments.iter().enumerate() {
            self.begin_line(comment.follows_blank && !(is_first && index == 0));
            self.put_comment(comment);
            self.end_line();
        }
    }

    fn key(&mut self, start: &Start) {
        if let Some(key) = &start.key {
            self.put_text(key.clone());
            self.put(": ");
        }
        for comment in &start.inside {
            self.put_comment(comment);
            self.put(" ");
        }
    }

    /// Prints a value, on one line if it fits there. The job is never on one line.
    fn value(&mut self, comma_chars: usize) {
        let Some(token) = self.entries.value() else { return };
        let column = self.column;
        self.put_text(token.range.clone());
        let Some(measures) = (token.kind == Kind::Open).then(|| self.measures.next()).flatten() else { return };
        let is_object = self.text[token.range].starts_with('{');
        let fits = |chars: u32| self.depth > 0 && column + chars as usize + comma_chars <= MAX_LINE_CHARS;
        if measures.flat_chars.is_some_and(|chars| measures.entries == 0 || fits(chars)) {
            self.flat(is_object, measures.entries);
        } else {
            self.broken(is_object, measures);
        }
        self.entries.close();
        self.put(if is_object { "}" } else { "]" });
    }

    /// Prints the entries of a list or an object on one line.
    fn flat(&mut self, is_object: bool, count: u32) {
        let (_, mut pending) = self.entries.open();
        let pad = if is_object && (count > 0 || !pending.is_empty()) { " " } else { "" };
        self.put(pad);
        for index in 0..count {
            self.put(if index == 0 { "" } else { ", " });
            let start = self.entries.start(pending, is_object);
            self.comments_before(&start.leading, true);
            self.key(&start);
            self.value(0);
            let (trailing, after) = self.entries.end();
            self.comments_after(&trailing);
            pending = after;
        }
        for (index, comment) in pending.iter().enumerate() {
            self.put(if index == 0 { "" } else { " " });
            self.put_comment(comment);
        }
        self.put(pad);
    }

    /// Prints the entries of a list or an object on several lines.
    fn broken(&mut self, is_object: bool, measures: Measures) {
        let (open_comments, mut pending) = self.entries.open();
        self.comments_after(&open_comments);
        self.end_line();
        self.depth += 1;
        if measures.is_filled {
            self.filled(measures.entries);
        } else {
            for index in 0..measures.entries {
                let comma = if index + 1 == measures.entries { "" } else { "," };
                pending = self.line_of(pending, is_object, comma, index == 0);
            }
            self.comment_lines(&pending, measures.entries == 0);
        }
        self.depth -= 1;
        self.begin_line(false);
    }

    /// Prints the entries of a list with as many on a line as fit.
    fn filled(&mut self, count: u32) {
        for index in 0..count {
            let comma = if index + 1 == count { "" } else { "," };
            if self.column > 0 && self.column + 1 + self.next_chars() + comma.len() > MAX_LINE_CHARS {
                self.end_line();
            }
            if self.column == 0 {
                self.begin_line(false);
            } else {
                self.put(" ");
            }
            self.value(comma.len());
            self.entries.end();
            self.put(comma);
        }
        self.end_line();
    }

    /// Length of the next value on one line.
    fn next_chars(&self) -> usize {
        match (self.entries.peek(), self.measures.as_slice()) {
            (Some(token), [next, ..]) if token.kind == Kind::Open => next.flat_chars.unwrap_or(0) as usize,
            (Some(token), _) => self.text[token.range.clone()].chars().count(),
            (None, _) => 0,
        }
    }

    fn begin_line(&mut self, is_after_blank: bool) {
        if is_after_blank {
            self.out.push('\n');
        }
        for _ in 0..self.depth {
            self.put(INDENT);
        }
    }

    fn end_line(&mut self) {
        self.out.push('\n');
        self.column = 0;
    }

    fn put(&mut self, text: &str) {
        // Too large a text is refused, so the rest of it needs no memory.
        if self.out.len() <= MAX_BODY_BYTES {
            self.out.push_str(text);
        }
        self.column += text.chars().count();
    }

    fn put_text(&mut self, range: Range<usize>) {
        let text = self.text;
        self.put(&text[range]);
    }

    /// Prints a comment. Later lines that begin with a star are aligned with the first.
    fn put_comment(&mut self, comment: &Comment) {
        let text = self.text;
        let mut lines = text[comment.range.clone()].split('\n').map(str::trim_ascii_end);
        self.put(lines.next().unwrap_or_default());
        let has_stars = lines.clone().all(|line| line.trim_ascii_start().starts_with('*'));
        for line in lines {
            self.end_line();
            if has_stars {
                self.begin_line(false);
                self.put(" ");
            }
            self.put(if has_stars { line.trim_ascii_start() } else { line });
        }
    }
}
