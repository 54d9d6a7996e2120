//! Reads a job file, and reports every error with its line and column.

use std::fs::File;
use std::io::Read;

use proto::ClientError;
use proto::problem::ValidationErrorView;
use scene::{Job, ParseError};

use crate::error::{InvalidJob, UsageError};

/// Text of a job file, with its name for messages.
#[derive(Debug)]
pub(crate) struct JobFile {
    /// The file, as the user named it.
    pub(crate) name: String,
    /// Its content.
    pub(crate) text: Vec<u8>,
}

impl JobFile {
    /// Reads a file, or standard input for `-`.
    pub(crate) fn read(path: &str) -> anyhow::Result<Self> {
        let name = if path == "-" { "<stdin>" } else { path }.to_owned();
        let limit = scene::limits::MAX_BODY_BYTES;
        let mut text = Vec::new();
        let bounded = limit as u64 + 1;
        let read = if path == "-" {
            std::io::stdin().lock().take(bounded).read_to_end(&mut text)
        } else {
            File::open(path).and_then(|file| file.take(bounded).read_to_end(&mut text))
        };
        read.map_err(|error| {
            UsageError(format!(
                "could not read the job file {name}: {error}; give an existing file, or - for standard input"
            ))
        })?;
        if text.len() > limit {
            return Err(UsageError(format!("{name} is too large: a job file has at most {} MiB", limit >> 20)).into());
        }
        Ok(Self { name, text })
    }

    /// Parses the job.
    pub(crate) fn parse(&self) -> anyhow::Result<Job> {
        scene::parse(&self.text).map_err(|refusal| self.refused(&refusal, "nothing was rendered"))
    }

    /// The text, formatted.
    pub(crate) fn format(&self) -> anyhow::Result<String> {
        scene::format(&self.text).map_err(|refusal| self.refused(&refusal, "it was not changed"))
    }

    fn refused(&self, refusal: &ParseError, consequence: &'static str) -> anyhow::Error {
        let faults = match refusal {
            ParseError::NotJson(fault) => vec![ValidationErrorView::from(fault)],
            ParseError::Invalid(faults) => faults.iter().map(ValidationErrorView::from).collect(),
        };
        InvalidJob { file: self.name.clone(), consequence, faults }.into()
    }

    /// Adds the file's name to a server's rejection.
    pub(crate) fn invalid(&self, error: ClientError) -> anyhow::Error {
        match error {
            ClientError::Problem(problem) if !problem.errors.is_empty() => {
                let (file, consequence) = (self.name.clone(), "nothing was rendered");
                InvalidJob { file, consequence, faults: problem.errors }.into()
            }
            other => anyhow::Error::new(other).context(format!("could not submit {}", self.name)),
        }
    }
}
