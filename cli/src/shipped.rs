//! The shipped job files, by name.

pub(crate) use server::shipped_scenes::{hash, names};

use crate::error::UsageError;

/// Job file of a shipped scene.
pub(crate) fn job_file(name: &str) -> anyhow::Result<Vec<u8>> {
    let unknown = || UsageError(format!("no scene {name:?} is shipped: there are {}", names().join(", ")));
    Ok(server::shipped_scenes::job_file(name).ok_or_else(unknown)?)
}
