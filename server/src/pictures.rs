//! Stored pictures: checked before they are served, and forgotten if they are damaged or an administrator says so.

use std::sync::Arc;

use proto::frame::ForgottenPicture;

use crate::blobs::{BlobStore, ContentError, ContentHash, ContentKind, FileState};
use crate::db::DatabaseError;
use crate::preview_helper::PreviewHelper;
use crate::queue::Queue;
use crate::space_reserve::SpaceReserve;

/// Size of a picture above which a client may be sent to the store for it.
const MIN_REDIRECT_BYTES: u64 = 1 << 20;

/// Whether a stored picture may be served.
#[derive(Clone, Debug)]
pub(crate) enum PictureState {
    /// Its file has the size and the hash that were recorded.
    Intact(ContentHash),
    /// Its file is missing: the frames that show it are rendered again.
    Missing,
    /// Its file is damaged: the frames that show it are rendered again.
    Damaged,
}

/// Error when a picture is checked or forgotten.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PictureError {
    /// The database failed.
    #[error(transparent)]
    Store(#[from] DatabaseError),
    /// The content store failed.
    #[error(transparent)]
    Content(#[from] ContentError),
}

/// Service for stored pictures.
#[derive(Debug)]
pub(crate) struct Pictures {
    queue: Queue,
    content: Arc<BlobStore>,
    reserve: Arc<SpaceReserve>,
    preview_helper: Arc<PreviewHelper>,
    redirects: bool,
}

impl Pictures {
    /// Serves the pictures of this store, which the queue's frames show; with `redirects`, clients may read large ones
    /// from the store itself.
    pub(crate) fn new(
        queue: Queue,
        content: Arc<BlobStore>,
        reserve: Arc<SpaceReserve>,
        preview_helper: Arc<PreviewHelper>,
        redirects: bool,
    ) -> Self {
        Self { queue, content, reserve, preview_helper, redirects }
    }

    /// Checks the file of a picture with this recorded size. If it is missing or damaged, the picture is forgotten.
    pub(crate) async fn check(&self, hash: &str, size_bytes: u64) -> Result<PictureState, PictureError> {
        let Some(name) = ContentHash::parse(hash) else { return Ok(PictureState::Missing) };
        let (state, code) = match self.content.file_state(ContentKind::Picture, &name, size_bytes).await? {
            FileState::Intact => return Ok(PictureState::Intact(name)),
            FileState::Missing => (PictureState::Missing, "lost_picture"),
            FileState::Damaged => (PictureState::Damaged, "damaged_picture"),
        };
        tracing::error!(code, hash, "a stored picture is missing or damaged; its frames are rendered again");
        self.forget(&name).await?;
        Ok(state)
    }

    /// Address in the store to send a client to for an intact picture, valid for five minutes and for GET only; `None` if
    /// the server should answer itself.
    pub(crate) async fn redirect(
        &self,
        name: &ContentHash,
        size_bytes: u64,
        media_type: &str,
    ) -> Result<Option<String>, ContentError> {
        if !self.redirects || size_bytes <= MIN_REDIRECT_BYTES {
            return Ok(None);
        }
        self.content.presigned(ContentKind::Picture, name, media_type).await
    }

    /// Forgets a picture: its rows, its file, and what was drawn from it. The frames that show it are rendered again,
    /// unless their job has failed or was cancelled.
    pub(crate) async fn forget(&self, name: &ContentHash) -> Result<Option<ForgottenPicture>, PictureError> {
        let forgotten = match self.queue.forget_picture(name.as_str()).await {
            Err(error) if self.reserve.has_made_room(&error) => self.queue.forget_picture(name.as_str()).await,
            done => done,
        }?;
        self.preview_helper.forget(name.as_str());
        let is_deleted = self.delete_unused(name).await?;
        if !forgotten.is_known && !is_deleted {
            return Ok(None);
        }
        let (again, without) = (forgotten.reopened.frames, forgotten.reopened.void);
        tracing::warn!(
            hash = name.as_str(),
            frames_rendered_again = again,
            frames_without_picture = without,
            "forgot a picture"
        );
        Ok(Some(ForgottenPicture {
            picture: name.as_str().to_owned(),
            frames_rendered_again: again,
            frames_without_picture: without,
        }))
    }

    /// Deletes the file of a picture that no row refers to, however new it is. Returns whether there was any.
    async fn delete_unused(&self, name: &ContentHash) -> Result<bool, PictureError> {
        let (queue, kind) = (&self.queue, ContentKind::Picture);
        if !(queue.may_have_others() && self.content.is_shared()) {
            let is_unused = async |name: String| Ok::<_, PictureError>(!queue.orphans(kind, &[name]).await?.is_empty());
            return self.content.delete_if(kind, name, is_unused).await;
        }
        if !queue.take_unmarked(kind, name.as_str().to_owned()).await? {
            return Ok(false);
        }
        let is_deleted = self.content.delete(kind, name).await?;
        queue.record_deleted(kind, vec![name.as_str().to_owned()]).await?;
        Ok(is_deleted)
    }
}
