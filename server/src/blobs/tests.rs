//! One suite for every kind of store, and the errors of a bucket's endpoint.

mod hostile;

use std::io;
use std::sync::atomic::{AtomicUsize, Ordering};

use futures_util::future::join_all;
use futures_util::stream::TryStreamExt;
use object_store::PutPayload;

use super::*;
use crate::blobs::bucket::Settings;
use crate::db::FarmId;
use crate::delivery_check::HEAD_BYTES;
use crate::seaweedfs::SeaweedFs;

mod endpoint;

const PICTURE: ContentKind = ContentKind::Picture;
const BLOB: ContentKind = ContentKind::Blob;
/// Bytes at the start of a file that its check reads.
const HEAD: usize = HEAD_BYTES as usize;
/// Sent to S3 in three parts, and written to a file in 81 pieces.
const LARGE_BYTES: usize = (20 << 20) + 5;

fn name(bytes: &[u8]) -> ContentHash {
    ContentHash::parse(blake3::hash(bytes).to_hex().as_str()).expect("a hash is a name")
}

fn chunks(bytes: &Bytes) -> impl Stream<Item = io::Result<Bytes>> + Unpin + use<> {
    let bytes = bytes.clone();
    let starts = (0..bytes.len()).step_by(100_000);
    futures_util::stream::iter(
        starts.map(move |start| Ok(bytes.slice(start..(start + 100_000).min(bytes.len())))).collect::<Vec<_>>(),
    )
}

/// Bytes that differ everywhere.
fn content(seed: u8, size_bytes: usize) -> Bytes {
    let mut bytes = vec![0; size_bytes];
    blake3::Hasher::new().update(&[seed]).finalize_xof().fill(&mut bytes);
    bytes.into()
}

async fn put(store: &BlobStore, kind: ContentKind, bytes: &Bytes) -> ContentHash {
    let name = name(bytes);
    store.put(kind, &name, chunks(bytes), u64::MAX).await.expect("stores");
    name
}

async fn read(
    store: &BlobStore,
    kind: ContentKind,
    name: &ContentHash,
    range: Option<std::ops::Range<u64>>,
) -> Option<Bytes> {
    let (size_bytes, bytes) = store.get(kind, name, range).await.expect("reads")?;
    let bytes = bytes.try_collect::<Vec<_>>().await.expect("reads").concat();
    assert_eq!(bytes.len() as u64, size_bytes);
    Some(bytes.into())
}

async fn names(store: &BlobStore, kind: ContentKind) -> Vec<String> {
    let listed = store.list(kind).map_ok(|(name, _)| name.as_str().to_owned());
    let mut names: Vec<_> = listed.try_collect().await.expect("lists");
    names.sort();
    names
}

async fn state(store: &BlobStore, name: &ContentHash, size_bytes: usize) -> FileState {
    store.file_state(PICTURE, name, size_bytes as u64).await.expect("looks")
}

/// Overwrites content, as a torn write or a defective disk would.
async fn damage(store: &BlobStore, name: &ContentHash, bytes: Bytes) {
    store.store(PICTURE).put(&store.path(PICTURE, name), PutPayload::from(bytes)).await.expect("writes");
}

/// The contract of every kind of store. It must be empty.
async fn conforms(store: &BlobStore) {
    missing_content_is_none(store).await;
    content_is_stored_once_and_read_in_ranges(store).await;
    wrong_bytes_are_rejected(store).await;
    one_name_is_stored_by_many_at_once(store).await;
    large_content_is_stored(store).await;
    torn_content_is_found_by_its_hash_and_mended(store).await;
    content_is_listed_and_deleted(store).await;
}

async fn missing_content_is_none(store: &BlobStore) {
    let nothing = name(b"nothing");
    assert_eq!(read(store, PICTURE, &nothing, None).await, None);
    assert_eq!(read(store, PICTURE, &nothing, Some(0..1)).await, None);
    assert!(store.ends(BLOB, &nothing).await.expect("looks").is_none());
    assert_eq!(state(store, &nothing, 7).await, FileState::Missing);
    assert!(!store.delete(PICTURE, &nothing).await.expect("deletes"));
    assert!(names(store, PICTURE).await.is_empty() && names(store, BLOB).await.is_empty());
    store.check_usable().await.expect("usable");
}

