//! API key: its scopes, expiry and limits.

use std::num::NonZeroU32;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use governor::clock::DefaultClock;
use governor::middleware::StateInformationMiddleware;
use governor::state::{InMemoryState, NotKeyed};
use governor::{Quota, RateLimiter};
use proto::api_key::{ApiKeyState, ApiKeyView, NewApiKey, Scope};
use subtle::ConstantTimeEq;
use tokio_util::sync::CancellationToken;

use super::{ApiKeyError, MAX_LIFE_SECONDS, MAX_NAME_CHARACTERS, RESERVED};
use crate::clock::rfc3339;

/// Maximum rate limit of a key, in requests per second.
const MAX_REQUESTS_PER_SECOND: u32 = 100_000;
/// Default rate limit of a key, in requests per second.
pub(crate) const REQUESTS_PER_SECOND: u32 = 1000;
/// Lowest and highest priority of a job.
const PRIORITIES: std::ops::RangeInclusive<i32> = -100..=100;
/// Default highest priority of a key's jobs: users may let their jobs wait, and administrators may prefer some.
const MAX_PRIORITY: i32 = 0;
/// Sentinel for a key that was never used.
const NEVER: i64 = i64::MIN;

/// Rate limiter of one caller.
pub(crate) type KeyLimiter = RateLimiter<NotKeyed, InMemoryState, DefaultClock, StateInformationMiddleware>;

/// Set of scopes; each bit's position is the scope's index in [`Scope::ALL`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Scopes([bool; Scope::ALL.len()]);

impl Scopes {
    /// Whether the set permits this scope; `admin` permits everything.
    pub(crate) fn is_allowed(self, scope: Scope) -> bool {
        self.has(scope) || self.has(Scope::Admin)
    }

    /// Set of the scopes for which `test` returns true.
    pub(super) fn from_fn(has: impl Fn(Scope) -> bool) -> Self {
        Self(Scope::ALL.map(has))
    }

    /// Whether the set has exactly this scope.
    pub(crate) fn has(self, scope: Scope) -> bool {
        self.names().contains(&scope)
    }

    /// The scopes of the set.
    pub(crate) fn names(self) -> Vec<Scope> {
        Scope::ALL.into_iter().zip(self.0).filter_map(|(scope, has)| has.then_some(scope)).collect()
    }
}

/// Validated request for a key.
#[derive(Clone, Debug)]
pub(super) struct KeySpec {
    pub(super) name: String,
    pub(super) scopes: Scopes,
    pub(super) max_jobs: Option<u32>,
    pub(super) max_rays: Option<i64>,
    pub(super) requests_per_second: Option<u32>,
    pub(super) max_priority: Option<i32>,
    pub(super) created_at_ms: i64,
    pub(super) expires_at_ms: Option<i64>,
}

impl KeySpec {
    /// Validates a request for a key.
    pub(super) fn check(new: NewApiKey, now_ms: i64) -> Result<Self, ApiKeyError> {
        let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
        let length = new.name.len();
        if length == 0
            || length > MAX_NAME_CHARACTERS
            || !new.name.bytes().all(is_plain)
            || RESERVED.contains(&&*new.name)
        {
            return Err(ApiKeyError::Name(new.name));
        }
        if new.scopes.is_empty() {
            return Err(ApiKeyError::NoScope);
        }
        check_range("the lifetime in seconds", new.expires_in_seconds, MAX_LIFE_SECONDS)?;
        check_range("the number of jobs", new.max_jobs.map(u64::from), u32::MAX.into())?;
        check_range("the number of rays", new.max_rays, i64::MAX.unsigned_abs())?;
        check_range(
            "the number of requests per second",
            new.requests_per_second.map(u64::from),
            MAX_REQUESTS_PER_SECOND.into(),
        )?;
        if let Some(priority) = new.max_priority.filter(|priority| !PRIORITIES.contains(priority)) {
            return Err(ApiKeyError::Priority(priority));
        }
        Ok(Self {
            scopes: Scopes::from_fn(|scope| new.scopes.contains(&scope)),
            name: new.name,
            max_jobs: new.max_jobs,
            max_rays: new.max_rays.map(u64::cast_signed),
            requests_per_second: new.requests_per_second,
            max_priority: new.max_priority,
            created_at_ms: now_ms,
            expires_at_ms: new.expires_in_seconds.map(|seconds| now_ms + (seconds * 1000).cast_signed()),
        })
    }
}

fn check_range(what: &'static str, found: Option<u64>, most: u64) -> Result<(), ApiKeyError> {
    match found {
        Some(found) if found == 0 || found > most => Err(ApiKeyError::Limit { what, found, most }),
        Some(_) | None => Ok(()),
    }
}

