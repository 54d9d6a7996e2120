//! `sdfarm diff`: says in words how two jobs differ, and whether their pictures do.

mod compare;
mod pictures;
mod words;

use clap::Args;
use serde_json::{Value, json};

use self::compare::{Change, Difference};
use self::pictures::Pictures;
use crate::error::JobsDiffer;
use crate::job_file::JobFile;
use crate::terminal::print_line;

/// Arguments of `diff`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job file before; - for standard input.
    #[arg(value_name = "BEFORE")]
    before: String,
    /// The job file after; - for standard input.
    #[arg(value_name = "AFTER")]
    after: String,
    /// Print the differences as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Compares the jobs; fails with exit code 1 if they differ.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let (before, after) = (JobFile::read(&arguments.before)?, JobFile::read(&arguments.after)?);
    let pictures = Pictures::compare(&before.parse()?, &after.parse()?);
    let (before, after) = (value(&before)?, value(&after)?);
    let differences = compare::differences(&before, &after);
    if arguments.json {
        let list: Vec<Value> = differences.iter().map(as_json).collect();
        print_line(&format!("{:#}", json!({ "differences": list, "pictures": pictures })))?;
    } else {
        for difference in &differences {
            print_line(&words::line(difference))?;
        }
        print_line(&pictures.words())?;
    }
    if differences.is_empty() { Ok(()) } else { Err(JobsDiffer.into()) }
}

fn value(file: &JobFile) -> anyhow::Result<Value> {
    // The file is a valid job, so it is UTF-8.
    Ok(serde_json::from_str(&scene::plain_json(std::str::from_utf8(&file.text)?))?)
}

fn as_json(difference: &Difference<'_>) -> Value {
    let Difference { path, change } = difference;
    let path = path.as_str();
    match change {
        Change::Added(value) => json!({ "path": path, "change": "added", "to": value }),
        Change::Removed(value) => json!({ "path": path, "change": "removed", "from": value }),
        Change::Changed(from, to) => json!({ "path": path, "change": "changed", "from": from, "to": to }),
    }
}
