//! How people name a job: by its id, by a part of it, by its name, or as the latest one.

use std::convert::Infallible;
use std::str::FromStr;

use proto::{Client, JobId};

use crate::error::UsageError;
use crate::follow;

/// Jobs that are listed where a name could mean several.
const LISTED: u32 = 10;

/// What a person calls a job.
#[derive(Clone, Debug)]
pub(crate) struct JobName(String);

impl FromStr for JobName {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self(text.to_owned()))
    }
}

impl JobName {
    /// The only job that is called so. A whole id is taken as it is, without asking the server.
    pub(crate) async fn find(&self, client: &Client) -> anyhow::Result<JobId> {
        let Self(text) = self;
        if let Ok(id) = text.parse() {
            return Ok(id);
        }
        let found = client.jobs_like(text, LISTED + 1).await?.jobs;
        match &found[..] {
            [job] => Ok(job.id),
            [] => Err(UsageError(format!(
                "no job is called {text:?}: say its id, four or more of its first or last characters, its name, or latest; \
                 `sdfarm jobs` lists them"
            ))
            .into()),
            several => {
                let mut lines: Vec<String> = several.iter().take(LISTED as usize).map(follow::line).collect();
                if several.len() > LISTED as usize {
                    lines.push("and others".to_owned());
                }
                let lines = lines.join("\n  ");
                Err(UsageError(format!("{text:?} may be several jobs: say which by its id\n  {lines}")).into())
            }
        }
    }
}