/// Row of a key in the table.
#[derive(Clone, Debug)]
pub(super) struct KeyRow {
    pub(super) number: i64,
    pub(super) id: String,
    pub(super) name: String,
    pub(super) digest: [u8; 32],
    pub(super) scopes: Scopes,
    pub(super) max_jobs: Option<i64>,
    pub(super) max_rays: Option<i64>,
    pub(super) requests_per_second: Option<u32>,
    pub(super) max_priority: Option<i32>,
    pub(super) created_at_ms: i64,
    pub(super) expires_at_ms: Option<i64>,
    pub(super) revoked_at_ms: Option<i64>,
    pub(super) last_used_at_ms: Option<i64>,
}

/// Key with its runtime state.
#[derive(Debug)]
pub(crate) struct ApiKey {
    row: KeyRow,
    ongoing: Arc<KeyRuntime>,
}

/// State that survives a reload of the table.
#[derive(Debug)]
struct KeyRuntime {
    revoked: CancellationToken,
    limiter: KeyLimiter,
    used_ms: AtomicI64,
}

impl KeyRow {
    /// Whether the key is valid at this time of the wall clock.
    pub(super) fn is_live(&self, now_ms: i64) -> bool {
        self.revoked_at_ms.is_none() && self.expires_at_ms.is_none_or(|end_ms| now_ms < end_ms)
    }
}

impl ApiKey {
    /// Builds the key of a row; `known` is the same key as loaded before, whose state it shares.
    pub(super) fn new(row: KeyRow, known: Option<&Self>) -> Self {
        let ongoing = known.map_or_else(
            || {
                let rate = row.requests_per_second.and_then(NonZeroU32::new);
                let rate = rate.unwrap_or(NonZeroU32::new(REQUESTS_PER_SECOND).unwrap_or(NonZeroU32::MIN));
                Arc::new(KeyRuntime {
                    revoked: CancellationToken::new(),
                    limiter: RateLimiter::direct(Quota::per_second(rate)).with_middleware(),
                    used_ms: AtomicI64::new(NEVER),
                })
            },
            |known| Arc::clone(&known.ongoing),
        );
        Self { row, ongoing }
    }

    pub(super) fn number(&self) -> i64 {
        self.row.number
    }

    pub(super) fn has(&self, digest: &[u8; 32]) -> bool {
        self.row.digest.ct_eq(digest).into()
    }

    pub(super) fn is_revoked(&self) -> bool {
        self.row.revoked_at_ms.is_some()
    }

    pub(super) fn is_live(&self, now_ms: i64) -> bool {
        self.row.is_live(now_ms)
    }

    pub(super) fn revoke_if_expired(&self, now_ms: i64) {
        if !self.is_live(now_ms) {
            self.ongoing.revoked.cancel();
        }
    }

    pub(super) fn mark_used(&self, now_ms: i64) {
        self.ongoing.used_ms.fetch_max(now_ms, Ordering::Relaxed);
    }

    /// Time of the last use since the server started.
    pub(super) fn last_used_ms(&self) -> Option<i64> {
        let used_ms = self.ongoing.used_ms.load(Ordering::Relaxed);
        (used_ms != NEVER).then_some(used_ms)
    }

    /// Id of the key.
    pub(crate) fn id(&self) -> &str {
        &self.row.id
    }

    /// Name of the owner.
    pub(crate) fn name(&self) -> &str {
        &self.row.name
    }

    /// Its scopes.
    pub(crate) fn scopes(&self) -> Scopes {
        self.row.scopes
    }

    /// Maximum number of unfinished jobs of its name.
    pub(crate) fn max_jobs(&self) -> Option<i64> {
        self.row.max_jobs
    }

    /// Maximum number of rays of the unfinished jobs of its name together.
    pub(crate) fn max_rays(&self) -> Option<i64> {
        self.row.max_rays
    }

    /// Highest priority of its jobs.
    pub(crate) fn max_priority(&self) -> i32 {
        let default = if self.row.scopes.has(Scope::Admin) { *PRIORITIES.end() } else { MAX_PRIORITY };
        self.row.max_priority.unwrap_or(default)
    }

    /// Cancelled when the key is no longer valid.
    pub(crate) fn revoked(&self) -> &CancellationToken {
        &self.ongoing.revoked
    }

    /// Rate limiter of its requests.
    pub(crate) fn limiter(&self) -> &KeyLimiter {
        &self.ongoing.limiter
    }

