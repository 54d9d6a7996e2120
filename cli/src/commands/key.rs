//! `sdfarm key`: creates, lists and revokes API keys directly in the data folder, with or without a running
//! server.

use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};
use proto::api_key::{ApiKeyState, ApiKeyView, NewApiKey, Scope};
use server::{OfflineApiKeys, OfflineApiKeysError, PostgresAddress};

use crate::error::UsageError;
use crate::terminal::{print_line, print_note};

/// Arguments of `key`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    what: KeyCommand,
}

#[derive(Debug, Subcommand)]
enum KeyCommand {
    /// Create a key and print its secret, which cannot be shown again.
    New(New),
    /// List the keys, newest first.
    List(List),
    /// Revoke a key by its id, or all keys of a name; a running server rejects them within a second.
    Revoke(Revoke),
}

/// Data folder that holds the keys.
#[derive(Debug, Args)]
struct Folder {
    /// Folder of the server's database and pictures.
    #[arg(long, value_name = "FOLDER", env = "SDFARM_DATA", default_value = "./sdfarm-data")]
    data: PathBuf,
    /// Database on a PostgreSQL server [default: the one that the server last used with the folder].
    #[arg(long, value_name = "postgres://USER@HOST/NAME", env = "SDFARM_DATABASE", hide_env_values = true)]
    database: Option<PostgresAddress>,
}

#[derive(Debug, Args)]
struct New {
    /// Owner's name; jobs submitted with the key belong to this name.
    name: String,
    /// Scope of the key; may be given several times, or as a list with commas.
    #[arg(long, value_name = "SCOPE", env = "SDFARM_SCOPE", required = true, value_delimiter = ',', value_parser = scope_parser())]
    scope: Vec<Scope>,
    /// Expiry, counted from now: 12h, 90d or 52w [default: never].
    #[arg(long, value_name = "TIME", env = "SDFARM_EXPIRES")]
    expires: Option<KeyLifetime>,
    /// Maximum number of unfinished jobs of its name [default: the server's].
    #[arg(long, value_name = "N", env = "SDFARM_MAX_JOBS")]
    max_jobs: Option<u32>,
    /// Maximum number of camera rays of the unfinished jobs of its name together [default: the server's].
    #[arg(long, value_name = "N", env = "SDFARM_MAX_RAYS")]
    max_rays: Option<u64>,
    /// Maximum number of requests per second [default: 1000].
    #[arg(long, value_name = "N", env = "SDFARM_RATE")]
    rate: Option<u32>,
    /// Highest priority of its jobs, -100 to 100 [default: 0, and 100 with scope admin].
    #[arg(long, value_name = "N", env = "SDFARM_MAX_PRIORITY", allow_negative_numbers = true)]
    max_priority: Option<i32>,
    #[command(flatten)]
    folder: Folder,
}

#[derive(Debug, Args)]
struct List {
    #[command(flatten)]
    folder: Folder,
    /// Print the keys as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

#[derive(Debug, Args)]
struct Revoke {
    /// A key's id, or a name.
    #[arg(value_name = "ID|NAME")]
    which: String,
    #[command(flatten)]
    folder: Folder,
}

/// Lifetime of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct KeyLifetime(Duration);

impl FromStr for KeyLifetime {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{text:?} is not a duration: write it as 30m, 12h, 90d or 52w");
        let unit = text.chars().last().ok_or_else(wrong)?;
        let seconds = match unit {
            'm' => 60,
            'h' => 3600,
            'd' => 86_400,
            'w' => 7 * 86_400,
            _ => return Err(wrong()),
        };
        let count: u64 = text[..text.len() - 1].parse().map_err(|_| wrong())?;
        let seconds = count.checked_mul(seconds).filter(|&seconds| seconds > 0).ok_or_else(wrong)?;
        Ok(Self(Duration::from_secs(seconds)))
    }
}

/// Creates, lists or revokes keys.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    match arguments.what {
        KeyCommand::New(new) => create(new).await,
        KeyCommand::List(arguments) => list(arguments).await,
        KeyCommand::Revoke(arguments) => revoke(arguments).await,
    }
}

async fn create(new: New) -> anyhow::Result<()> {
    let mut folder = OfflineApiKeys::open_or_create(&new.folder.data, new.folder.database).await?;
    let order = NewApiKey {
        name: new.name,
        scopes: new.scope,
        expires_in_seconds: new.expires.map(|life| life.0.as_secs()),
        max_jobs: new.max_jobs,
        max_rays: new.max_rays,
        requests_per_second: new.rate,
        max_priority: new.max_priority,
    };
    let issued = folder.create(order).await.map_err(as_usage_error)?;
    folder.close().await?;
    print_note(&format!("{}; the secret is shown only now: give it to its user as SDFARM_KEY", line(&issued.key)));
    print_line(&issued.secret)
}

async fn list(list: List) -> anyhow::Result<()> {
    let mut folder = OfflineApiKeys::open(&list.folder.data, list.folder.database).await?;
    let keys = folder.list().await?;
    folder.close().await?;
    if list.json {
        return print_line(&serde_json::to_string_pretty(&keys)?);
    }
    if keys.is_empty() {
        print_note("there are no keys: every client that reaches the server may use it");
    }
    keys.iter().try_for_each(|key| print_line(&line(key)))
}

async fn revoke(revoke: Revoke) -> anyhow::Result<()> {
    let mut folder = OfflineApiKeys::open(&revoke.folder.data, revoke.folder.database).await?;
    let keys = folder.revoke(&revoke.which).await?;
    folder.close().await?;
    keys.iter().try_for_each(|key| print_line(&line(key)))
}

/// Formats one key as a line.
fn line(key: &ApiKeyView) -> String {
    let state = match key.state {
        ApiKeyState::Live => "live",
        ApiKeyState::Expired => "expired",
        ApiKeyState::Revoked => "revoked",
    };
    let scopes: Vec<&str> = key.scopes.iter().map(|scope| scope.name()).collect();
    let mut line = format!("{}  {state:7}  {}  {}  created {}", key.id, key.name, scopes.join(","), key.created_at);
    if let Some(expires) = &key.expires_at {
        line = format!("{line}  expires {expires}");
    }
    match &key.last_used_at {
        Some(used) => format!("{line}  used {used}"),
        None => line,
    }
}

/// Makes a rejected request a usage error, but not a failed one.
fn as_usage_error(error: OfflineApiKeysError) -> anyhow::Error {
    match error {
        OfflineApiKeysError::Refused(reason) => UsageError(reason).into(),
        error @ OfflineApiKeysError::Folder { .. } => error.into(),
    }
}

fn scope_parser() -> impl TypedValueParser<Value = Scope> {
    PossibleValuesParser::new(Scope::ALL.map(Scope::name)).map(|name| {
        Scope::ALL.into_iter().find(|scope| scope.name() == name).expect("the parser accepts only these names")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_lifetimes_are_parsed_with_their_unit() {
        for (text, hours) in [("12h", 12), ("90d", 90 * 24), ("2w", 14 * 24), ("120m", 2)] {
            assert_eq!(text.parse(), Ok(KeyLifetime(Duration::from_hours(hours))), "{text}");
        }
        for wrong in ["", "d", "90", "0d", "-1d", "1.5d", "99999999999999999w", "5é"] {
            assert!(wrong.parse::<KeyLifetime>().is_err(), "{wrong}");
        }
    }
}
