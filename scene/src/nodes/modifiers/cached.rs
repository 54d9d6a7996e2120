//! What follows from a node's numbers, found once when it is first asked for.

use std::sync::OnceLock;

use crate::seek::Renew;

/// A value found once. It says nothing that the node's numbers do not: all are equal.
#[derive(Clone, Debug)]
pub(super) struct Cached<T>(OnceLock<T>);

impl<T> Cached<T> {
    /// The value, from `find` if nobody has asked before.
    #[inline(always)]
    pub(super) fn get(&self, find: impl FnOnce() -> T) -> &T {
        self.0.get_or_init(find)
    }
}

impl<T> Default for Cached<T> {
    fn default() -> Self {
        Self(OnceLock::new())
    }
}

impl<T> Renew for Cached<T> {
    fn renew(&mut self) {
        *self = Self::default();
    }
}

impl<T> PartialEq for Cached<T> {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}
