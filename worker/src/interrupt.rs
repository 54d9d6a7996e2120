//! Interrupts a formula wherever it is: between the samples of a pixel, in a march, in a tree of a million nodes.
//!
//! [`check`] is called in every loop of the vector arithmetic, and for every node. It costs two loads until a [`CancelFlag`] is set in this
//! process; if it is the flag of this thread's work, the work is unwound from there. Formulas do not know of it.

use std::cell::{Cell, RefCell};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::CancelFlag;

/// Number of times that a [`CancelFlag`] was set in this process.
static CANCELS: AtomicU64 = AtomicU64::new(0);

thread_local! {
    /// Value of [`CANCELS`] for which this thread knows that its own work goes on.
    static KNOWN_CANCELS: Cell<u64> = const { Cell::new(0) };
    /// Flag of the work that this thread does.
    static FLAG: RefCell<Option<CancelFlag>> = const { RefCell::new(None) };
}

/// Payload of the unwinding.
struct Interrupted;

/// Makes all threads check their flags, because one has been set.
pub(crate) fn announce_cancel() {
    CANCELS.fetch_add(1, Ordering::Release);
}

/// Unwinds if the work of this thread has been cancelled.
#[inline(always)]
pub(crate) fn check() {
    if CANCELS.load(Ordering::Relaxed) != KNOWN_CANCELS.get() {
        check_flag();
    }
}

#[cold]
#[inline(never)]
fn check_flag() {
    // Read before the flag, so that a flag that is set in between is noticed by the next check.
    let cancels = CANCELS.load(Ordering::Acquire);
    if FLAG.with_borrow(|flag| flag.as_ref().is_some_and(CancelFlag::is_cancelled)) {
        resume_unwind(Box::new(Interrupted));
    }
    KNOWN_CANCELS.set(cancels);
}

/// Sets the flag of this thread's work, which the next check reads; returns the previous one.
fn set_flag(flag: Option<CancelFlag>) -> Option<CancelFlag> {
    KNOWN_CANCELS.set(CANCELS.load(Ordering::Relaxed).wrapping_sub(1));
    FLAG.replace(flag)
}

/// Does work on this thread alone, which a check may interrupt; `None` if it was interrupted.
pub(crate) fn interruptible<T>(cancel: &CancelFlag, work: impl FnOnce() -> T) -> Option<T> {
    let outer = set_flag(Some(cancel.clone()));
    let done = catch_unwind(AssertUnwindSafe(|| {
        check();
        work()
    }));
    set_flag(outer);
    match done {
        Ok(done) => Some(done),
        Err(payload) if payload.is::<Interrupted>() => None,
        Err(panic) => resume_unwind(panic),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_work_of_a_set_flag_is_interrupted() {
        let (mine, other) = (CancelFlag::new(), CancelFlag::new());
        let done = interruptible(&mine, || {
            other.cancel();
            check();
            "goes on"
        });
        assert_eq!(done, Some("goes on"));
        let done = interruptible(&mine, || {
            mine.cancel();
            check();
            "not reached"
        });
        assert_eq!(done, None);
        assert_eq!(interruptible(&mine, || "not begun"), None);
        check();
    }

    #[test]
    fn a_panic_stays_a_panic() {
        let panicked = catch_unwind(|| interruptible(&CancelFlag::new(), || resume_unwind(Box::new("a fault"))));
        assert_eq!(panicked.expect_err("it panics").downcast_ref::<&str>(), Some(&"a fault"));
    }
}
