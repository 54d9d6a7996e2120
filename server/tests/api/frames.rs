//! Frames of an animation: their list, and the archive of their pictures as other programs read it.

use std::process::Command;

use proto::frame::{FramePage, FrameState};
use reqwest::StatusCode;
use serde_json::{Value, json};

use crate::skip::skip;

use super::fake_pictures::text_of;
use super::harness::{Farm, in_time, read, refused, small_job};

fn animation(frames: u32) -> Value {
    let mut animation = small_job(1);
    animation["name"] = "two words".into();
    animation["frames"] = json!({ "count": frames, "fps": 24 });
    animation
}

#[tokio::test]
async fn frames_are_listed_in_pages_with_their_pictures() {
    let farm = Farm::start().await;
    let posted = farm.submit(&animation(5)).await;
    let worker = farm.worker("one").await;
    worker.work_once().await;
    let run = worker.claim().await.expect("work");
    let path = format!("/v1/jobs/{}/frames", posted.id);
    let page: FramePage = read(farm.get(&format!("{path}?limit=3")).await, StatusCode::OK).await;
    let states: Vec<FrameState> = page.frames.iter().map(|frame| frame.state).collect();
    assert_eq!(states, [FrameState::Stored, FrameState::Open, FrameState::Waiting]);
    let first = &page.frames[0];
    assert_eq!(first.file.as_deref(), Some("two_words.0000.png"));
    let image = farm.get(first.image.as_ref().expect("an address")).await;
    let bytes = in_time(image.bytes()).await.expect("bytes");
    assert_eq!(first.size_bytes, Some(bytes.len() as u64));
    assert_eq!(first.picture, Some(blake3::hash(&bytes).to_hex().to_string()));
    let cursor = page.next_cursor.expect("there is more");
    let rest: FramePage = read(farm.get(&format!("{path}?cursor={cursor}")).await, StatusCode::OK).await;
    assert_eq!(rest.frames.iter().map(|frame| frame.number).collect::<Vec<_>>(), [3, 4]);
    assert_eq!(rest.next_cursor, None);
    worker.report(worker.results(&run).await).await;
    for wrong in ["limit=0", "limit=1001", "limit=x", "cursor=x", "cursor=-1"] {
        refused(farm.get(&format!("{path}?{wrong}")).await, 422, "wrong_query").await;
    }
    refused(farm.get(&format!("/v1/jobs/{}/frames", proto::JobId::new())).await, 404, "unknown_job").await;
    farm.stop().await;
}

#[tokio::test]
async fn an_archive_has_every_picture_in_order_and_identical_bytes() {
    let farm = Farm::start().await;
    let posted = farm.submit(&animation(12)).await;
    let path = format!("/v1/jobs/{}/frames.zip", posted.id);
    let worker = farm.worker("one").await;
    worker.work_once().await;
    let problem = refused(farm.get(&path).await, 409, "frames_missing").await;
    assert!(problem.detail.contains("1 of the 12"), "{problem:?}");
    assert_eq!(members(&farm, &format!("{path}?partial=true")).await.len(), 1);
    worker.work_off().await;
    let response = farm.get(&path).await;
    assert_eq!(response.headers()["content-type"], "application/zip");
    assert_eq!(response.headers()["content-disposition"], "attachment; filename=\"two_words.zip\"");
    let first = in_time(response.bytes()).await.expect("bytes");
    let again = in_time(farm.get(&path).await.bytes()).await.expect("bytes");
    assert_eq!(first, again);
    let members = members(&farm, &path).await;
    let names: Vec<&str> = members.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, (0..12).map(|frame| format!("two_words.{frame:04}.png")).collect::<Vec<_>>());
    for (frame, (_, picture)) in members.iter().enumerate() {
        assert_eq!(text_of(picture), format!("picture of frame {frame} of {}", posted.id));
    }
    farm.stop().await;
}

/// Names and contents in an archive, as read by Python; without Python, as read by the library.
async fn members(farm: &Farm, path: &str) -> Vec<(String, Vec<u8>)> {
    const READER: &str = "import json, sys, zipfile
z = zipfile.ZipFile(sys.argv[1])
assert z.testzip() is None
assert all(i.compress_type == 0 and i.date_time == (1980, 1, 1, 0, 0, 0) for i in z.infolist())
print(json.dumps([[i.filename, list(z.read(i))] for i in z.infolist()]))";
    let bytes = in_time(farm.get(path).await.bytes()).await.expect("bytes");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("frames.zip");
    std::fs::write(&file, &bytes).expect("writes");
    let Ok(read) = Command::new("python3").arg("-c").arg(READER).arg(&file).output() else {
        skip("python3", "reading the archive with another program: python3 is not installed");
        return own_members(&bytes);
    };
    assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
    let members: Vec<(String, Vec<u8>)> = serde_json::from_slice(&read.stdout).expect("a list");
    assert_eq!(members, own_members(&bytes));
    members
}

fn own_members(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut archive = zip::ZipArchive::new(std::io::Cursor::new(bytes)).expect("an archive");
    (0..archive.len())
        .map(|index| {
            let mut member = archive.by_index(index).expect("a member");
            let mut picture = Vec::new();
            std::io::Read::read_to_end(&mut member, &mut picture).expect("bytes");
            (member.name().expect("a plain name").to_string(), picture)
        })
        .collect()
}
