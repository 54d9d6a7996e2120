//! `sdfarm audit`: lists the audit log, newest first. If the farm has keys, it needs one of scope admin.

use clap::Args;
use proto::audit::AuditEntry;

use crate::arguments::ServerArguments;
use crate::terminal::{escape_line, print_line, print_note};

/// Arguments of `audit`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    server: ServerArguments,
    /// Maximum number of entries to list.
    #[arg(long, value_name = "N", env = "SDFARM_LIMIT", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=1000))]
    limit: u32,
    /// Continue an earlier list at the cursor that it printed.
    #[arg(long, env = "SDFARM_CURSOR")]
    cursor: Option<String>,
    /// Print the server's response as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Lists the entries.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let page = client.audit(arguments.limit, arguments.cursor.as_deref()).await?;
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&page)?);
    }
    for entry in &page.entries {
        print_line(&escape_line(&line(entry)))?;
    }
    if let Some(cursor) = page.next_cursor {
        print_note(&format!("more: sdfarm audit --cursor {cursor}"));
    }
    Ok(())
}

fn line(entry: &AuditEntry) -> String {
    let AuditEntry { at, who, address, method, route, status, .. } = entry;
    let mut line = format!("{at}  {who}  {address}  {method} {route}  {status}");
    for extra in [entry.code.clone(), entry.job.map(|job| job.to_string())].into_iter().flatten() {
        line = format!("{line}  {extra}");
    }
    if entry.times > 1 { format!("{line}  ×{}", entry.times) } else { line }
}
