//! `sdfarm file`: saves a job's file as it was submitted.

use anyhow::Context;
use clap::Args;

use crate::arguments::ServerArguments;
use crate::job_name::JobName;
use crate::output_file::OutputFile;
use crate::terminal::print_note;

/// Arguments of `file`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    server: ServerArguments,
    /// File to write the job file to; - for standard output.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT", default_value = "-")]
    output: String,
}

/// Saves the job file.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let Arguments { id, server, output: path } = arguments;
    let client = server.client()?;
    let id = id.find(&client).await?;
    let mut output = OutputFile::create(&path)?;
    let size_bytes =
        client.file(id, output.file()).await.with_context(|| format!("could not fetch the file of job {id}"))?;
    output.commit()?;
    if path != "-" {
        print_note(&format!("wrote {path}: {size_bytes} bytes"));
    }
    Ok(())
}
