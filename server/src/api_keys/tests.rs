//! Tests of API keys with a manual clock: room for more keys, expiry, last use, and reloading.

use super::*;
use crate::clock::ManualClock;
use crate::db;

async fn empty() -> (ApiKeys, ManualClock, tempfile::TempDir) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let store = Arc::new(Database::open(folder.path()).await.expect("opens"));
    let (clock, hand) = Clock::manual();
    (ApiKeys::open(store, clock).await.expect("opens"), hand, folder)
}

fn new(name: &str) -> NewApiKey {
    NewApiKey {
        name: name.to_owned(),
        scopes: vec![Scope::Admin],
        expires_in_seconds: None,
        max_jobs: None,
        max_rays: None,
        requests_per_second: None,
        max_priority: None,
    }
}

async fn create(keys: &ApiKeys, name: &str) -> IssuedApiKey {
    keys.create(new(name)).await.expect("a key")
}

fn live(keys: &ApiKeys, secret: &str) -> Arc<ApiKey> {
    match keys.find(secret) {
        KeyLookup::Live(key) => key,
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn a_farm_has_at_most_1000_keys_without_the_revoked_ones() {
    let (keys, _, _folder) = empty().await;
    let insert = "INSERT INTO key (id, name, digest, may_submit, may_read, may_work, may_administer, created_at_ms,
                      revoked_at_ms) VALUES (?, ?, ?, 0, 0, 0, 1, 0, ?)";
    keys.store
        .write(Durability::Relaxed, move |connection| {
            Box::pin(async move {
                for number in 1..=1000_i64 {
                    let digest = blake3::hash(&number.to_le_bytes());
                    let insert = db::query(insert).bind(format!("key_{number}")).bind(format!("name_{number}"));
                    let insert = insert.bind(&digest.as_bytes()[..]).bind((number == 1).then_some(5_i64));
                    insert.execute(&mut *connection).await?;
                }
                Ok(())
            })
        })
        .await
        .expect("inserted");
    keys.refresh().await.expect("read");
    create(&keys, "last").await;
    assert!(matches!(keys.create(new("surplus")).await, Err(ApiKeyError::TooMany)));
}

#[tokio::test]
async fn a_key_that_expires_makes_room_for_another_one_of_its_name() {
    let (keys, hand, _folder) = empty().await;
    create(&keys, "other").await;
    for _ in 0..2 {
        keys.create(NewApiKey { expires_in_seconds: Some(1), ..new("anna") }).await.expect("a key");
    }
    hand.advance(Duration::from_millis(999));
    assert!(matches!(keys.create(new("anna")).await, Err(ApiKeyError::TooManyLive { .. })));
    hand.advance(Duration::from_millis(1));
    create(&keys, "anna").await;
}

#[tokio::test]
async fn last_use_of_a_key_is_stored_once_a_minute() {
    let (keys, hand, _folder) = empty().await;
    let (used, _unused) = (create(&keys, "used").await, create(&keys, "unused").await);
    let stored = async || {
        keys.write_uses().await.expect("written");
        let rows = rows::all(keys.store.readers()).await.expect("read");
        rows.iter().map(|row| row.last_used_at_ms).collect::<Vec<_>>()
    };
    assert_eq!(stored().await, [None, None], "newest first");
    for (after_ms, expected_ms) in [(0, 0), (59_999, 0), (1, 60_000), (30_000, 60_000)] {
        hand.advance(Duration::from_millis(after_ms));
        live(&keys, &used.secret);
        assert_eq!(stored().await, [None, Some(expected_ms)], "{after_ms} ms later");
    }
}

#[tokio::test]
async fn revoking_a_key_ends_only_its_requests() {
    let (keys, _, _folder) = empty().await;
    let (first, second) = (create(&keys, "anna").await, create(&keys, "anna").await);
    let other = create(&keys, "berta").await;
    let [first_key, second_key, other_key] = [&first, &second, &other].map(|issued| live(&keys, &issued.secret));
    let revoked = |all: Vec<ApiKeyView>| all.into_iter().map(|key| key.id).collect::<Vec<_>>();
    assert_eq!(revoked(keys.revoke(&first.key.id).await.expect("revoked")), [&*first.key.id]);
    let ended = || [&first_key, &second_key, &other_key].map(|key| key.revoked().is_cancelled());
    assert_eq!(ended(), [true, false, false]);
    assert!(matches!(keys.find(&first.secret), KeyLookup::Revoked));
    assert_eq!(revoked(keys.revoke("anna").await.expect("revoked")), [&*second.key.id], "the first is revoked already");
    assert_eq!(ended(), [true, true, false]);
    assert!(matches!(keys.revoke("anna").await, Err(ApiKeyError::Unknown(_))));
    live(&keys, &other.secret);
    assert_eq!(keys.live(), 1);
}

#[tokio::test]
async fn a_key_that_expired_by_a_jump_of_the_wall_clock_lives_again() {
    let (keys, hand, _folder) = empty().await;
    create(&keys, "other").await;
    let issued = keys.create(NewApiKey { expires_in_seconds: Some(600), ..new("anna") }).await.expect("a key");
    let before = live(&keys, &issued.secret);
    hand.shift_wall_clock(3_600_000);
    keys.refresh().await.expect("read");
    assert!(matches!(keys.find(&issued.secret), KeyLookup::Expired));
    assert!(before.revoked().is_cancelled(), "its open requests have ended");
    hand.shift_wall_clock(-3_600_000);
    keys.refresh().await.expect("read");
    let after = live(&keys, &issued.secret);
    assert!(!after.revoked().is_cancelled(), "its new requests go on");
    keys.refresh().await.expect("read");
    assert!(live(&keys, &issued.secret).revoked().clone().run_until_cancelled(async {}).await.is_some());
    keys.revoke("anna").await.expect("revoked");
    assert!(after.revoked().is_cancelled());
}
