//! API keys of a data folder, for the command line, with or without a running server.
//!
//! A running server applies changes made here within 1 s.

use std::path::{Path, PathBuf};
use std::time::Duration;

use db::Connection;
use proto::api_key::{ApiKeyView, IssuedApiKey, NewApiKey};

use super::key::{ApiKey, KeySpec};
use super::{ApiKeyError, rows, secret};
use crate::audit_log::{self, AuditRecord, EntryKind};
use crate::clock::Clock;
use crate::db;
use crate::db::{Database, DatabaseError, DatabaseLocation, OpenError, PostgresAddress, Sharing};
use crate::lock::{FolderLock, LockError};
use crate::private_files;

/// Timeout for the database while a running server writes.
const LOCK_TIMEOUT: Duration = Duration::from_secs(10);

/// Error when changing or listing the keys of a data folder.
#[derive(Debug, thiserror::Error)]
pub enum OfflineApiKeysError {
    /// The folder or its database cannot be used.
    #[error("cannot read the keys of the data folder {folder}: {reason}; {cure}")]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// Reason.
        reason: String,
        /// Fix.
        cure: &'static str,
    },
    /// The change is invalid.
    #[error("{0}")]
    Refused(String),
}

const USE_OTHER_FOLDER_FIX: &str = "pass the server's data folder with --data";
const CORRECT_ADDRESS_FIX: &str = "give the server's database with --database";
const RECORDED_DATABASE_FIX: &str = "leave --database out, or pass another folder with --data";
const SAME_RELEASE: &str = "run the same release of sdfarm as the running server";

fn wrong(folder: &Path, reason: String, cure: &'static str) -> OfflineApiKeysError {
    OfflineApiKeysError::Folder { folder: folder.to_owned(), reason, cure }
}

fn locate(folder: &Path, database: Option<PostgresAddress>) -> Result<DatabaseLocation, OfflineApiKeysError> {
    let failed = |error: std::io::Error| wrong(folder, error.to_string(), USE_OTHER_FOLDER_FIX);
    if database.is_none() {
        return DatabaseLocation::of_folder(folder).map_err(failed);
    }
    let location = DatabaseLocation { data: folder.to_owned(), postgres: database };
    match location.other_record().map_err(failed)? {
        Some(recorded) => Err(wrong(folder, format!("its farm has its database in {recorded}"), RECORDED_DATABASE_FIX)),
        None => Ok(location),
    }
}

/// Access to the keys of a data folder.
#[derive(Debug)]
pub struct OfflineApiKeys {
    connection: Connection,
    folder: PathBuf,
    // If no server runs, the lock prevents one from starting while the database is being created.
    _lock: Option<FolderLock>,
}

impl OfflineApiKeys {
    /// Opens the keys of a farm that a server has used before. Its database is the one that the data folder records, or
    /// the file in it, unless an address is given.
    pub async fn open(folder: &Path, database: Option<PostgresAddress>) -> Result<Self, OfflineApiKeysError> {
        let location = locate(folder, database.clone())?;
        if location.postgres.is_none() && !Database::file(folder).is_file() {
            return Err(wrong(folder, "it has no farm".to_owned(), USE_OTHER_FOLDER_FIX));
        }
        Self::open_or_create(folder, database).await
    }

    /// Opens the keys of a farm, creating its data folder and its database's tables if missing, so that keys can be created
    /// before the first start of a server.
    pub async fn open_or_create(folder: &Path, database: Option<PostgresAddress>) -> Result<Self, OfflineApiKeysError> {
        let location = locate(folder, database)?;
        let fix = if location.postgres.is_some() { CORRECT_ADDRESS_FIX } else { USE_OTHER_FOLDER_FIX };
        private_files::create_folder(folder).map_err(|error| wrong(folder, error.to_string(), USE_OTHER_FOLDER_FIX))?;
        let lock = match FolderLock::acquire(folder) {
            Ok(lock) => {
                private_files::restrict(folder)
                    .map_err(|error| wrong(folder, error.to_string(), USE_OTHER_FOLDER_FIX))?;
                match Database::open_at(&location, Sharing::Alone).await {
                    Ok(database) => database.close().await,
                    // A server with another data folder uses the database.
                    Err(OpenError::InUse) => {}
                    Err(error) => return Err(wrong(folder, explain(&error), fix)),
                }
                Some(lock)
            }
            Err(LockError::InUse(_)) => None,
            Err(LockError::Io(error)) => return Err(wrong(folder, error.to_string(), USE_OTHER_FOLDER_FIX)),
        };
        let mut connection = Connection::beside_server(&location, LOCK_TIMEOUT)
            .await
            .map_err(|error| wrong(folder, error.to_string(), fix))?;
        rows::all(&mut connection).await.map_err(|error| wrong(folder, cause(&error), SAME_RELEASE))?;
        Ok(Self { connection, folder: folder.to_owned(), _lock: lock })
    }

