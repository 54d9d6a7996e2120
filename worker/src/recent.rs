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

/// Forgets the values used longest ago, until the sizes of all are within a limit or only the latest is left.
pub(crate) fn trim<K, V>(values: &Recent<K, V>, limit: usize, size: impl Fn(&K) -> usize) {
    let mut values = values.lock().unwrap_or_else(PoisonError::into_inner);
    let mut total = 0_usize;
    let kept = values.iter().position(|(key, _)| {
        total = total.saturating_add(size(key));
        total > limit
    });
    if let Some(kept) = kept {
        values.truncate(kept.max(1));
    }
}

/// Keeps a value, and at most `limit` in all.
pub(crate) fn insert<K, V>(values: &Recent<K, V>, key: K, value: Arc<V>, limit: usize) -> Arc<V> {
    let mut values = values.lock().unwrap_or_else(PoisonError::into_inner);
    values.push_front((key, value.clone()));
    values.truncate(limit);
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_values_are_kept_up_to_their_sizes() {
        let values = Recent::default();
        for size in [7_usize, 1, 2, 3] {
            insert(&values, size, Arc::new(()), 9);
        }
        let kept = |limit| {
            trim(&values, limit, |&size| size);
            values.lock().expect("nothing panicked").iter().map(|(size, _)| *size).collect::<Vec<_>>()
        };
        assert_eq!(kept(13), [3, 2, 1, 7]);
        assert_eq!(kept(12), [3, 2, 1]);
        assert_eq!(kept(5), [3, 2]);
        assert_eq!(kept(0), [3], "the latest is kept, however large it is");
    }
}