async fn content_is_stored_once_and_read_in_ranges(store: &BlobStore) {
    for size_bytes in [0, 1, 11, 12, 13, HEAD, HEAD + 1, 300_000] {
        let bytes = content(1, size_bytes);
        let name = put(store, PICTURE, &bytes).await;
        assert_eq!(put(store, PICTURE, &bytes).await, name, "twice is once");
        assert_eq!(read(store, PICTURE, &name, None).await, Some(bytes.clone()));
        assert_eq!(state(store, &name, size_bytes).await, FileState::Intact);
        assert_eq!(state(store, &name, size_bytes + 1).await, FileState::Damaged, "another size was recorded");
        let ends = store.ends(PICTURE, &name).await.expect("reads").expect("is there");
        assert_eq!(ends.size_bytes, size_bytes as u64);
        assert_eq!(ends.head, bytes.slice(..size_bytes.min(HEAD)));
        assert_eq!(ends.tail, bytes.slice(size_bytes.saturating_sub(12)..));
        for range in [0..1, 5..11, size_bytes.saturating_sub(3)..size_bytes] {
            if range.end <= size_bytes && !range.is_empty() {
                let part = read(store, PICTURE, &name, Some(range.start as u64..range.end as u64)).await;
                assert_eq!(part, Some(bytes.slice(range)));
            }
        }
        assert_eq!(read(store, BLOB, &name, None).await, None, "the kinds are apart");
    }
    assert_eq!(names(store, PICTURE).await.len(), 8);
}

async fn wrong_bytes_are_rejected(store: &BlobStore) {
    let before = names(store, PICTURE).await;
    for size_bytes in [5, 3 * WRITE_CHUNK_BYTES + 5, LARGE_BYTES] {
        let wrong = store.put(PICTURE, &name(b"other"), chunks(&content(2, size_bytes)), u64::MAX).await;
        assert!(matches!(wrong, Err(ContentError::Mismatch { .. })), "{wrong:?}");
        let broken = chunks(&content(2, size_bytes)).chain(futures_util::stream::iter([Err(io::Error::other("cut"))]));
        let broken = store.put(PICTURE, &name(&content(2, size_bytes)), broken, u64::MAX).await;
        assert!(matches!(broken, Err(ContentError::Broken(_))), "{broken:?}");
    }
    let too_large = futures_util::stream::repeat(content(2, 1 << 20)).map(Ok);
    let too_large = store.put(BLOB, &name(b"other"), too_large, u64::MAX).await;
    assert!(matches!(too_large, Err(ContentError::TooLarge { .. })), "{too_large:?}");
    assert_eq!(names(store, PICTURE).await, before, "a rejected write leaves nothing");
    assert!(names(store, BLOB).await.is_empty());
}

async fn one_name_is_stored_by_many_at_once(store: &BlobStore) {
    for bytes in [content(3, 100), content(3, 400_000), content(3, 9 << 20)] {
        let puts = (0..if bytes.len() > 1 << 20 { 3 } else { 16 }).map(|_| put(store, BLOB, &bytes));
        let stored = join_all(puts).await;
        assert_eq!(read(store, BLOB, &stored[0], None).await, Some(bytes));
        assert!(store.delete(BLOB, &stored[0]).await.expect("deletes"));
    }
}

async fn large_content_is_stored(store: &BlobStore) {
    let bytes = content(4, LARGE_BYTES);
    let name = put(store, PICTURE, &bytes).await;
    assert_eq!(put(store, PICTURE, &bytes).await, name, "twice is once");
    assert_eq!(state(store, &name, LARGE_BYTES).await, FileState::Intact);
    assert_eq!(read(store, PICTURE, &name, None).await, Some(bytes.clone()));
    let parts_meet = (8 << 20) - 7..(8 << 20) + 7;
    let part = read(store, PICTURE, &name, Some(parts_meet.start as u64..parts_meet.end as u64)).await;
    assert_eq!(part, Some(bytes.slice(parts_meet)));
    let ends = store.ends(PICTURE, &name).await.expect("reads").expect("is there");
    assert_eq!((ends.size_bytes, ends.tail), (LARGE_BYTES as u64, bytes.slice(LARGE_BYTES - 12..)));
    assert!(store.delete(PICTURE, &name).await.expect("deletes"));
}