    /// Public view of the key.
    pub(super) fn view(&self, now_ms: i64) -> ApiKeyView {
        let row = &self.row;
        let state = match (self.is_revoked(), self.is_live(now_ms)) {
            (true, _) => ApiKeyState::Revoked,
            (false, true) => ApiKeyState::Live,
            (false, false) => ApiKeyState::Expired,
        };
        ApiKeyView {
            id: row.id.clone(),
            name: row.name.clone(),
            state,
            scopes: row.scopes.names(),
            max_jobs: row.max_jobs.and_then(|jobs| u32::try_from(jobs).ok()),
            max_rays: row.max_rays.map(i64::unsigned_abs),
            requests_per_second: row.requests_per_second,
            max_priority: self.max_priority(),
            created_at: rfc3339(row.created_at_ms),
            expires_at: row.expires_at_ms.map(rfc3339),
            revoked_at: row.revoked_at_ms.map(rfc3339),
            last_used_at: self.last_used_ms().max(row.last_used_at_ms).map(rfc3339),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn new(name: &str) -> NewApiKey {
        NewApiKey {
            name: name.to_owned(),
            scopes: vec![Scope::Read],
            expires_in_seconds: None,
            max_jobs: None,
            max_rays: None,
            requests_per_second: None,
            max_priority: None,
        }
    }

    fn is_fine(key: NewApiKey) -> bool {
        KeySpec::check(key, 0).is_ok()
    }

    #[test]
    fn limits_accept_their_maximum_and_reject_more() {
        let (life, rays) = (Some(MAX_LIFE_SECONDS), Some(i64::MAX.unsigned_abs()));
        assert!(is_fine(NewApiKey { expires_in_seconds: life, max_rays: rays, ..new("a") }));
        assert!(!is_fine(NewApiKey { expires_in_seconds: life.map(|seconds| seconds + 1), ..new("a") }));
        assert!(!is_fine(NewApiKey { max_rays: rays.map(|rays| rays + 1), ..new("a") }));
        assert!(is_fine(NewApiKey { max_jobs: Some(1), requests_per_second: Some(100_000), ..new("a") }));
        assert!(!is_fine(NewApiKey { requests_per_second: Some(100_001), ..new("a") }));
        for (priority, fine) in [(-101, false), (-100, true), (100, true), (101, false)] {
            assert_eq!(is_fine(NewApiKey { max_priority: Some(priority), ..new("a") }), fine, "{priority}");
        }
        assert!(
            !is_fine(NewApiKey { max_jobs: Some(0), ..new("a") })
                && !is_fine(NewApiKey { max_rays: Some(0), ..new("a") })
        );
        assert!(is_fine(new(&"x".repeat(64))) && is_fine(new("A-b_c.9")));
        for name in ["", &"x".repeat(65), "local", "pool", "a b", "ä"] {
            assert!(!is_fine(new(name)), "{name}");
        }
    }

    fn row(expires_at_ms: Option<i64>, revoked_at_ms: Option<i64>) -> KeyRow {
        let scopes = Scopes::from_fn(|scope| scope == Scope::Submit);
        KeyRow {
            number: 7,
            id: "key_1".to_owned(),
            name: "anna".to_owned(),
            digest: [1; 32],
            scopes,
            max_jobs: Some(3),
            max_rays: Some(500),
            requests_per_second: Some(9),
            max_priority: None,
            created_at_ms: 0,
            expires_at_ms,
            revoked_at_ms,
            last_used_at_ms: Some(1000),
        }
    }

    #[test]
    fn an_expired_key_ends_its_open_requests() {
        let key = ApiKey::new(row(Some(5000), None), None);
        assert!(key.is_live(4999) && !key.is_live(5000));
        key.revoke_if_expired(4999);
        assert!(!key.revoked().is_cancelled());
        // Reloading the key must not lose its open requests.
        let again = ApiKey::new(row(Some(5000), Some(2000)), Some(&key));
        assert!(!again.is_live(3000) && again.is_revoked());
        again.revoke_if_expired(3000);
        assert!(key.revoked().is_cancelled());
        let states = [key.view(0).state, key.view(5000).state, again.view(0).state];
        assert_eq!(states, [ApiKeyState::Live, ApiKeyState::Expired, ApiKeyState::Revoked]);
    }

    #[test]
    fn the_view_shows_scopes_limits_and_last_use() {
        let key = ApiKey::new(row(None, None), None);
        assert_eq!(key.last_used_ms(), None);
        assert_eq!(key.view(0).last_used_at.as_deref(), Some("1970-01-01T00:00:01.000Z"));
        key.mark_used(3000);
        key.mark_used(2000);
        assert_eq!(key.last_used_ms(), Some(3000));
        let view = key.view(0);
        assert_eq!(view.last_used_at.as_deref(), Some("1970-01-01T00:00:03.000Z"));
        assert_eq!((view.max_jobs, view.max_rays, view.requests_per_second), (Some(3), Some(500), Some(9)));
        assert_eq!((&*view.id, &*view.name, &*view.scopes), ("key_1", "anna", &[Scope::Submit][..]));
        assert!(key.scopes().is_allowed(Scope::Submit) && !key.scopes().is_allowed(Scope::Admin));
        assert!(key.has(&[1; 32]) && !key.has(&[2; 32]));
    }
}
