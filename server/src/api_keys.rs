//! API keys. The table is reread every 500 ms, so keys created or revoked by another process take effect
//! within a second; open requests of a revoked key end at once.
//!
//! Depends on no routes: the HTTP layer queries a key's scopes.

mod key;
mod offline;
mod rows;
mod secret;
#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, RwLock};
use std::time::Duration;

use proto::api_key::{ApiKeyView, IssuedApiKey, NewApiKey, Scope};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::clock::{Clock, monotonic_now};
use crate::db::{Database, DatabaseError, Durability};

pub(crate) use key::ApiKey;
pub use offline::{OfflineApiKeys, OfflineApiKeysError};
pub(crate) use secret::constant_time_eq;

/// Interval at which the table is reread.
const RELOAD_INTERVAL: Duration = Duration::from_millis(500);
/// Minimum interval between two rereads for unknown secrets.
const MIN_REREAD_INTERVAL: Duration = Duration::from_millis(100);
/// Precision of the stored last-used times.
const LAST_USED_PRECISION_MS: i64 = 60_000;
/// Maximum number of live keys of one name: the old one and its replacement.
pub(crate) const MAX_LIVE_OF_A_NAME: i64 = 2;
/// Maximum number of keys that are not revoked, of all names.
pub(crate) const MAX_KEYS: usize = 1000;
/// Maximum length of a key's name, in characters.
pub(crate) const MAX_NAME_CHARACTERS: usize = 64;
/// Reserved names: the submitter on farms without keys, and the server's own workers.
const RESERVED: [&str; 2] = ["local", "pool"];
/// Maximum lifetime of a key that expires, in seconds.
const MAX_LIFE_SECONDS: u64 = 100 * 366 * 24 * 3600;

/// Error when creating, finding or revoking a key.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ApiKeyError {
    /// The name is invalid.
    #[error("invalid key name {0:?}: use 1 to 64 letters, digits, dots, dashes and underscores, but not local or pool")]
    Name(String),
    /// It has no scope, so it would permit nothing.
    #[error("a key needs a scope: submit, read, worker or admin")]
    NoScope,
    /// A limit is out of range.
    #[error("{what} of a key is {found}: use a value from 1 to {most}, or leave it out")]
    Limit {
        /// Name of the limit.
        what: &'static str,
        /// Requested value.
        found: u64,
        /// Maximum.
        most: u64,
    },
    /// The highest priority is out of range.
    #[error("the highest priority of a key is {0}: use a value from -100 to 100, or leave it out")]
    Priority(i32),
    /// The first key lacks scope `admin`, so no key could administer the farm.
    #[error(
        "the first key needs the scope admin, because the farm then rejects all requests without a key: \
         create one with `sdfarm key new admin --scope admin`, then this one"
    )]
    FirstNotAdmin,
    /// The name has two live keys already.
    #[error(
        "{name} has {MAX_LIVE_OF_A_NAME} live keys already: revoke one with `sdfarm key revoke ID`, then create another"
    )]
    TooManyLive {
        /// The name.
        name: String,
    },
    /// The farm has its maximum of keys.
    #[error("there are {MAX_KEYS} keys already: revoke unused ones (`sdfarm key list` shows when each was last used)")]
    TooMany,
    /// No live key has this id or name.
    #[error("no live key has the id or name {0:?}: `sdfarm key list` shows all keys")]
    Unknown(String),
    /// The system's random number generator failed.
    #[error("cannot get random bytes for a key from the system: {0}")]
    Random(getrandom::Error),
    /// The database failed.
    #[error(transparent)]
    Store(#[from] DatabaseError),
}

/// Whether another key may be created on a farm with `made` keys, `kept` of them not revoked.
fn check_room(order: &key::KeySpec, made: usize, kept: usize) -> Result<(), ApiKeyError> {
    if made == 0 && !order.scopes.has(Scope::Admin) {
        return Err(ApiKeyError::FirstNotAdmin);
    }
    if kept >= MAX_KEYS {
        return Err(ApiKeyError::TooMany);
    }
    Ok(())
}

/// Result of looking up a secret.
#[derive(Clone, Debug)]
pub(crate) enum KeyLookup {
    /// Secret of a live key.
    Live(Arc<ApiKey>),
    /// Secret of an expired key.
    Expired,
    /// Secret of a revoked key.
    Revoked,
    /// Unknown secret.
    Unknown,
}

/// Keys of a farm, at most 500 ms old.
#[derive(Debug)]
pub(crate) struct ApiKeys {
    store: Arc<Database>,
    clock: Clock,
    known: RwLock<Arc<Vec<Arc<ApiKey>>>>,
    /// When each key's last use was last written to the table.
    written: Mutex<HashMap<i64, i64>>,
    /// When the table was last reread. One task does so at a time, so that no older state replaces a newer one.
    reread: tokio::sync::Mutex<Instant>,
}

impl ApiKeys {
    /// Reads the keys of a database.
    pub(crate) async fn open(store: Arc<Database>, clock: Clock) -> Result<Self, DatabaseError> {
        let reread = tokio::sync::Mutex::new(monotonic_now());
        let keys = Self { store, clock, known: RwLock::default(), written: Mutex::default(), reread };
        keys.refresh().await?;
        Ok(keys)
    }

    /// Whether a key was ever created: after that, every request needs one.
    pub(crate) fn are_required(&self) -> bool {
        !self.all().is_empty()
    }

    /// Live keys.
    pub(crate) fn live(&self) -> usize {
        let now_ms = self.clock.wall_ms();
        self.all().iter().filter(|key| key.is_live(now_ms)).count()
    }

