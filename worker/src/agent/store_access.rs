//! Access to stored bytes: through the server, or in its folders on the same machine.

use std::fs::{File, Permissions};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use proto::fail_point::{self, FailPoint};
use proto::worker_protocol::{ContentFolders, PARTIAL_MARKER};
use tokio::task::spawn_blocking;

use super::server_client::{PictureBytes, ServerClient, ServerError};

/// Store of tile blobs and pictures.
#[derive(Clone, Debug)]
pub(super) enum StoreAccess {
    /// Through the server over HTTP; it verifies every byte.
    Server(Arc<ServerClient>),
    /// Directly in the server's folders: the server trusts pool workers, and no copy is made.
    Folders(ContentFolders),
}

impl StoreAccess {
    /// Stores a blob; a power failure may lose it.
    pub(super) async fn put_blob(&self, hash: &str, bytes: Bytes) -> Result<(), ServerError> {
        match self {
            Self::Server(link) => link.put_blob(hash, bytes).await,
            Self::Folders(folders) => put(&folders.blobs, hash, PictureBytes::Memory(bytes), false).await,
        }
    }

    /// Stores a picture; it has been fsynced when this returns.
    pub(super) async fn put_picture(
        &self,
        hash: &str,
        content: &PictureBytes,
        size_bytes: u64,
    ) -> Result<(), ServerError> {
        match self {
            Self::Server(link) => link.put_picture(hash, content, size_bytes).await,
            Self::Folders(folders) => put(&folders.pictures, hash, content.try_clone()?, true).await,
        }
    }

    /// Reads a blob; `None` if there is none of this size.
    pub(super) async fn blob(&self, hash: &str, size_bytes: u64) -> Result<Option<Vec<u8>>, ServerError> {
        match self {
            Self::Server(link) => match link.blob(hash, size_bytes).await {
                Err(error) if error.is_not_found() => Ok(None),
                answered => answered,
            },
            Self::Folders(folders) => {
                let file = Path::new(&folders.blobs).join(hash);
                run_blocking(move || read(&file, size_bytes)).await
            }
        }
    }
}

async fn put(folder: &str, name: &str, content: PictureBytes, durable: bool) -> Result<(), ServerError> {
    let (folder, name) = (PathBuf::from(folder), name.to_owned());
    run_blocking(move || write(&folder, &name, content, durable)).await
}

async fn run_blocking<T: Send + 'static>(
    work: impl FnOnce() -> io::Result<T> + Send + 'static,
) -> Result<T, ServerError> {
    spawn_blocking(work).await.map_err(io::Error::other).flatten().map_err(ServerError::Store)
}

/// Writes a file atomically: it has its final name only when it is complete.
fn write(folder: &Path, name: &str, content: PictureBytes, durable: bool) -> io::Result<()> {
    fail_point::trigger(FailPoint::StorePut).map_err(io::Error::other)?;
    let mut file = tempfile::Builder::new()
        .prefix(&format!("{name}{PARTIAL_MARKER}"))
        .permissions(Permissions::from_mode(0o666))
        .tempfile_in(folder)?;
    match content {
        PictureBytes::Memory(bytes) => file.write_all(&bytes)?,
        PictureBytes::File(mut whole) => {
            whole.rewind()?;
            io::copy(&mut whole, file.as_file_mut())?;
        }
    }
    if durable {
        file.as_file().sync_all()?;
    }
    file.persist(folder.join(name)).map_err(|unnamed| unnamed.error)?;
    if durable {
        File::open(folder)?.sync_all()?;
    }
    Ok(())
}

fn read(file: &Path, size_bytes: u64) -> io::Result<Option<Vec<u8>>> {
    fail_point::trigger(FailPoint::StoreGet).map_err(io::Error::other)?;
    let found = match File::open(file) {
        Ok(found) => found,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error),
    };
    if found.metadata()?.len() != size_bytes {
        return Ok(None);
    }
    let mut bytes = Vec::with_capacity(size_bytes as usize);
    found.take(size_bytes).read_to_end(&mut bytes)?;
    Ok(Some(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).expect("lists");
        entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("plain")).collect()
    }

    #[tokio::test]
    async fn writes_are_atomic() {
        let (blobs, pictures) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
        let text = |folder: &tempfile::TempDir| folder.path().to_str().expect("plain").to_owned();
        let store = StoreAccess::Folders(ContentFolders { blobs: text(&blobs), pictures: text(&pictures) });
        assert_eq!(store.blob("name", 5).await.expect("reads"), None);
        for _ in 0..2 {
            store.put_blob("name", Bytes::from_static(b"bytes")).await.expect("writes");
        }
        assert_eq!(store.blob("name", 5).await.expect("reads").as_deref(), Some(&b"bytes"[..]));
        assert_eq!(store.blob("name", 4).await.expect("reads"), None, "another size");
        assert_eq!(names(blobs.path()), ["name"], "no partial file remains");
        let mut file = tempfile::tempfile().expect("a file");
        file.write_all(b"picture").expect("writes");
        for content in [PictureBytes::File(file), PictureBytes::Memory(Bytes::from_static(b"picture"))] {
            store.put_picture("other", &content, 7).await.expect("writes");
            assert_eq!(std::fs::read(pictures.path().join("other")).expect("reads"), b"picture");
        }
        blobs.close().expect("removes");
        let error = store.put_blob("name", Bytes::new()).await.expect_err("there is no folder");
        assert!(matches!(error, ServerError::Store(_)), "{error}");
    }
}
