//! Ends a recording or a compilation that takes long, when a flag is set: by unwinding, so that no formula handles it.

use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

thread_local! {
    /// The flag of the work in progress on this thread.
    static FLAG: RefCell<Option<Arc<AtomicBool>>> = const { RefCell::new(None) };
}

/// The flag of some work was set before it was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

/// Does work on this thread, unless the flag is set before it is done: recordings and compilations look at it.
pub fn until_set<T>(flag: &Arc<AtomicBool>, work: impl FnOnce() -> T) -> Result<T, Interrupted> {
    let outer = FLAG.replace(Some(flag.clone()));
    let done = catch_unwind(AssertUnwindSafe(work));
    FLAG.set(outer);
    match done {
        Ok(done) => Ok(done),
        Err(payload) if payload.is::<Interrupted>() => Err(Interrupted),
        Err(payload) => resume_unwind(payload),
    }
}

/// Ends the work in progress on this thread if its flag is set.
pub(crate) fn check() {
    let is_set = FLAG.with_borrow(|flag| flag.as_ref().is_some_and(|flag| flag.load(Ordering::Relaxed)));
    if is_set {
        // Unlike a panic, this runs no hook, which would print a message.
        resume_unwind(Box::new(Interrupted));
    }
}

#[cfg(test)]
mod tests {
    use math::real::Real;

    use super::*;
    use crate::{Evaluator, Expr, Tape, record};

    /// A formula of some 30,000 values.
    fn long() -> Tape {
        record(|recording| {
            recording.entry("long", |[x]: [Expr; 1]| {
                let steps = (0..10_000).map(|step| x.constant(step as f32));
                vec![steps.fold(x, |sum, step| (sum * step + x).sqrt())]
            });
        })
    }

    #[test]
    fn work_ends_when_its_flag_is_set_and_leaves_nothing_behind() {
        let (clear, set) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(true)));
        let tape = until_set(&clear, long).expect("the flag is not set");
        assert_eq!(until_set(&set, long).err(), Some(Interrupted), "a recording");
        assert_eq!(until_set(&set, || Evaluator::fastest(&tape)).err(), Some(Interrupted), "machine code");
        assert_eq!(until_set(&set, || tape.to_wgsl()).err(), Some(Interrupted), "source text");
        assert!(long().has_same_code(&tape), "the thread records as before");
        // An outer recording goes on after an inner one has ended.
        let outer = record(|recording| {
            recording.entry("outer", |[x]: [Expr; 1]| {
                assert_eq!(until_set(&set, long).err(), Some(Interrupted));
                vec![x + x.constant(1.0)]
            });
        });
        assert!(Evaluator::fastest(&outer).is_ok());
    }

    #[test]
    #[should_panic(expected = "another panic")]
    fn other_panics_go_on() {
        let _ = until_set(&Arc::default(), || panic!("another panic"));
    }
}
