//! Errors in a job, with their position in the text.

use std::fmt;

use crate::json_scan;

/// One error in a job, with its position in the text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ValidationError {
    /// JSON pointer (RFC 6901): to an unknown or duplicate member itself, or to the parent of a missing one.
    pub pointer: String,
    /// The problem, and the fix.
    pub message: String,
    /// Line in the text, from 1.
    pub line: u32,
    /// Column in the line, from 1, in bytes.
    pub column: u32,
}

impl ValidationError {
    /// Error at the value at `pointer` in `text`.
    pub(crate) fn at_value(text: &str, pointer: String, message: impl Into<String>) -> Self {
        let offset = json_scan::locate_value(text, &pointer);
        Self::at(text, offset, pointer, message)
    }

    /// Errors at the values at some pointers in `text`, found in one scan of it.
    pub(crate) fn at_values(text: &str, errors: Vec<(String, String)>) -> Vec<Self> {
        let pointers: Vec<&str> = errors.iter().map(|(pointer, _)| pointer.as_str()).collect();
        let offsets = json_scan::locate_values(text, &pointers);
        let lines = LineIndex::new(text);
        let place =
            |((pointer, message), offset): (_, Option<usize>)| lines.fault(offset.unwrap_or(0), pointer, message);
        errors.into_iter().zip(offsets).map(place).collect()
    }

    /// Error at the member name at `pointer` in `text`.
    pub(crate) fn at_member(text: &str, pointer: String, message: impl Into<String>) -> Self {
        let offset = json_scan::locate_member(text, &pointer);
        Self::at(text, offset, pointer, message)
    }

    /// Error at a byte offset of `text`.
    pub(crate) fn at(text: &str, offset: Option<usize>, pointer: String, message: impl Into<String>) -> Self {
        let (line, column) = line_and_column(text, offset.unwrap_or(0));
        Self { pointer, message: message.into(), line, column }
    }
}

impl fmt::Display for ValidationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { pointer, message, line, column } = self;
        if pointer.is_empty() {
            write!(f, "{line}:{column}: {message}")
        } else {
            write!(f, "{line}:{column}: {pointer}: {message}")
        }
    }
}

/// Reason why a text is not a job.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ParseError {
    /// Not JSON, or not UTF-8.
    #[error("the job is not JSON: {0}")]
    NotJson(ValidationError),
    /// JSON, but not a valid job: every error, in the order of their positions.
    #[error("the job is invalid: {}", list(.0))]
    Invalid(Vec<ValidationError>),
}

fn list(faults: &[ValidationError]) -> String {
    faults.iter().map(ValidationError::to_string).collect::<Vec<_>>().join("; ")
}

/// Byte offsets of the lines of a text, for finding the positions of many errors.
#[derive(Debug)]
pub(crate) struct LineIndex {
    starts: Vec<usize>,
}

impl LineIndex {
    /// Finds the lines of a text.
    pub(crate) fn new(text: &str) -> Self {
        let ends = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n');
        Self { starts: std::iter::once(0).chain(ends.map(|(end, _)| end + 1)).collect() }
    }

    /// Byte offset of a line and a column, both from 1.
    pub(crate) fn offset(&self, line: usize, column: usize) -> usize {
        self.starts.get(line.saturating_sub(1)).copied().unwrap_or(0) + column.saturating_sub(1)
    }

    /// Error at a byte offset of the text.
    pub(crate) fn fault(&self, offset: usize, pointer: String, message: String) -> ValidationError {
        let line = self.starts.partition_point(|&start| start <= offset).max(1);
        let column = offset - self.starts[line - 1] + 1;
        ValidationError { pointer, message, line: line as u32, column: column as u32 }
    }
}

/// Line and column, both from 1, of a byte offset of `text`.
fn line_and_column(text: &str, offset: usize) -> (u32, u32) {
    let before = &text.as_bytes()[..offset.min(text.len())];
    let line = before.split(|&byte| byte == b'\n').count();
    let column = before.iter().rev().take_while(|&&byte| byte != b'\n').count() + 1;
    (line as u32, column as u32)
}
