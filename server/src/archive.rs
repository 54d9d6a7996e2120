//! All pictures of a job as one ZIP archive, written while it is downloaded: only one chunk of it is in
//! memory.
//!
//! Pictures are compressed already, so they are stored unchanged. Dates are fixed and names follow from the
//! job, so the archive of the same pictures always has the same bytes.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::{Arc, Mutex};

use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::stream::BoxStream;
use zip::write::{SimpleFileOptions, StreamWriter};
use zip::{CompressionMethod, DateTime, ZipWriter};

use crate::blobs::{BlobStore, ContentError, ContentKind};
use crate::db::DatabaseError;
use crate::pictures::{PictureError, PictureState, Pictures};
use crate::queue::{FrameSet, Queue, StoredFrame};

/// Approximate size of the chunks of a response.
const CHUNK_BYTES: usize = 32 << 10;
/// Frames per database query.
const FRAMES_PER_PAGE: u32 = 100;
/// Permissions of extracted files.
const FILE_MODE: u32 = 0o644;

/// Error that interrupts an archive.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ArchiveError {
    /// The frames could not be read from the database.
    #[error(transparent)]
    Store(#[from] DatabaseError),
    /// A picture could not be read.
    #[error(transparent)]
    Picture(#[from] ContentError),
    /// Reading a picture was interrupted.
    #[error("reading the picture of frame {frame} was interrupted")]
    PictureRead {
        /// The frame.
        frame: u32,
        /// Error of the content store.
        #[source]
        source: object_store::Error,
    },
    /// A picture's file could not be checked.
    #[error(transparent)]
    Check(#[from] PictureError),
    /// A picture's file is missing or damaged.
    #[error("the picture of frame {0} is missing or damaged; it is rendered again")]
    PictureMissing(u32),
    /// The archive format cannot represent it.
    #[error("the archive could not be written")]
    Zip(#[from] zip::result::ZipError),
    /// The archive format cannot represent it.
    #[error("the archive could not be written")]
    Write(#[from] io::Error),
}

/// Buffer for the archive's bytes until the next chunk is sent.
#[derive(Clone, Debug, Default)]
struct SharedBuffer(Arc<Mutex<Vec<u8>>>);

impl SharedBuffer {
    fn size_bytes(&self) -> usize {
        self.0.lock().expect("no holder panics").len()
    }

    fn empty(&self) -> Bytes {
        std::mem::take(&mut *self.0.lock().expect("no holder panics")).into()
    }
}

impl Write for SharedBuffer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().expect("no holder panics").extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Picture being written into the archive.
struct ArchiveEntry {
    frame: u32,
    bytes: BoxStream<'static, object_store::Result<Bytes>>,
}

/// Archive in progress.
pub(crate) struct Archive {
    queue: Queue,
    content: Arc<BlobStore>,
    pictures: Arc<Pictures>,
    frames: FrameSet,
    buffer: SharedBuffer,
    /// `None` once everything is written.
    writer: Option<ZipWriter<StreamWriter<SharedBuffer>>>,
    waiting: VecDeque<StoredFrame>,
    next_frame: u32,
    picture: Option<ArchiveEntry>,
}

impl Archive {
    /// Starts an archive of the stored pictures among these frames.
    pub(crate) fn new(queue: Queue, content: Arc<BlobStore>, pictures: Arc<Pictures>, frames: FrameSet) -> Self {
        let buffer = SharedBuffer::default();
        let writer = Some(ZipWriter::new_stream(buffer.clone()));
        Self {
            queue,
            content,
            pictures,
            frames,
            buffer,
            writer,
            waiting: VecDeque::new(),
            next_frame: 0,
            picture: None,
        }
    }

    /// Next chunk; `None` at the end.
    pub(crate) async fn next(&mut self) -> Result<Option<Bytes>, ArchiveError> {
        while self.buffer.size_bytes() < CHUNK_BYTES {
            let Some(writer) = &mut self.writer else { break };
            if let Some(picture) = &mut self.picture {
                let frame = picture.frame;
                match picture.bytes.next().await {
                    Some(Ok(bytes)) => writer.write_all(&bytes)?,
                    Some(Err(source)) => return Err(ArchiveError::PictureRead { frame, source }),
                    None => self.picture = None,
                }
            } else if !self.begin_next().await?
                && let Some(writer) = self.writer.take()
            {
                writer.finish()?;
            }
        }
        Ok(Some(self.buffer.empty()).filter(|piece| !piece.is_empty()))
    }

    /// Starts the next picture; false if there is none.
    async fn begin_next(&mut self) -> Result<bool, ArchiveError> {
        if self.waiting.is_empty() {
            self.waiting = self.queue.stored_frames(self.frames.job, self.next_frame, FRAMES_PER_PAGE).await?.into();
        }
        let Some(frame) = self.waiting.pop_front() else { return Ok(false) };
        self.next_frame = frame.number + 1;
        let gone = || ArchiveError::PictureMissing(frame.number);
        let PictureState::Intact(name) = self.pictures.check(&frame.picture, frame.size_bytes).await? else {
            return Err(gone());
        };
        let (_, bytes) = self.content.get(ContentKind::Picture, &name, None).await?.ok_or_else(gone)?;
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .unix_permissions(FILE_MODE)
            .large_file(frame.size_bytes >= u64::from(u32::MAX));
        if let Some(writer) = &mut self.writer {
            writer.start_file(self.frames.file_name(frame.number), options)?;
        }
        self.picture = Some(ArchiveEntry { frame: frame.number, bytes });
        Ok(true)
    }
}
