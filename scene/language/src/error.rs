//! Errors in a job, with their position in the text.

use std::fmt;

use crate::json::{Tree, Value};

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

/// An error in a tree, before its line and column are known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Fault {
    /// JSON pointer.
    pub pointer: String,
    /// The problem, and the fix.
    pub message: String,
    /// Byte offset in the tree; none if nothing is at the pointer.
    pub at: Option<usize>,
}

impl Fault {
    /// Error at the value at a pointer.
    pub(crate) fn at_value(tree: &Tree<'_>, pointer: String, message: impl Into<String>) -> Self {
        let at = tree.value_at(&pointer).map(Value::start);
        Self { pointer, message: message.into(), at }
    }

    /// Error at the key of the value at a pointer.
    pub(crate) fn at_key(tree: &Tree<'_>, pointer: String, message: String) -> Self {
        let at = tree.key_at(&pointer).map(Value::start);
        Self { pointer, message, at }
    }

    /// Errors with their positions in the text.
    pub(crate) fn placed(text: &str, faults: Vec<Self>) -> Vec<ValidationError> {
        let lines = LineIndex::new(text);
        let place = |Self { pointer, message, at }| lines.fault(at.unwrap_or(0), pointer, message);
        faults.into_iter().map(place).collect()
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
