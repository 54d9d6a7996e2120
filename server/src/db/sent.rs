//! Texts that a test has sent to the engine, so that their number can be pinned: each is a round trip to PostgreSQL, and
//! two switches between threads with a file.

use std::cell::RefCell;

thread_local! {
    /// Texts of this thread. A test's runtime has one thread.
    static SENT: RefCell<Vec<String>> = RefCell::default();
}

/// Records a text.
pub(super) fn record(text: &str) {
    SENT.with_borrow_mut(|sent| sent.push(text.to_owned()));
}

/// Takes the recorded texts.
pub(crate) fn take() -> Vec<String> {
    SENT.take()
}
