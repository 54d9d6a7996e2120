//! Stores that answer what no store should.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

use super::*;

/// Most that a client may have taken of an answer without an end: what is on the way is in buffers, too.
const MAX_TAKEN_BYTES: usize = 32 << 20;

/// An answer: its head, its body, and whether the body goes on for ever.
#[derive(Clone, Debug)]
struct Answer {
    head: String,
    body: Vec<u8>,
    is_endless: bool,
}

/// Starts a store that answers everything alike. Returns its address, and the number of bytes that were taken.
async fn start(answer: Answer) -> (String, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = format!("http://{}", listener.local_addr().expect("an address"));
    let taken = Arc::new(AtomicUsize::new(0));
    let counter = Arc::clone(&taken);
    tokio::spawn(async move {
        while let Ok((connection, _)) = listener.accept().await {
            tokio::spawn(respond(connection, answer.clone(), Arc::clone(&counter)));
        }
    });
    (address, taken)
}

async fn respond(mut connection: TcpStream, answer: Answer, taken: Arc<AtomicUsize>) -> io::Result<()> {
    let mut request = Vec::new();
    while !request.ends_with(b"\r\n\r\n") {
        request.push(connection.read_u8().await?);
    }
    let head = answer.head.replacen("\r\n", "\r\nconnection: close\r\n", 1);
    connection.write_all(head.as_bytes()).await?;
    // In two pieces, so that a client has to collect them.
    let (first, second) = answer.body.split_at(answer.body.len() / 2);
    loop {
        for piece in [first, second] {
            connection.write_all(piece).await?;
            taken.fetch_add(piece.len(), Ordering::Relaxed);
            tokio::time::sleep(Duration::from_micros(10)).await;
        }
        if !answer.is_endless {
            return connection.shutdown().await;
        }
    }
}

fn open(address: &str, data: &FolderPath) -> BlobStore {
    let (location, bucket) = location("s3://renders/farm");
    let settings = [
        ("AWS_ENDPOINT_URL", address.to_owned()),
        ("AWS_ALLOW_HTTP", "true".to_owned()),
        ("AWS_ACCESS_KEY_ID", "test".to_owned()),
        ("AWS_SECRET_ACCESS_KEY", "test".to_owned()),
    ];
    let bucket = Settings::from_env(&location, &bucket).with(&settings).without_retries();
    BlobStore::with_bucket(&location, Bucket::S3(bucket), data, MIN_OBJECT_SWEEP_AGE)
}

/// An answer in chunks of 64 KiB that never ends.
fn endless(status: &str) -> Answer {
    let chunk = [b"10000\r\n".as_slice(), &vec![b' '; 0x10000], b"\r\n"].concat();
    let head = format!("HTTP/1.1 {status}\r\ntransfer-encoding: chunked\r\n\r\n");
    Answer { head, body: chunk, is_endless: true }
}

#[tokio::test]
async fn endless_answers_are_not_kept() {
    let data = data();
    for status in ["403 Forbidden", "200 OK"] {
        let (address, taken) = start(endless(status)).await;
        let store = open(&address, data.path());
        let error = store.size_bytes(PICTURE).await.expect_err("it is no listing");
        assert!(taken.load(Ordering::Relaxed) < MAX_TAKEN_BYTES, "{status}: {taken:?}");
        println!("{error}: {:?}", std::error::Error::source(&error));
    }
    let (address, taken) = start(endless("403 Forbidden")).await;
    let store = open(&address, data.path());
    store.ends(PICTURE, &name(b"any")).await.expect_err("an error");
    store.get(PICTURE, &name(b"any"), None).await.map(drop).expect_err("an error");
    put_fails(&store).await;
    assert!(taken.load(Ordering::Relaxed) < 3 * MAX_TAKEN_BYTES, "{taken:?}");
}

async fn put_fails(store: &BlobStore) {
    let bytes = content(1, 100);
    store.put(PICTURE, &name(&bytes), chunks(&bytes), u64::MAX).await.expect_err("an error");
}

/// A client that makes room for all that is announced ends with its process.
#[tokio::test]
async fn announced_sizes_are_not_believed() {
    let data = data();
    for status in ["403 Forbidden", "200 OK"] {
        let head = format!("HTTP/1.1 {status}\r\ncontent-length: {}\r\n\r\n", 1_u64 << 46);
        let (address, _) = start(Answer { head, body: vec![b' '; 8192], is_endless: false }).await;
        let store = open(&address, data.path());
        store.size_bytes(PICTURE).await.expect_err("it ends too soon");
        put_fails(&store).await;
        // A few bytes are enough to tell that they name no farm.
        assert!(store.owner().await.is_err() || status == "200 OK");
    }
}

#[tokio::test]
async fn other_bytes_than_those_stored_are_never_complete() {
    let data = data();
    let right = content(3, 200_000);
    let name = name(&right);
    let mut wrong = right.to_vec();
    wrong[199_999] ^= 1;
    for (body, is_right) in [(right.to_vec(), true), (wrong, false)] {
        let modified = "last-modified: Sun, 29 Nov 2026 00:00:00 GMT\r\netag: \"same\"";
        let head = format!("HTTP/1.1 200 OK\r\ncontent-length: {}\r\n{modified}\r\n\r\n", body.len());
        let (address, _) = start(Answer { head, body, is_endless: false }).await;
        let store = open(&address, data.path());
        let (size_bytes, mut bytes) = store.get(PICTURE, &name, None).await.expect("reads").expect("is there");
        assert_eq!(size_bytes, 200_000);
        let mut read_bytes = 0;
        let ended = loop {
            match bytes.try_next().await {
                Ok(Some(chunk)) => read_bytes += chunk.len() as u64,
                Ok(None) => break Ok(()),
                Err(error) => break Err(error),
            }
        };
        assert_eq!((ended.is_ok(), read_bytes == size_bytes), (is_right, is_right), "{ended:?}");
        let known = if is_right { FileState::Intact } else { FileState::Damaged };
        assert_eq!(state(&store, &name, 200_000).await, known, "what was read is remembered");
    }
}
