//! Prints lines to standard output and standard error.
//!
//! A reader that has closed the pipe (`sdfarm jobs | head -1`) causes no error and no panic.

use std::io::{ErrorKind, Write};

use anyhow::Context;

/// Prints a result to standard output.
pub(crate) fn print_line(text: &str) -> anyhow::Result<()> {
    write_bytes(format!("{text}\n").as_bytes())
}

/// Writes bytes to standard output.
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
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}
