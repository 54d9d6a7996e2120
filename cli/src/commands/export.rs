//! `sdfarm export`: writes a job in the format of another render farm.

mod openjd;

use std::io::Write;
use std::path::Path;

use anyhow::Context;
use clap::{Args, Subcommand};

use crate::arguments::DeviceChoice;
use crate::job_file::JobFile;
use crate::output_file::OutputFile;
use crate::terminal::print_note;

/// Arguments of `export`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    format: ExportFormat,
}

#[derive(Debug, Subcommand)]
enum ExportFormat {
    /// Write an Open Job Description template: a task for each frame, rendered by `sdfarm render`.
    Openjd(Openjd),
}

#[derive(Debug, Args)]
struct Openjd {
    /// The job file; - for standard input.
    job: String,
    /// File for the template; - for standard output. The template names the job file relative to this file's folder.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT", default_value = "-")]
    output: String,
    /// Device to render on: auto, cpu or cuda. With cuda, each task requires a host with a GPU.
    #[arg(long, env = "SDFARM_DEVICE", default_value = "auto")]
    device: DeviceChoice,
}

/// Writes the job.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let ExportFormat::Openjd(Openjd { job: path, output: output_path, device }) = &arguments.format;
    let job = JobFile::read(path)?.parse()?;
    let device = openjd::Device::try_from(*device)?;
    let job_file = (path != "-").then(|| relative(path, output_path)).transpose()?.flatten();
    let text = serde_json::to_string_pretty(&openjd::template(&job, job_file.as_deref(), device))?;
    let mut output = OutputFile::create(output_path)?;
    writeln!(output.file(), "{text}").with_context(|| format!("could not write {output_path}"))?;
    output.commit()?;
    if job_file.is_none() {
        print_note("the job file is not in the template's folder: give its path as the parameter JobFile");
    }
    Ok(())
}

/// Path of the job file from the template's folder; none if it is not in it. A template on standard output belongs to
/// the current folder.
fn relative(job: &str, template: &str) -> anyhow::Result<Option<String>> {
    let folder = match Path::new(template).parent() {
        Some(folder) if template != "-" && folder != Path::new("") => folder,
        Some(_) | None => Path::new("."),
    };
    let absolute = |path: &Path| path.canonicalize().with_context(|| format!("could not find {}", path.display()));
    let (job, folder) = (absolute(Path::new(job))?, absolute(folder)?);
    Ok(job.strip_prefix(folder).ok().and_then(Path::to_str).map(str::to_owned))
}
