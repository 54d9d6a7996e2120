//! The program under test, and its inputs: shipped scenes, job files, and folders of temporary farms.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;
use clap::Args;
use server::shipped_scenes;
use tempfile::TempDir;

/// The program under test.
#[derive(Debug, Args)]
pub(crate) struct Program {
    /// The sdfarm to drive [default: the one beside this program].
    #[arg(long = "sdfarm", value_name = "FILE", global = true)]
    file: Option<PathBuf>,
    /// Variables of its processes.
    #[arg(skip)]
    environment: Vec<(String, String)>,
}

impl Program {
    pub(crate) fn set_environment<'a>(&mut self, variables: impl IntoIterator<Item = (&'a str, String)>) {
        self.environment = variables.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    }

    /// Its file.
    pub(crate) fn file(&self) -> anyhow::Result<PathBuf> {
        if let Some(file) = &self.file {
            return Ok(file.clone());
        }
        let beside = std::env::current_exe().context("could not find this program")?.with_file_name("sdfarm");
        anyhow::ensure!(beside.is_file(), "{} is missing: build it, or name another with --sdfarm", beside.display());
        Ok(beside)
    }

    /// A command of it, without variables that set its flags.
    pub(crate) fn command(&self) -> anyhow::Result<Command> {
        let mut command = Command::new(self.file()?);
        for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("SDFARM_")) {
            command.env_remove(name);
        }
        command.envs(self.environment.iter().map(|(name, value)| (name, value)));
        Ok(command)
    }
}

/// Text of the job file with this name, otherwise of the shipped scene.
pub(crate) fn job_text(name: &str) -> anyhow::Result<Vec<u8>> {
    if Path::new(name).exists() {
        return std::fs::read(name).with_context(|| format!("could not read {name}"));
    }
    let unknown =
        || format!("no file and no shipped scene is named {name}: there are {}", shipped_scenes::names().join(", "));
    shipped_scenes::job_file(name).with_context(unknown)
}

/// Folder for a farm that is deleted with it; only its owner can read it.
pub(crate) fn temporary_farm_folder() -> anyhow::Result<TempDir> {
    let folder = tempfile::Builder::new().permissions(Permissions::from_mode(0o700)).tempdir();
    folder.context("could not create a folder for the farm: free some space there")
}
