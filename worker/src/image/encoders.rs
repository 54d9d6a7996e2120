//! Thread pool for encoding pictures. It is as large as the renderer's, so that a worker that is limited to
//! some threads uses no more.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

/// Threads for encoding; clones share them.
#[derive(Clone, Debug)]
pub struct Encoders {
    pool: Arc<ThreadPool>,
    /// Number of pictures that are being encoded, or wait for a thread.
    pictures: Arc<AtomicUsize>,
}

/// Threads that encode one picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncodeThreads {
    /// All of the pool: the picture is ready soonest.
    All,
    /// One: most pictures per second, because no thread waits for another.
    One,
}

impl Encoders {
    /// Pool of this many threads, at least one.
    pub fn new(threads: usize) -> Result<Self, ThreadPoolBuildError> {
        let builder = ThreadPoolBuilder::new().num_threads(threads.max(1));
        let pool = builder.thread_name(|index| format!("encode-{index}")).build()?;
        Ok(Self { pool: Arc::new(pool), pictures: Arc::default() })
    }

    /// Number of threads.
    pub fn count(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Encodes a picture on these threads and no others: on all of them if no other picture is being encoded.
    pub fn run<T: Send>(&self, encode: impl FnOnce(EncodeThreads) -> T + Send) -> T {
        let counted = CountedPicture::new(&self.pictures);
        let threads = if counted.is_first { EncodeThreads::All } else { EncodeThreads::One };
        self.pool.install(|| encode(threads))
    }
}

/// Counts a picture until it goes out of scope.
struct CountedPicture<'a> {
    pictures: &'a AtomicUsize,
    is_first: bool,
}

impl<'a> CountedPicture<'a> {
    fn new(pictures: &'a AtomicUsize) -> Self {
        let is_first = pictures.fetch_add(1, Ordering::Relaxed) == 0;
        Self { pictures, is_first }
    }
}

impl Drop for CountedPicture<'_> {
    fn drop(&mut self) {
        self.pictures.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_has_all_threads_unless_another_is_being_encoded() {
        let encoders = Encoders::new(2).expect("starts");
        let inner = encoders.clone();
        let (outer, inner) = encoders.run(|threads| (threads, inner.run(|threads| threads)));
        assert_eq!((outer, inner), (EncodeThreads::All, EncodeThreads::One));
        assert_eq!(encoders.run(|threads| threads), EncodeThreads::All, "the others are finished");
    }
}
