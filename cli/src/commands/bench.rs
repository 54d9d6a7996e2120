//! `sdfarm bench`: how fast this machine renders.

use clap::Args;

/// Arguments of `bench`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Job files, or names of shipped scenes.
    #[arg(value_name = "JOB")]
    jobs: Vec<String>,
}

/// Measures it.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    anyhow::bail!("nothing measures {:?} yet", arguments.jobs)
}
