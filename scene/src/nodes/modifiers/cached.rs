//! Values derived from a node's numbers, computed at the first use.

use std::sync::OnceLock;

use crate::seek::Invalidate;

/// Value computed once. Ignored by `==`, because it follows from the node's numbers.
#[derive(Clone, Debug)]
pub(super) struct Cached<T>(OnceLock<T>);

impl<T> Cached<T> {
    /// The value, computed by `find` at the first call.
    pub(super) fn get(&self, find: impl FnOnce() -> T) -> &T {
        self.0.get_or_init(find)
    }
}

impl<T> Default for Cached<T> {
    fn default() -> Self {
        Self(OnceLock::new())
    }
}

impl<T> Invalidate for Cached<T> {
    fn invalidate(&mut self) {
        *self = Self::default();
    }
}

impl<T> PartialEq for Cached<T> {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}
