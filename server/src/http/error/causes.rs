//! The responses to errors of other modules.

use super::{ApiError, chain};
use crate::api_keys::ApiKeyError;
use crate::blobs::ContentError;
use crate::db::DatabaseError;
use crate::job_reader::{JobLoadError, Refusal};
use crate::preview_helper::HelperError;
use crate::retention::RetentionError;
use crate::worker_sync::SyncError;

impl From<DatabaseError> for ApiError {
    fn from(error: DatabaseError) -> Self {
        if error.is_full() {
            tracing::error!(error = %chain(&error), "the disk is full");
            return Self::DiskFull;
        }
        if error.is_unreachable() {
            tracing::error!(error = %chain(&error), "the database cannot be reached");
            return Self::DatabaseUnreachable;
        }
        if error.is_corruption() {
            tracing::error!(error = %chain(&error), "the database is damaged");
            return Self::DamagedDatabase;
        }
        match error {
            DatabaseError::Closed => Self::ShuttingDown,
            error @ (DatabaseError::Sql(_)
            | DatabaseError::Rows { .. }
            | DatabaseError::Value { .. }
            | DatabaseError::Taken) => Self::Internal(Box::new(error)),
        }
    }
}

impl From<ApiKeyError> for ApiError {
    fn from(error: ApiKeyError) -> Self {
        match error {
            ApiKeyError::Store(error) => error.into(),
            error @ ApiKeyError::Random(_) => Self::Internal(Box::new(error)),
            error @ (ApiKeyError::Name(_)
            | ApiKeyError::NoScope
            | ApiKeyError::Limit { .. }
            | ApiKeyError::Priority(_)
            | ApiKeyError::FirstNotAdmin) => Self::InvalidNewKey(error),
            error @ (ApiKeyError::TooManyLive { .. } | ApiKeyError::TooMany) => Self::TooManyKeys(error),
            error @ ApiKeyError::Unknown(_) => Self::KeyNotFound(error),
        }
    }
}

impl From<ContentError> for ApiError {
    fn from(error: ContentError) -> Self {
        if error.is_full() {
            tracing::error!(error = %chain(&error), "the disk is full");
            return Self::DiskFull;
        }
        if let Some(attempt) = error.unreachable_attempt() {
            tracing::error!(error = %chain(&error), "the store cannot be reached");
            return Self::StoreUnreachable { attempt: attempt.to_owned() };
        }
        match error {
            ContentError::Mismatch { .. } => Self::WrongBytes(error.to_string()),
            ContentError::TooLarge { limit_bytes } => Self::TooLarge { limit_bytes },
            ContentError::Broken(error) => Self::broken_body(&error),
            error @ ContentError::Store { .. } => Self::Internal(Box::new(error)),
        }
    }
}

impl From<SyncError> for ApiError {
    fn from(error: SyncError) -> Self {
        match error {
            SyncError::Store(error) => error.into(),
            SyncError::Content(error) => error.into(),
        }
    }
}

impl From<HelperError> for ApiError {
    fn from(error: HelperError) -> Self {
        // The message may name files of the server.
        tracing::warn!(%error, "could not draw a preview");
        match error {
            HelperError::Busy => Self::TooManyPreviews(error),
            HelperError::TimedOut => Self::PreviewDelayed(error),
            HelperError::Start(_) | HelperError::Fetch(_) | HelperError::Failed(_) => Self::PreviewFailed,
        }
    }
}

impl From<RetentionError> for ApiError {
    fn from(error: RetentionError) -> Self {
        match error {
            RetentionError::Database(error) => error.into(),
            RetentionError::Size(error) => error.into(),
        }
    }
}

impl From<JobLoadError> for ApiError {
    fn from(error: JobLoadError) -> Self {
        match error {
            JobLoadError::Store(error) => error.into(),
            JobLoadError::TooManyWaiting { name, limit } => {
                Self::TooManyAtOnce { name, what: "jobs waiting to be read", limit }
            }
            JobLoadError::Refused(refusal) => refusal.into(),
            error @ (JobLoadError::Gone | JobLoadError::Broken(_) | JobLoadError::Unexpected) => {
                Self::Internal(Box::new(error))
            }
        }
    }
}

impl From<Refusal> for ApiError {
    fn from(refusal: Refusal) -> Self {
        if refusal.is_json { Self::WrongJob(refusal.errors) } else { Self::NotJson(refusal.errors) }
    }
}
