//! The values that were made last, by their keys.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// Values that were used last, the latest first.
pub(crate) type Recent<K, V> = Mutex<VecDeque<(K, Arc<V>)>>;

/// The value of a key.
pub(crate) fn find<K, V>(values: &Recent<K, V>, is_wanted: impl Fn(&K) -> bool) -> Option<Arc<V>> {
    let mut values = values.lock().unwrap_or_else(PoisonError::into_inner);
    let place = values.iter().position(|(key, _)| is_wanted(key))?;
    let found = values.remove(place)?;
    let value = found.1.clone();
    values.push_front(found);
    Some(value)
}

/// Forgets values.
pub(crate) fn forget<K, V>(values: &Recent<K, V>, is_forgotten: impl Fn(&Arc<V>) -> bool) {
    values.lock().unwrap_or_else(PoisonError::into_inner).retain(|(_, value)| !is_forgotten(value));
}

/// Keeps a value, and at most `limit` in all.
pub(crate) fn insert<K, V>(values: &Recent<K, V>, key: K, value: Arc<V>, limit: usize) -> Arc<V> {
    let mut values = values.lock().unwrap_or_else(PoisonError::into_inner);
    values.push_front((key, value.clone()));
    values.truncate(limit);
    value
}
