//! One farm for each prefix of a bucket: the object `farm` below it names the farm whose pictures are there. Another farm
//! would take them for orphans, and delete them.

use object_store::{ObjectStoreExt, PutMode, PutOptions};

use super::{Backend, BlobStore, ContentError};
use crate::db::FarmId;

/// Name of the object.
const OBJECT: &str = "farm";
/// An object that another server is creating may be neither absent nor there.
const MAX_ATTEMPTS: u32 = 5;

/// Error returned when a farm may not use a store.
#[derive(Debug, thiserror::Error)]
pub enum ClaimError {
    /// Another farm uses it.
    #[error(
        "the store {store} is that of another farm (its object `{OBJECT}` names {owner}, this farm is {farm}): give each farm \
         a prefix of its own (--store s3://BUCKET/PREFIX); if that farm is gone for good, delete {store}/{OBJECT}"
    )]
    OtherFarm {
        /// The store.
        store: String,
        /// Number of the farm that uses it.
        owner: String,
        /// Number of this farm.
        farm: String,
    },
    /// The object could not be read or written.
    #[error(transparent)]
    Store(Box<dyn std::error::Error + Send + Sync>),
}

impl From<ContentError> for ClaimError {
    fn from(error: ContentError) -> Self {
        Self::Store(error.into())
    }
}

impl BlobStore {
    /// Makes the store that of this farm, unless it is another's already. A folder has a lock instead.
    pub(crate) async fn claim(&self, farm: FarmId) -> Result<(), ClaimError> {
        let Backend::Objects(objects) = &self.backend else { return Ok(()) };
        let path = self.location.prefix().join(OBJECT);
        let line = format!("{farm}\n");
        for _ in 0..MAX_ATTEMPTS {
            match objects.store().put_opts(&path, line.clone().into(), PutOptions::from(PutMode::Create)).await {
                Ok(_) => return Ok(()),
                Err(object_store::Error::AlreadyExists { .. }) => {}
                Err(error) => return Err(self.failed("write", OBJECT)(error).into()),
            }
            if let Some(owner) = self.owner().await? {
                return self.expect_owner(owner, farm);
            }
        }
        let error = object_store::Error::Generic { store: "S3", source: "it is neither absent nor there".into() };
        Err(self.failed("write", OBJECT)(error).into())
    }

    /// Checks that the store is no other farm's.
    pub(crate) async fn check_owner(&self, farm: FarmId) -> Result<(), ClaimError> {
        match self.owner().await? {
            Some(owner) => self.expect_owner(owner, farm),
            None => Ok(()),
        }
    }

    fn expect_owner(&self, owner: String, farm: FarmId) -> Result<(), ClaimError> {
        let farm = farm.to_string();
        if owner == farm {
            return Ok(());
        }
        Err(ClaimError::OtherFarm { store: self.location.to_string(), owner, farm })
    }

    /// Number of the farm whose store this is; `None` if it is none's, or a folder.
    pub(super) async fn owner(&self) -> Result<Option<String>, ContentError> {
        let Backend::Objects(objects) = &self.backend else { return Ok(None) };
        let failed = self.failed("read", OBJECT);
        let path = self.location.prefix().join(OBJECT);
        let Some(found) = super::unless_missing(objects.store().get(&path).await).map_err(&failed)? else {
            return Ok(None);
        };
        let bytes = super::objects::small(found).await.map_err(failed)?;
        Ok(Some(String::from_utf8_lossy(&bytes).trim().to_owned()))
    }
}
