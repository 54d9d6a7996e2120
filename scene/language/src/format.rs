//! Formats the text of a job file: line breaks, indentation and spaces. Comments, the text of numbers and strings, and the
//! order of keys stay as they are.
//!
//! A list or an object that fits on a line is one line; a longer one has an entry on each line, but a list of numbers
//! fills its lines. A blank line between entries stays. The result depends only on the entries and their comments, so
//! formatting it again changes nothing.

mod lexer;
#[cfg(test)]
mod tests;
mod tree;
mod width;

use self::tree::{Comment, Container, Entry, Value};
use crate::error::ParseError;
use crate::parse::formattable;

/// Maximum length of a line, in characters, unless one number, string or comment is longer.
const MAX_LINE_CHARS: usize = 100;
const INDENT: &str = "  ";
/// Maximum length of a list of numbers that shares its line with others of a longer list.
const MAX_FILLED_CHARS: usize = 40;

/// The text of a job, formatted. The job need not be valid, but must be JSON with comments and trailing commas.
///
/// # Errors
/// Fails at the position where the text is not JSON, nests too deep, or is not UTF-8.
pub fn format(text: &[u8]) -> Result<String, ParseError> {
    // The nesting is bounded, so what follows may recurse.
    let tree = formattable(text)?;
    let (file, text) = (tree::read(&tree), tree.text());
    let mut printer = Printer { text, out: String::with_capacity(text.len()), column: 0, depth: 0 };
    printer.file(&file);
    Ok(printer.out)
}

/// Formatted text so far.
struct Printer<'a> {
    text: &'a str,
    out: String,
    /// Characters of the last line.
    column: usize,
    /// Open lists and objects.
    depth: usize,
}

impl Printer<'_> {
    fn file(&mut self, file: &Container) {
        for (index, entry) in file.entries.iter().enumerate() {
            self.line_of(entry, index == 0, "");
        }
        self.comment_lines(&file.end_comments, file.entries.is_empty());
    }

    /// Prints an entry that has its lines for itself, with the comments before and after it.
    fn line_of(&mut self, entry: &Entry, is_first: bool, comma: &str) {
        let leading = entry.comments().map_or(&[][..], |comments| &comments.leading);
        self.comments_before(leading, is_first);
        if self.column == 0 {
            self.begin_line(entry.follows_blank && !(is_first && leading.is_empty()));
        }
        self.entry(entry, comma.len());
        self.put(comma);
        for comment in entry.comments().map_or(&[][..], |comments| &comments.trailing) {
            self.put(" ");
            self.put_comment(comment);
        }
        self.end_line();
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

    fn comment_lines(&mut self, comments: &[Comment], is_first: bool) {
        for (index, comment) in comments.iter().enumerate() {
            self.begin_line(comment.follows_blank && !(is_first && index == 0));
            self.put_comment(comment);
            self.end_line();
        }
    }

    /// Prints the key and the value of an entry.
    fn entry(&mut self, entry: &Entry, comma_chars: usize) {
        self.key(entry);
        match &entry.value {
            Value::Scalar(range) => self.put_text(range.clone()),
            Value::Container(container) => match container.flat_chars {
                Some(chars) if self.column + chars + comma_chars <= MAX_LINE_CHARS && !self.is_job() => {
                    self.flat(container);
                }
                Some(_) if container.entries.is_empty() => self.flat(container),
                _ => self.broken(container),
            },
        }
    }

    /// Whether the next value is the job: it is never on one line.
    fn is_job(&self) -> bool {
        self.depth == 0
    }

    fn key(&mut self, entry: &Entry) {
        if let Some(key) = &entry.key {
            self.put_text(key.clone());
            self.put(": ");
        }
        for comment in entry.comments().map_or(&[][..], |comments| &comments.inside) {
            self.put_comment(comment);
            self.put(" ");
        }
    }

    /// Prints a list or an object on one line.
    fn flat(&mut self, container: &Container) {
        self.put(container.open());
        let pad = if container.is_object && !container.is_bare() { " " } else { "" };
        self.put(pad);
        for (index, comment) in container.end_comments.iter().enumerate() {
            self.put(if index == 0 { "" } else { " " });
            self.put_comment(comment);
        }
        for (index, entry) in container.entries.iter().enumerate() {
            self.put(if index == 0 { "" } else { ", " });
            if let Some(comments) = entry.comments() {
                self.comments_before(&comments.leading, true);
            }
            self.key(entry);
            match &entry.value {
                Value::Scalar(range) => self.put_text(range.clone()),
                Value::Container(inside) => self.flat(inside),
            }
            for comment in entry.comments().map_or(&[][..], |comments| &comments.trailing) {
                self.put(" ");
                self.put_comment(comment);
            }
        }
        self.put(pad);
        self.put(container.close());
    }

    /// Prints a list or an object on several lines.
    fn broken(&mut self, container: &Container) {
        self.put(container.open());
        for comment in &container.open_comments {
            self.put(" ");
            self.put_comment(comment);
        }
        self.end_line();
        self.depth += 1;
        if container.is_filled(MAX_FILLED_CHARS) {
            self.filled(container);
        } else {
            let last = container.entries.len().saturating_sub(1);
            for (index, entry) in container.entries.iter().enumerate() {
                self.line_of(entry, index == 0, if index == last { "" } else { "," });
            }
            self.comment_lines(&container.end_comments, container.entries.is_empty());
        }
        self.depth -= 1;
        self.begin_line(false);
        self.put(container.close());
    }

    /// Prints the entries of a list with as many on a line as fit.
    fn filled(&mut self, container: &Container) {
        let last = container.entries.len().saturating_sub(1);
        for (index, entry) in container.entries.iter().enumerate() {
            let comma = if index == last { "" } else { "," };
            let chars = width::of_value(self.text, &entry.value).unwrap_or(0) + comma.len();
            if self.column > 0 && self.column + 1 + chars > MAX_LINE_CHARS {
                self.end_line();
            }
            if self.column == 0 {
                self.begin_line(false);
            } else {
                self.put(" ");
            }
            self.entry(entry, comma.len());
            self.put(comma);
        }
        self.end_line();
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
        self.out.push_str(text);
        self.column += text.chars().count();
    }

    fn put_text(&mut self, range: std::ops::Range<usize>) {
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
