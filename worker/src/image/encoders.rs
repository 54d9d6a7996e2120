//! Thread pool for encoding pictures. It is as large as the renderer's, so that a worker that is limited to
//! some threads uses no more.

use std::sync::Arc;

use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

/// Threads for encoding; clones share them.
#[derive(Clone, Debug)]
pub struct Encoders(Arc<ThreadPool>);

impl Encoders {
    /// Pool of this many threads, at least one.
    pub fn new(threads: usize) -> Result<Self, ThreadPoolBuildError> {
        let builder = ThreadPoolBuilder::new().num_threads(threads.max(1));
        Ok(Self(Arc::new(builder.thread_name(|index| format!("encode-{index}")).build()?)))
    }

    /// Number of threads.
    pub fn count(&self) -> usize {
        self.0.current_num_threads()
    }

    /// Runs a function on these threads and no others.
    pub fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        self.0.install(work)
    }
}