    /// Creates a key. Only the returned value has its secret.
    pub async fn create(&mut self, new: NewApiKey) -> Result<IssuedApiKey, OfflineApiKeysError> {
        let order = KeySpec::check(new, now_ms()).map_err(refused)?;
        let rows = self.rows().await?;
        let kept = rows.iter().filter(|row| row.revoked_at_ms.is_none()).count();
        super::check_room(&order, rows.len(), kept).map_err(refused)?;
        let issue = secret::generate().map_err(refused)?;
        let made = self.insert(&issue.id, &issue.digest, &order).await;
        let made = made.map_err(|error| self.failed(&error))?;
        match self.list().await?.into_iter().find(|key| key.id == issue.id) {
            Some(key) if made => Ok(IssuedApiKey { secret: issue.secret, key }),
            _ => Err(refused(ApiKeyError::TooManyLive { name: order.name })),
        }
    }

    /// Every key, newest first.
    pub async fn list(&mut self) -> Result<Vec<ApiKeyView>, OfflineApiKeysError> {
        let now_ms = now_ms();
        Ok(self.rows().await?.into_iter().map(|row| ApiKey::new(row, None).view(now_ms)).collect())
    }

    /// Revokes the key with this id, or all keys of this name.
    pub async fn revoke(&mut self, id_or_name: &str) -> Result<Vec<ApiKeyView>, OfflineApiKeysError> {
        let revoked = self.revoke_rows(id_or_name).await;
        let revoked = revoked.map_err(|error| self.failed(&error))?;
        if revoked.is_empty() {
            return Err(refused(ApiKeyError::Unknown(id_or_name.to_owned())));
        }
        Ok(self.list().await?.into_iter().filter(|key| revoked.contains(&key.id)).collect())
    }

    /// Closes the database.
    pub async fn close(self) -> Result<(), OfflineApiKeysError> {
        let folder = self.folder;
        self.connection.close().await.map_err(|error| OfflineApiKeysError::Folder {
            folder,
            reason: error.to_string(),
            cure: USE_OTHER_FOLDER_FIX,
        })
    }

    async fn insert(&mut self, id: &str, digest: &[u8; 32], order: &KeySpec) -> Result<bool, DatabaseError> {
        let insert = async |connection: &mut Connection| {
            let made = rows::insert(connection, id, digest, order).await?;
            if made {
                audit_log::insert(connection, &entry("POST", "/v1/keys", 201), now_ms(), 1).await?;
            }
            Ok(made)
        };
        self.connection.in_transaction(insert).await
    }

    async fn revoke_rows(&mut self, id_or_name: &str) -> Result<Vec<String>, DatabaseError> {
        let revoke = async |connection: &mut Connection| {
            let revoked = rows::revoke(connection, id_or_name, now_ms()).await?;
            if !revoked.is_empty() {
                audit_log::insert(connection, &entry("DELETE", "/v1/keys/{id}", 200), now_ms(), 1).await?;
            }
            Ok(revoked)
        };
        self.connection.in_transaction(revoke).await
    }

    async fn rows(&mut self) -> Result<Vec<super::key::KeyRow>, OfflineApiKeysError> {
        rows::all(&mut self.connection).await.map_err(|error| self.failed(&error))
    }

    fn failed(&self, error: &DatabaseError) -> OfflineApiKeysError {
        OfflineApiKeysError::Folder { folder: self.folder.clone(), reason: cause(error), cure: USE_OTHER_FOLDER_FIX }
    }
}

/// Entry of the audit log for a change on this machine: the same as for the request that makes this change.
fn entry(method: &str, route: &str, status: u16) -> AuditRecord {
    AuditRecord {
        kind: EntryKind::Admin,
        actor: "local".to_owned(),
        key: None,
        address: "-".to_owned(),
        method: method.to_owned(),
        route: route.to_owned(),
        job: None,
        status,
        code: None,
        request_id: "-".to_owned(),
    }
}

fn refused(error: ApiKeyError) -> OfflineApiKeysError {
    match error {
        ApiKeyError::Store(error) => OfflineApiKeysError::Refused(cause(&error)),
        error => OfflineApiKeysError::Refused(error.to_string()),
    }
}

fn cause(error: &DatabaseError) -> String {
    match std::error::Error::source(error) {
        Some(source) => format!("{error}: {source}"),
        None => error.to_string(),
    }
}

fn explain(error: &OpenError) -> String {
    error.to_string()
}

fn now_ms() -> i64 {
    Clock::system().wall_ms()
}
