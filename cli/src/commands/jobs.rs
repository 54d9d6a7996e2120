//! `sdfarm jobs`: lists jobs, newest first.

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use proto::job::JobState;

use crate::arguments::ServerArguments;
use crate::follow;
use crate::terminal::{print_line, print_note};

/// Arguments of `jobs`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    server: ServerArguments,
    /// List only jobs in this state.
    #[arg(long, env = "SDFARM_STATE", value_parser = state_parser())]
    state: Option<JobState>,
    /// Maximum number of jobs to list.
    #[arg(long, value_name = "N", env = "SDFARM_LIMIT", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    limit: u32,
    /// Continue an earlier list at the cursor that it printed.
    #[arg(long, env = "SDFARM_CURSOR")]
    cursor: Option<String>,
    /// Print the server's response as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Lists the jobs.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let page = client.jobs(arguments.state, arguments.limit, arguments.cursor.as_deref()).await?;
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&page)?);
    }
    for job in &page.jobs {
        print_line(&follow::line(job))?;
    }
    follow::note_farm_pause(&client).await;
    if let Some(cursor) = page.next_cursor {
        print_note(&format!("more: sdfarm jobs --cursor {cursor}"));
    }
    Ok(())
}

fn state_parser() -> impl TypedValueParser<Value = JobState> {
    PossibleValuesParser::new(JobState::ALL.map(JobState::name)).map(|name| {
        JobState::ALL.into_iter().find(|state| state.name() == name).expect("the parser accepts only these names")
    })
}