async fn torn_content_is_found_by_its_hash_and_mended(store: &BlobStore) {
    for bytes in [content(5, 1000), content(5, 9 << 20)] {
        let name = put(store, PICTURE, &bytes).await;
        assert_eq!(state(store, &name, bytes.len()).await, FileState::Intact);
        for torn in [content(6, bytes.len()), bytes.slice(..bytes.len() / 2)] {
            damage(store, &name, torn).await;
            assert_eq!(state(store, &name, bytes.len()).await, FileState::Damaged);
            put(store, PICTURE, &bytes).await;
            assert_eq!(read(store, PICTURE, &name, None).await, Some(bytes.clone()), "the right bytes replace others");
            assert_eq!(state(store, &name, bytes.len()).await, FileState::Intact);
        }
        assert!(store.delete(PICTURE, &name).await.expect("deletes"));
    }
}

async fn content_is_listed_and_deleted(store: &BlobStore) {
    let before = names(store, PICTURE).await.len();
    let (kept, gone) = (put(store, PICTURE, &content(7, 10)).await, put(store, PICTURE, &content(8, 20)).await);
    put(store, BLOB, &content(7, 30)).await;
    assert_eq!(names(store, PICTURE).await.len(), before + 2);
    assert_eq!(store.size_bytes(BLOB).await.expect("lists"), 30);
    let listed: Vec<_> = store.list(PICTURE).try_collect().await.expect("lists");
    assert!(listed.iter().all(|(_, meta)| age(meta) < Duration::from_mins(10)), "{listed:?}");

    let unused = |answer| async move |_| Ok::<_, ContentError>(answer);
    assert!(!store.delete_if(PICTURE, &gone, unused(false)).await.expect("looks"));
    assert!(store.delete_if(PICTURE, &gone, unused(true)).await.expect("deletes"));
    assert!(!store.delete_if(PICTURE, &gone, unused(true)).await.expect("looks"), "it is gone already");
    assert_eq!(names(store, PICTURE).await.len(), before + 1);

    let both = [gone.as_str().to_owned(), kept.as_str().to_owned(), "no hash".to_owned()];
    let swept = store.sweep(PICTURE, &both, async |names| Ok::<_, ContentError>(names)).await.expect("sweeps");
    assert_eq!(swept, (0, vec![kept.as_str().to_owned()]), "what is new is never swept");
    assert_eq!(names(store, PICTURE).await.len(), before + 1);
}

/// Another server reads what the first remembers.
async fn ends_are_those_that_are_remembered(store: &BlobStore, other: &BlobStore) {
    for size_bytes in [0, 1, 12, HEAD, HEAD + 1, 300_000] {
        let name = put(store, BLOB, &content(11, size_bytes)).await;
        let (ours, theirs) = (store.ends(BLOB, &name).await, other.ends(BLOB, &name).await);
        let ends = |ends: Result<Option<FileEnds>, ContentError>| {
            let ends = ends.expect("reads").expect("is there");
            (ends.size_bytes, ends.head, ends.tail)
        };
        assert_eq!(ends(ours), ends(theirs), "{size_bytes}");
        assert!(store.delete(BLOB, &name).await.expect("deletes"));
        assert!(store.ends(BLOB, &name).await.expect("looks").is_none(), "what is deleted is forgotten");
    }
}

/// With an age of zero everything is swept, and stored again when it is put again.
async fn old_objects_are_swept_and_refreshed(store: &BlobStore) {
    let bytes = content(9, 10);
    let name = put(store, BLOB, &bytes).await;
    let version = async || store.store(BLOB).head(&store.path(BLOB, &name)).await.expect("is there");
    let first = version().await;
    while version().await.last_modified == first.last_modified {
        put(store, BLOB, &bytes).await;
    }
    let names = [name.as_str().to_owned()];
    let swept = store.sweep(BLOB, &names, async |names| Ok::<_, ContentError>(names)).await.expect("sweeps");
    assert_eq!(swept, (1, Vec::new()));
    assert_eq!(read(store, BLOB, &name, None).await, None);
}

fn data() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

#[tokio::test]
async fn a_folder_conforms() {
    let data = data();
    let store = BlobStore::open(&StoreLocation::Folder, data.path(), None).await.expect("opens");
    conforms(&store).await;
    let files = std::fs::read_dir(data.path().join("pictures")).expect("lists").count();
    assert_eq!(files, 9, "no partial file is left");
}

#[tokio::test]
async fn memory_conforms() {
    let data = data();
    let store = BlobStore::open(&StoreLocation::Memory, data.path(), None).await.expect("opens");
    conforms(&store).await;
    let again = BlobStore::open(&StoreLocation::Memory, data.path(), Some(Duration::ZERO)).await.expect("opens");
    old_objects_are_swept_and_refreshed(&again).await;
}

