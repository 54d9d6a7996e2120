//! Prints lines to standard output and standard error. Control characters are shown as escapes, because names and
//! messages come from others; where a new line would forge a line, the caller escapes it with `escape_line`.
//!
//! A reader that has closed the pipe (`sdfarm jobs | head -1`) causes no error and no panic.

use std::io::{ErrorKind, Write};

use anyhow::Context;
pub(crate) use proto::plain_text::escape_line;
use proto::plain_text::escape_lines;

/// Prints a result to standard output.
pub(crate) fn print_line(text: &str) -> anyhow::Result<()> {
    write_bytes(format!("{}\n", escape_lines(text)).as_bytes())
}

/// Writes bytes to standard output, unchanged.
pub(crate) fn write_bytes(bytes: &[u8]) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error).context("could not write to standard output"),
        Ok(()) | Err(_) => Ok(()),
    }
}

/// Prints a remark to standard error.
pub(crate) fn print_note(text: &str) {
    // If standard error is closed, the line is dropped.
    let _ = writeln!(std::io::stderr().lock(), "{}", escape_lines(text));
}
