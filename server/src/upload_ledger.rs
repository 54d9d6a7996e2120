//! Bytes that the workers of each key have sent and not reported: at most as many as their leases need, so that no key
//! fills the store with what no row refers to.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

use crate::blobs::ContentKind;
use crate::clock::monotonic_now;
use crate::queue::UploadNeed;

/// Unreported bytes may be this many times what the leases need: what is sent again, and what leases needed that have
/// just ended.
const SLACK: u64 = 2;
/// Unreported bytes of this age make room for others: a worker reports what it has sent within 200 ms.
const DELETABLE: Duration = Duration::from_secs(5);

/// The unreported uploads of all keys.
#[derive(Debug)]
pub(crate) struct UploadLedger {
    owners: Mutex<HashMap<String, Vec<Upload>>>,
    /// Age at which the store deletes unreported bytes.
    kept: Duration,
    /// Whether they may be deleted before.
    deletes: bool,
}

#[derive(Debug)]
struct Upload {
    name: Name,
    size_bytes: u64,
    /// Bytes that the leases needed then.
    needed_bytes: u64,
    is_stored: bool,
    at: Instant,
}

/// Kind and hash of content.
type Name = (ContentKind, String);

/// An upload in progress; what it reserved is returned unless it is stored.
#[derive(Debug)]
pub(crate) struct Reservation<'a> {
    ledger: &'a UploadLedger,
    owner: String,
    name: Name,
    /// Unreported content that should be deleted for it.
    pub(crate) replaces: Vec<Name>,
}

impl UploadLedger {
    /// For a store that deletes unreported bytes at this age, or earlier if it is asked to.
    pub(crate) fn new(kept: Duration, deletes: bool) -> Self {
        Self { owners: Mutex::default(), kept, deletes }
    }

    fn owners(&self) -> MutexGuard<'_, HashMap<String, Vec<Upload>>> {
        self.owners.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reserves bytes for an upload; `None` if the owner's leases do not need as many.
    pub(crate) fn reserve(
        &self,
        owner: &str,
        name: Name,
        size_bytes: u64,
        need: UploadNeed,
    ) -> Option<Reservation<'_>> {
        self.reserve_at(monotonic_now(), owner, name, size_bytes, need)
    }

    fn reserve_at(
        &self,
        now: Instant,
        owner: &str,
        name: Name,
        size_bytes: u64,
        need: UploadNeed,
    ) -> Option<Reservation<'_>> {
        let mut owners = self.owners();
        for uploads in owners.values_mut() {
            uploads.retain(|upload| now - upload.at < self.kept);
        }
        owners.retain(|_, uploads| !uploads.is_empty());
        let uploads = owners.entry(owner.to_owned()).or_default();
        // The leases of some uploads have ended, for example because their job was cancelled.
        let needed_bytes = uploads.iter().map(|upload| upload.needed_bytes).fold(need.total_bytes, u64::max);
        let others = || uploads.iter().filter(|upload| upload.name != name);
        let mut sum_bytes = others().map(|upload| upload.size_bytes).fold(size_bytes, u64::saturating_add);
        let is_deletable = |upload: &&Upload| self.deletes && upload.is_stored && now - upload.at >= DELETABLE;
        let (mut oldest, mut replaces) = (others().filter(is_deletable), Vec::new());
        while sum_bytes > needed_bytes.saturating_mul(SLACK) {
            let upload = oldest.next()?;
            sum_bytes -= upload.size_bytes;
            replaces.push(upload.name.clone());
        }
        // If it is stored already, its bytes stay when this upload fails.
        let is_stored = uploads.iter().any(|upload| upload.name == name && upload.is_stored);
        uploads.retain(|upload| upload.name != name && !replaces.contains(&upload.name));
        uploads.push(Upload { name: name.clone(), size_bytes, needed_bytes: need.total_bytes, is_stored, at: now });
        Some(Reservation { ledger: self, owner: owner.to_owned(), name, replaces })
    }

    /// Forgets uploads that rows refer to now.
    pub(crate) fn reported(&self, owner: &str, names: &[Name]) {
        let mut owners = self.owners();
        let Some(uploads) = owners.get_mut(owner) else { return };
        uploads.retain(|upload| !names.contains(&upload.name));
        if uploads.is_empty() {
            owners.remove(owner);
        }
    }
}

