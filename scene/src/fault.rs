//! Errors in a job, with their place in the text.

use std::fmt;

use crate::outline;

/// One error in a job, with its place in the text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// JSON pointer (RFC 6901): to the key where it is unknown or doubled, to the parent where one is missing.
    pub pointer: String,
    /// What is wrong, and the fix.
    pub message: String,
    /// Line in the text, from 1.
    pub line: u32,
    /// Column in the line, from 1, in bytes.
    pub column: u32,
}

impl Fault {
    /// Error at the value at `pointer` in `text`.
    pub(crate) fn of_value(text: &str, pointer: String, message: impl Into<String>) -> Self {
        let offset = outline::locate_value(text, &pointer);
        Self::at(text, offset, pointer, message)
    }

    /// Error at the member name at `pointer` in `text`.
    pub(crate) fn of_key(text: &str, pointer: String, message: impl Into<String>) -> Self {
        let offset = outline::locate_key(text, &pointer);
        Self::at(text, offset, pointer, message)
    }

    /// Error at a byte offset of `text`.
    pub(crate) fn at(text: &str, offset: Option<usize>, pointer: String, message: impl Into<String>) -> Self {
        let (line, column) = line_and_column(text, offset.unwrap_or(0));
        Self { pointer, message: message.into(), line, column }
    }
}

impl fmt::Display for Fault {
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
pub enum Refusal {
    /// Not JSON, or not UTF-8.
    #[error("the job is not JSON: {0}")]
    NotJson(Fault),
    /// JSON, but not a job: the first fault of form, or every fault of meaning.
    #[error("the job is wrong: {}", list(.0))]
    Wrong(Vec<Fault>),
}

fn list(faults: &[Fault]) -> String {
    faults.iter().map(Fault::to_string).collect::<Vec<_>>().join("; ")
}

/// Line and column, both from 1, of a byte of `text`.
fn line_and_column(text: &str, offset: usize) -> (u32, u32) {
    let before = &text.as_bytes()[..offset.min(text.len())];
    let line = before.split(|&byte| byte == b'\n').count();
    let column = before.iter().rev().take_while(|&&byte| byte != b'\n').count() + 1;
    (line as u32, column as u32)
}
