//! Values derived from a node's numbers, computed at the first use.

use std::sync::OnceLock;

use crate::seek::Invalidate;

/// Value computed once. Ignored by `==`, because it follows from the node's numbers. Boxed, so that nodes stay small.
#[derive(Clone, Debug)]
pub(in super::super) struct Cached<T>(OnceLock<Box<T>>);

impl<T> Cached<T> {
    /// The value, computed by `find` at the first call.
    pub(in super::super) fn get(&self, find: impl FnOnce() -> T) -> &T {
        self.0.get_or_init(|| Box::new(find()))
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

/// Value computed once from numbers that are the same in all frames, so that it outlasts changes of the others.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct Kept<T>(Cached<T>);

impl<T> Kept<T> {
    /// The value, computed by `find` at the first call.
    pub(in super::super) fn get(&self, find: impl FnOnce() -> T) -> &T {
        self.0.get(find)
    }
}

impl<T> Default for Kept<T> {
    fn default() -> Self {
        Self(Cached::default())
    }
}

impl<T> Invalidate for Kept<T> {
    fn invalidate(&mut self) {}
}
