//! `sdfarm schema`: the JSON Schema of a job file, for editors and validators.

use clap::Args;

use crate::terminal::print_line;

/// Arguments of `schema`: none.
#[derive(Debug, Args)]
pub(crate) struct Arguments {}

/// Prints the schema.
pub(crate) fn run(_: &Arguments) -> anyhow::Result<()> {
    print_line(&serde_json::to_string_pretty(&scene::editor_schema())?)
}
