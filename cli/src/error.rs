//! Errors as messages on standard error and as exit codes.

use proto::problem::ValidationErrorView;
use proto::worker_protocol::EXIT_UNUSABLE_DEVICE;
use proto::{ClientError, Problem};

use crate::terminal::{escape_line, print_note};

const EXIT_FAILURE: u8 = 1;
const EXIT_USAGE: u8 = 2;

/// Usage error: an invalid flag or file. The message has the fix.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct UsageError(pub(crate) String);

/// A worker's device cannot render; restarting the worker would not help.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct UnusableDevice(pub(crate) anyhow::Error);

/// Jobs that were compared differ: the exit code says so, and no message.
#[derive(Debug, thiserror::Error)]
#[error("the jobs differ")]
pub(crate) struct JobsDiffer;

/// A verified picture differs: the exit code says so, and no message.
#[derive(Debug, thiserror::Error)]
#[error("the picture differs")]
pub(crate) struct PictureDiffers;

/// Invalid job file, with its errors.
#[derive(Debug, thiserror::Error)]
#[error("{} {}: {}; fix the file and try again", .file, count(.faults.len()), .consequence)]
pub(crate) struct InvalidJob {
    /// The file, as the user named it.
    pub(crate) file: String,
    /// The consequence, as in "nothing was rendered".
    pub(crate) consequence: &'static str,
    /// Its errors.
    pub(crate) faults: Vec<ValidationErrorView>,
}

fn count(faults: usize) -> String {
    if faults == 1 { "has 1 error".to_owned() } else { format!("has {faults} errors") }
}

/// Prints the error to standard error, and returns the exit code.
pub(crate) fn report(error: &anyhow::Error) -> u8 {
    if let Some(bad) = error.downcast_ref::<InvalidJob>() {
        for fault in &bad.faults {
            print_note(&line(&bad.file, fault));
        }
    }
    if !error.is::<JobsDiffer>() && !error.is::<PictureDiffers>() {
        print_note(&format!("error: {}", message(error)));
    }
    exit_code(error)
}

/// Formats one error like a compiler: `FILE:LINE:COLUMN: pointer: message`.
fn line(file: &str, fault: &ValidationErrorView) -> String {
    let ValidationErrorView { pointer, message, line, column } = fault;
    let place = if pointer.is_empty() { String::new() } else { format!("{}: ", escape_line(pointer)) };
    format!("{file}:{line}:{column}: {place}{}", escape_line(message))
}

/// Formats the error and its causes as one line. Of an HTTP client's long chain, only the root is printed.
fn message(error: &anyhow::Error) -> String {
    let mut words = String::new();
    let mut after_client = false;
    for cause in error.chain() {
        let text = if after_client { error.root_cause().to_string() } else { cause.to_string() };
        // The lines of a usage error are this program's own.
        let text = if cause.is::<UsageError>() { text } else { escape_line(&text).into_owned() };
        if words.is_empty() {
            words = text;
        } else if !words.contains(&text) {
            words = format!("{words}: {text}");
        }
        if after_client {
            break;
        }
        after_client = cause.is::<ClientError>();
    }
    words
}

fn exit_code(error: &anyhow::Error) -> u8 {
    if error.is::<UsageError>() || error.is::<InvalidJob>() {
        return EXIT_USAGE;
    }
    if error.is::<UnusableDevice>() {
        return EXIT_UNUSABLE_DEVICE;
    }
    match error.downcast_ref::<ClientError>() {
        Some(ClientError::Auth(_)) => EXIT_USAGE,
        Some(ClientError::Problem(problem)) if is_bad_input(problem) => EXIT_USAGE,
        Some(_) | None => EXIT_FAILURE,
    }
}

fn is_bad_input(problem: &Problem) -> bool {
    matches!(problem.status, 400 | 413 | 415 | 422)
}
