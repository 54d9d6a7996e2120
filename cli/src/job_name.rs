//! Finds the job that a user names: by its id, a part of the id, its name, or as the latest one.

use std::convert::Infallible;
use std::str::FromStr;

use proto::{Client, JobId};

use crate::error::UsageError;
use crate::follow;

/// Maximum number of candidates listed if a name is ambiguous.
const LISTED: u32 = 10;

/// A user's name for a job.
#[derive(Clone, Debug)]
pub(crate) struct JobName(String);

impl FromStr for JobName {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self(text.to_owned()))
    }
}

impl JobName {
    /// Finds the only job that matches. A complete id is used as it is, without asking the server.
    pub(crate) async fn find(&self, client: &Client) -> anyhow::Result<JobId> {
        let Self(text) = self;
        if let Ok(id) = text.parse() {
            return Ok(id);
        }
        let found = client.jobs_like(text, LISTED + 1).await?.jobs;
        match &found[..] {
            [job] => Ok(job.id),
            [] => Err(UsageError(format!(
                "no job matches {text:?}: give its id, four or more of its first or last characters, its name, or \
                 latest; `sdfarm jobs` lists them"
            ))
            .into()),
            several => {
                let mut lines: Vec<String> = several.iter().take(LISTED as usize).map(follow::line).collect();
                if several.len() > LISTED as usize {
                    lines.push("and others".to_owned());
                }
                let lines = lines.join("\n  ");
                Err(UsageError(format!("{text:?} matches several jobs: give the id of one\n  {lines}")).into())
            }
        }
    }
}