#[tokio::test]
async fn a_report_waits_for_one_piece_of_a_sweep() {
    let data = data();
    let store = BlobStore::open(&StoreLocation::Memory, data.path(), None).await.expect("opens");
    let names: Vec<String> = (0..100_u32).map(|name| blake3::hash(&name.to_le_bytes()).to_hex().to_string()).collect();
    let pieces = AtomicUsize::new(0);
    let unneeded = async |names| {
        pieces.fetch_add(1, Ordering::Relaxed);
        tokio::task::yield_now().await;
        Ok::<_, ContentError>(names)
    };
    let report = async {
        assert_eq!(pieces.load(Ordering::Relaxed), 1, "the sweep has begun");
        drop(store.block_sweep().await);
        pieces.load(Ordering::Relaxed)
    };
    let (swept, before_report) = tokio::join!(store.sweep(BLOB, &names, unneeded), report);
    assert_eq!(swept.expect("sweeps"), (0, Vec::new()));
    assert_eq!((before_report, pieces.load(Ordering::Relaxed)), (1, 7));
}

fn location(text: &str) -> (StoreLocation, String) {
    let location: StoreLocation = text.parse().expect("a store");
    let StoreLocation::S3 { bucket, .. } = location.clone() else { unreachable!("parsed from s3://") };
    (location, bucket)
}

fn open_bucket(s3: &SeaweedFs, text: &str, data: &FolderPath, age: Duration) -> BlobStore {
    let (location, bucket) = location(text);
    let bucket = Settings::from_env(&location, &bucket).with(&s3.environment()).open().expect("opens");
    BlobStore::with_bucket(&location, Bucket::S3(bucket), data, age)
}

#[tokio::test]
async fn a_bucket_conforms() {
    let Some(s3) = SeaweedFs::start() else { return };
    let data = data();
    s3.make_bucket("renders");
    let store = open_bucket(&s3, "s3://renders/farm/a", data.path(), MIN_OBJECT_SWEEP_AGE);
    conforms(&store).await;
    old_objects_are_swept_and_refreshed(&open_bucket(&s3, "s3://renders", data.path(), Duration::ZERO)).await;
    let other = open_bucket(&s3, "s3://renders/farm/a", data.path(), MIN_OBJECT_SWEEP_AGE);
    ends_are_those_that_are_remembered(&store, &other).await;
    presigned_address_gives_the_picture(&store).await;
    wrong_settings_are_explained(&s3).await;
    assert_eq!(s3.names("renders/farm/probe"), Vec::<String>::new(), "the check leaves no object");
    assert_eq!(std::fs::read_dir(data.path()).expect("lists").count(), 0, "received content leaves no file");
}

async fn presigned_address_gives_the_picture(store: &BlobStore) {
    let bytes = content(10, 2 << 20);
    let name = put(store, PICTURE, &bytes).await;
    let address = store.presigned(PICTURE, &name, "image/png").await.expect("signs").expect("a bucket of S3");
    let client = proto::client_auth::client_builder().build().expect("a client");
    let answer = client.get(&address).send().await.expect("an answer");
    assert_eq!(
        (answer.status().as_u16(), &answer.headers()["content-type"]),
        (200, &"image/png".parse().expect("text"))
    );
    assert_eq!(answer.bytes().await.expect("a body"), bytes);
    let forged = address.replace(name.as_str(), blake3::hash(b"other").to_hex().as_str());
    assert_eq!(client.get(forged).send().await.expect("an answer").status(), 403);
}