    /// Looks up a secret.
    pub(crate) fn find(&self, secret: &str) -> KeyLookup {
        let digest = secret::digest(secret);
        // Compares with all keys, so that the duration reveals nothing.
        let all = self.all();
        let found = all.iter().fold(None, |found, key| if key.has(&digest) { Some(key) } else { found });
        let Some(key) = found else { return KeyLookup::Unknown };
        let now_ms = self.clock.wall_ms();
        if key.is_revoked() {
            KeyLookup::Revoked
        } else if key.is_live(now_ms) {
            key.mark_used(now_ms);
            KeyLookup::Live(Arc::clone(key))
        } else {
            KeyLookup::Expired
        }
    }

    /// Like [`ApiKeys::find`]; an unknown secret may be that of a key which another server, or the command line, has just
    /// created.
    pub(crate) async fn find_or_reread(&self, secret: &str) -> Result<KeyLookup, DatabaseError> {
        match self.find(secret) {
            KeyLookup::Unknown => {
                let mut reread = self.reread.lock().await;
                if reread.elapsed() >= MIN_REREAD_INTERVAL {
                    self.reread(&mut reread).await?;
                }
                Ok(self.find(secret))
            }
            found => Ok(found),
        }
    }

    /// Every key, newest first.
    pub(crate) fn list(&self) -> Vec<ApiKeyView> {
        let now_ms = self.clock.wall_ms();
        self.all().iter().map(|key| key.view(now_ms)).collect()
    }

    /// Creates a key; it is valid when this returns.
    pub(crate) async fn create(&self, new: NewApiKey) -> Result<IssuedApiKey, ApiKeyError> {
        let order = key::KeySpec::check(new, self.clock.wall_ms())?;
        let all = self.all();
        check_room(&order, all.len(), all.iter().filter(|key| !key.is_revoked()).count())?;
        let issue = secret::generate()?;
        let (id, name, digest) = (issue.id.clone(), order.name.clone(), issue.digest);
        let made = self
            .store
            .write(Durability::Full, move |connection| {
                Box::pin(async move { rows::insert(connection, &id, &digest, &order).await })
            })
            .await?;
        self.refresh().await?;
        match self.list().into_iter().find(|key| key.id == issue.id) {
            Some(key) if made => Ok(IssuedApiKey { secret: issue.secret, key }),
            _ => Err(ApiKeyError::TooManyLive { name }),
        }
    }

    /// Revokes the key with this id, or all keys of this name, and ends their open requests.
    pub(crate) async fn revoke(&self, id_or_name: &str) -> Result<Vec<ApiKeyView>, ApiKeyError> {
        if id_or_name.contains('\0') {
            return Err(ApiKeyError::Unknown(id_or_name.to_owned()));
        }
        let (which, now_ms) = (id_or_name.to_owned(), self.clock.wall_ms());
        let revoked = self
            .store
            .write(Durability::Full, move |connection| {
                Box::pin(async move { rows::revoke(connection, &which, now_ms).await })
            })
            .await?;
        self.refresh().await?;
        if revoked.is_empty() {
            return Err(ApiKeyError::Unknown(id_or_name.to_owned()));
        }
        Ok(self.list().into_iter().filter(|key| revoked.contains(&key.id)).collect())
    }

    /// Rereads the table.
    pub(crate) async fn refresh(&self) -> Result<(), DatabaseError> {
        self.reread(&mut *self.reread.lock().await).await
    }

    async fn reread(&self, reread: &mut Instant) -> Result<(), DatabaseError> {
        *reread = monotonic_now();
        let rows = rows::all(self.store.readers()).await?;
        let old = self.all();
        let now_ms = self.clock.wall_ms();
        let keys = rows.into_iter().map(|row| {
            // A key that is live again, because the wall clock was ahead for a while, starts again: the requests that
            // were open have ended.
            let has_ended = |key: &ApiKey| row.is_live(now_ms) && key.revoked().is_cancelled();
            let known = old.iter().find(|key| key.number() == row.number && !has_ended(key));
            let key = ApiKey::new(row, known.map(|key| &**key));
            key.revoke_if_expired(now_ms);
            Arc::new(key)
        });
        let keys = Arc::new(keys.collect::<Vec<_>>());
        *self.known.write().expect("no holder panics") = keys;
        Ok(())
    }

    /// Reloads the keys from the table and stores their last use until shutdown.
    pub(crate) async fn run(&self, end: CancellationToken) {
        let mut tick = tokio::time::interval(RELOAD_INTERVAL);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            let done = tokio::select! {
                () = end.cancelled() => return,
                _ = tick.tick() => async { self.refresh().await?; self.write_uses().await }.await,
            };
            if let Err(error) = done {
                tracing::error!(%error, cause = ?std::error::Error::source(&error), "could not reread the keys");
            }
        }
    }

    async fn write_uses(&self) -> Result<(), DatabaseError> {
        let uses: Vec<(i64, i64)> = {
            let mut written = self.written.lock().expect("no holder panics");
            let is_due = |written: &HashMap<i64, i64>, number: i64, used_ms: i64| {
                written.get(&number).is_none_or(|before| used_ms >= before + LAST_USED_PRECISION_MS)
            };
            let uses = self.all();
            let uses = uses.iter().filter_map(|key| Some((key.number(), key.last_used_ms()?)));
            let due: Vec<_> = uses.filter(|&(number, used_ms)| is_due(&written, number, used_ms)).collect();
            written.extend(due.iter().copied());
            due
        };
        if uses.is_empty() {
            return Ok(());
        }
        self.store
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    for (number, used_ms) in uses {
                        rows::set_last_used(connection, number, used_ms).await?;
                    }
                    Ok(())
                })
            })
            .await
    }

    fn all(&self) -> Arc<Vec<Arc<ApiKey>>> {
        Arc::clone(&self.known.read().expect("no holder panics"))
    }
}
