//! `sdfarm fmt`: formats job files, and keeps their comments.

use std::fs;
use std::io::Write;

use anyhow::Context;
use clap::Args;

use crate::counted::counted_len;
use crate::error::report;
use crate::job_file::JobFile;
use crate::output_file::OutputFile;
use crate::terminal::{print_line, print_note, write_bytes};

/// Arguments of `fmt`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job files; - for standard input, formatted to standard output.
    #[arg(value_name = "JOB", required = true)]
    jobs: Vec<String>,
    /// Change no file: print the names of files that would change, and fail if there are any.
    #[arg(long, env = "SDFARM_CHECK", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    check: bool,
}

/// Formats the files. A file that is not JSON does not keep the others from being formatted.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let mut changed = Vec::new();
    let mut failed: Option<anyhow::Error> = None;
    for path in &arguments.jobs {
        match format(path, arguments.check) {
            Ok(Some(name)) => changed.push(name),
            Ok(None) => {}
            Err(error) => {
                if let Some(earlier) = failed.replace(error) {
                    report(&earlier);
                }
            }
        }
    }
    if arguments.check {
        for name in &changed {
            print_line(name)?;
        }
    }
    match failed {
        Some(error) => Err(error),
        None if arguments.check && !changed.is_empty() => {
            let files = counted_len(changed.len(), "file");
            anyhow::bail!("{files} would change: `sdfarm fmt {}` formats", changed.join(" "))
        }
        None => Ok(()),
    }
}

/// Formats a file; returns its name if its text changes.
fn format(path: &str, is_check: bool) -> anyhow::Result<Option<String>> {
    let file = JobFile::read(path)?;
    let formatted = file.format()?;
    let is_changed = formatted.as_bytes() != file.text;
    if !is_check && path == "-" {
        write_bytes(formatted.as_bytes())?;
    } else if !is_check && is_changed {
        let context = || format!("could not write {path}");
        let mut output = OutputFile::create(path)?;
        output.file().write_all(formatted.as_bytes()).with_context(context)?;
        let permissions = fs::metadata(path).with_context(context)?.permissions();
        output.file().set_permissions(permissions).with_context(context)?;
        output.commit()?;
        print_note(&format!("formatted {path}"));
    }
    Ok(is_changed.then_some(file.name))
}