impl Reservation<'_> {
    /// Keeps the bytes counted until they are reported or deleted.
    pub(crate) fn stored(self) {
        let mut owners = self.ledger.owners();
        for upload in owners.get_mut(&self.owner).into_iter().flatten().filter(|upload| upload.name == self.name) {
            upload.is_stored = true;
        }
    }
}

impl Drop for Reservation<'_> {
    fn drop(&mut self) {
        let mut owners = self.ledger.owners();
        if let Some(uploads) = owners.get_mut(&self.owner) {
            uploads.retain(|upload| upload.is_stored || upload.name != self.name);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEED: UploadNeed = UploadNeed { blob_bytes: 10, picture_bytes: 10, total_bytes: 20 };
    const KEPT: Duration = Duration::from_mins(10);

    fn blob(hash: &str) -> Name {
        (ContentKind::Blob, hash.to_owned())
    }

    #[test]
    fn unreported_bytes_of_an_owner_are_bounded() {
        let ledger = UploadLedger::new(KEPT, true);
        for hash in ["a", "b", "c", "d", "d"] {
            ledger.reserve("key", blob(hash), 10, NEED).expect("within twice the need").stored();
        }
        assert!(ledger.reserve("key", blob("e"), 1, NEED).is_none());
        assert!(ledger.reserve("other", blob("e"), 40, NEED).is_some(), "each owner has its own");
        ledger.reported("key", &[blob("a"), blob("unknown")]);
        drop(ledger.reserve("key", blob("e"), 10, NEED).expect("there is room again"));
        assert!(ledger.reserve("key", blob("f"), 10, NEED).is_some(), "what was not stored is returned");
        assert!(ledger.reserve("third", blob("g"), 1, UploadNeed::default()).is_none(), "nothing is needed");
    }

    #[test]
    fn old_unreported_bytes_make_room() {
        let (ledger, start) = (UploadLedger::new(KEPT, true), monotonic_now());
        let reserve = |later, hash, size_bytes, total_bytes| {
            let need = UploadNeed { total_bytes, ..NEED };
            ledger.reserve_at(start + later, "key", blob(hash), size_bytes, need)
        };
        reserve(Duration::ZERO, "a", 40, 20).expect("room").stored();
        assert!(reserve(Duration::ZERO, "b", 1, 20).is_none(), "it may still be reported");
        let reserved = reserve(DELETABLE, "b", 1, 1).expect("for the old one");
        assert_eq!(reserved.replaces, [blob("a")]);
        drop(reserved);
        reserve(DELETABLE, "c", 2, 1).expect("room").stored();
        assert!(reserve(2 * DELETABLE, "d", 1, 1).expect("for the old one").replaces == [blob("c")]);
    }

    #[test]
    fn stored_bytes_count_after_a_refused_or_broken_upload() {
        let (ledger, start) = (UploadLedger::new(KEPT, true), monotonic_now());
        let reserve = |later, hash, size_bytes| ledger.reserve_at(start + later, "key", blob(hash), size_bytes, NEED);
        reserve(Duration::ZERO, "a", 20).expect("room").stored();
        drop(reserve(Duration::ZERO, "a", 20).expect("the same again"));
        reserve(DELETABLE, "b", 20).expect("room").stored();
        assert!(reserve(DELETABLE, "c", 30).is_none(), "only the first may be deleted for it");
        let reserved = reserve(DELETABLE, "d", 20).expect("for the first");
        assert_eq!(reserved.replaces, [blob("a")], "it has been counted all the time");
    }

    #[test]
    fn bytes_of_leases_that_have_ended_are_allowed() {
        let ledger = UploadLedger::new(KEPT, false);
        ledger.reserve("key", blob("a"), 10, NEED).expect("room").stored();
        let small = UploadNeed { total_bytes: 1, ..NEED };
        assert!(ledger.reserve("key", blob("b"), 2, small).is_some(), "the lease of the first is cancelled");
        assert!(ledger.reserve("other", blob("b"), 3, small).is_none());
    }

    #[test]
    fn what_the_store_has_deleted_does_not_count() {
        let (ledger, start) = (UploadLedger::new(KEPT, false), monotonic_now());
        ledger.reserve_at(start, "key", blob("a"), 40, NEED).expect("room").stored();
        assert!(ledger.reserve_at(start + DELETABLE, "key", blob("b"), 1, NEED).is_none());
        assert!(ledger.reserve_at(start + KEPT, "key", blob("b"), 40, NEED).is_some());
    }
}