async fn wrong_settings_are_explained(s3: &SeaweedFs) {
    let check = async |text: &str, changed: &[(&str, String)]| {
        let (location, bucket) = location(text);
        Settings::from_env(&location, &bucket).with(&s3.environment()).with(changed).check().await
    };
    check("s3://renders/farm", &[]).await.expect("everything is right");
    let nothing_listens = "http://127.0.0.1:1".to_owned();
    let no_host = "http://no-such-host.invalid".to_owned();
    let with_tls = s3.endpoint().replace("http://", "https://");
    for (text, changed, fault) in [
        ("s3://elsewhere/farm", vec![], BucketFault::NoBucket),
        ("s3://renders", vec![("AWS_SECRET_ACCESS_KEY", "wrong".to_owned())], BucketFault::KeysRefused),
        ("s3://renders", vec![("AWS_ACCESS_KEY_ID", "unknown".to_owned())], BucketFault::KeysRefused),
        ("s3://renders", vec![("AWS_ACCESS_KEY_ID", "test-reader".to_owned())], BucketFault::KeysRefused),
        ("s3://renders", vec![("AWS_ENDPOINT_URL", nothing_listens)], BucketFault::Unreachable),
        ("s3://renders", vec![("AWS_ENDPOINT_URL", no_host)], BucketFault::Unreachable),
        ("s3://renders", vec![("AWS_ENDPOINT_URL", with_tls)], BucketFault::Unreachable),
        ("s3://renders", vec![("AWS_ALLOW_HTTP", "false".to_owned())], BucketFault::HttpNotAllowed),
    ] {
        let error = check(text, &changed).await.expect_err("the settings are wrong");
        assert_eq!(error.fault(), fault, "{changed:?}: {error}");
        let words = error.to_string();
        assert!(words.contains(text) && words.contains(fault.cure()), "{words}");
        assert!(!words.contains("test-secret"), "{words}");
        println!("{words}");
    }
}

#[tokio::test]
async fn a_prefix_has_one_farm() {
    let Some(s3) = SeaweedFs::start() else { return };
    let data = data();
    s3.make_bucket("renders");
    for round in 0..5 {
        let open = || open_bucket(&s3, &format!("s3://renders/farms/{round}"), data.path(), MIN_OBJECT_SWEEP_AGE);
        let farms: Vec<_> = (0..8).map(|_| FarmId::random()).collect();
        let stores: Vec<_> = farms.iter().map(|_| open()).collect();
        stores[0].check_owner(farms[0]).await.expect("it is none's yet");
        let claims = join_all(stores.iter().zip(&farms).map(|(store, farm)| store.claim(*farm))).await;
        let winners: Vec<_> = claims.iter().zip(&farms).filter(|(claim, _)| claim.is_ok()).collect();
        let [(_, winner)] = winners[..] else { panic!("one wins: {claims:?}") };
        for (farm, claim) in farms.iter().zip(&claims) {
            let again = open().claim(*farm).await;
            assert_eq!(again.is_ok(), farm == winner, "{again:?}");
            assert_eq!(open().check_owner(*farm).await.is_ok(), farm == winner);
            let Err(error) = claim else { continue };
            let words = error.to_string();
            assert!(words.contains(&format!("names {winner}, this farm is {farm}")), "{words}");
        }
        // Servers of one farm start at once.
        let same = join_all(stores.iter().map(|store| store.claim(*winner))).await;
        assert!(same.iter().all(Result::is_ok), "{same:?}");
    }
}

/// Every kind of access fails as unreachable while the store is away, and nothing that was stored is lost.
#[tokio::test]
async fn an_outage_is_temporary() {
    let Some(mut s3) = SeaweedFs::start() else { return };
    let data = data();
    s3.make_bucket("renders");
    let store = open_bucket(&s3, "s3://renders/farm", data.path(), MIN_OBJECT_SWEEP_AGE);
    let bytes = content(12, 300_000);
    let (stored, other) = (put(&store, PICTURE, &bytes).await, content(13, LARGE_BYTES));
    s3.stop();
    let attempts = [
        store.put(PICTURE, &name(&other), chunks(&other), u64::MAX).await.expect_err("it is away"),
        store.get(PICTURE, &stored, None).await.map(drop).expect_err("it is away"),
        store.file_state(PICTURE, &stored, 300_000).await.map(drop).expect_err("it is away"),
        store.size_bytes(PICTURE).await.map(drop).expect_err("it is away"),
        store.check_usable().await.expect_err("it is away"),
    ];
    for error in attempts {
        let attempt = error.unreachable_attempt().unwrap_or_else(|| panic!("{error:?}"));
        assert!(attempt.starts_with("the store s3://renders/farm could not "), "{attempt}");
        assert!(error.to_string().ends_with(BucketFault::Unreachable.cure()), "{error}");
    }
    store.ends(PICTURE, &stored).await.expect("remembered").expect("is there");
    s3.start_again();
    // It lists its objects before it has found their bytes.
    while let Err(error) = store.get(PICTURE, &stored, None).await {
        assert!(error.unreachable_attempt().is_some(), "{error:?}");
    }
    assert_eq!(read(&store, PICTURE, &stored, None).await, Some(bytes));
    put(&store, PICTURE, &other).await;
}
