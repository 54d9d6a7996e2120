//! `sdfarm new`: writes a first job file to start from.

use std::fs::File;
use std::io::{ErrorKind, Write};

use anyhow::Context;
use clap::Args;

use crate::error::UsageError;
use crate::terminal::{print_line, print_note};

/// The first scene: its comments explain the language.
const SCENE: &str = include_str!("new/scene.json");

/// Arguments of `new`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// File to write.
    #[arg(value_name = "FILE", default_value = "scene.json")]
    file: String,
}

/// Writes the job file.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let name = &arguments.file;
    let mut file = File::create_new(name).map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => {
            UsageError(format!("{name} exists, and was not replaced: give another name, as in `sdfarm new other.json`"))
        }
        ErrorKind::NotFound => UsageError(format!("could not write {name}: create its folder first")),
        _ => UsageError(format!("could not write {name}: {error}; write elsewhere")),
    })?;
    file.write_all(SCENE.as_bytes()).with_context(|| format!("could not write {name}: free some space there"))?;
    print_line(&format!("wrote {name}"))?;
    let picture = std::path::Path::new(name).with_extension("png");
    print_note(&format!(
        "next: `sdfarm check {name}` finds mistakes, `sdfarm render {name} -o {}` renders it;\n\
         `sdfarm schema > job.schema.json` lets editors complete it, docs/jobs.md has all fields",
        picture.display()
    ));
    Ok(())
}
