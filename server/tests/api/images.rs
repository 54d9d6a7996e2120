//! Stored pictures over HTTP: entity tags, ranges, media types.

use reqwest::header::{ETAG, HeaderMap, IF_NONE_MATCH, IF_RANGE, RANGE};
use reqwest::{Response, StatusCode};

use proto::JobId;
use proto::job::JobState;

use super::harness::{Farm, assert_state, in_time, refused, small_job};

async fn stored(farm: &Farm) -> String {
    let posted = farm.submit(&small_job(1)).await;
    farm.worker("one").await.work_off().await;
    format!("/v1/jobs/{}/image", posted.id)
}

async fn get(farm: &Farm, path: &str, headers: &[(reqwest::header::HeaderName, &str)]) -> Response {
    let headers: HeaderMap =
        headers.iter().map(|(name, value)| (name.clone(), value.parse().expect("a value"))).collect();
    in_time(farm.client.get(farm.url(path)).headers(headers).send()).await.expect("a response")
}

async fn bytes(response: Response) -> bytes::Bytes {
    in_time(response.bytes()).await.expect("bytes")
}

#[tokio::test]
async fn a_picture_has_a_strong_tag_and_never_changes() {
    let farm = Farm::start().await;
    let path = stored(&farm).await;
    let whole = get(&farm, &path, &[]).await;
    let headers = whole.headers().clone();
    let tag = headers[ETAG].to_str().expect("text").to_owned();
    let picture = bytes(whole).await;
    assert_eq!(tag, format!("\"{}\"", blake3::hash(&picture).to_hex()));
    assert_eq!(headers["content-length"], picture.len().to_string());
    assert_eq!(headers["cache-control"], "public, max-age=31536000, immutable");
    assert_eq!(headers["accept-ranges"], "bytes");

    let same = get(&farm, &path, &[(IF_NONE_MATCH, &tag)]).await;
    assert_eq!(same.status(), StatusCode::NOT_MODIFIED);
    assert_eq!(same.headers()[ETAG], tag);
    assert!(bytes(same).await.is_empty());
    let other = get(&farm, &path, &[(IF_NONE_MATCH, "\"another\"")]).await;
    assert_eq!(other.status(), StatusCode::OK);

    let head = in_time(farm.client.head(farm.url(&path)).send()).await.expect("a response");
    assert_eq!(head.headers()["content-length"], picture.len().to_string());
    farm.stop().await;
}

#[tokio::test]
async fn a_range_of_a_picture_is_served() {
    let farm = Farm::start().await;
    let path = stored(&farm).await;
    let whole = get(&farm, &path, &[]).await;
    let tag = whole.headers()[ETAG].to_str().expect("text").to_owned();
    let whole = bytes(whole).await;

    let part = get(&farm, &path, &[(RANGE, "bytes=3-6")]).await;
    assert_eq!(part.status(), StatusCode::PARTIAL_CONTENT);
    assert_eq!(part.headers()["content-range"], format!("bytes 3-6/{}", whole.len()));
    assert_eq!(part.headers()["content-length"], "4");
    assert_eq!(bytes(part).await, whole[3..7]);
    let end = get(&farm, &path, &[(RANGE, "bytes=-5"), (IF_RANGE, &tag)]).await;
    assert_eq!(bytes(end).await, whole[whole.len() - 5..]);
    let changed = get(&farm, &path, &[(RANGE, "bytes=-5"), (IF_RANGE, "\"another\"")]).await;
    assert_eq!(changed.status(), StatusCode::OK);
    assert_eq!(bytes(changed).await, whole);
    let beyond = get(&farm, &path, &[(RANGE, "bytes=100000-")]).await;
    assert_eq!(beyond.headers()["content-range"], format!("bytes */{}", whole.len()));
    refused(beyond, 416, "wrong_range").await;
    farm.stop().await;
}

#[tokio::test]
async fn an_exr_has_its_media_type() {
    let farm = Farm::start().await;
    let mut job = small_job(1);
    job["image"]["format"] = "exr".into();
    let posted = farm.submit(&job).await;
    farm.worker("one").await.work_off().await;
    let picture = farm.get(&format!("/v1/jobs/{}/frames/0/image", posted.id)).await;
    assert_eq!(picture.headers()["content-type"], "image/x-exr");
    farm.stop().await;
}

/// Changes the file of a picture.
type Damage = fn(&std::path::Path, &[u8]);

/// File of a picture.
fn file_of(farm: &Farm, picture: &[u8]) -> std::path::PathBuf {
    farm.folder.path().join("pictures").join(blake3::hash(picture).to_hex().as_str())
}

#[tokio::test]
async fn a_damaged_picture_is_reported_and_rendered_again() {
    let farm = Farm::start().await;
    let worker = farm.worker("one").await;
    let damages: [(Damage, &str); 4] = [
        (|file, _| std::fs::write(file, "").expect("emptied"), "damaged_picture"),
        (|file, picture| std::fs::write(file, &picture[..100]).expect("cut"), "damaged_picture"),
        (|file, picture| std::fs::write(file, vec![0; picture.len()]).expect("written over"), "damaged_picture"),
        (|file, _| std::fs::remove_file(file).expect("removed"), "lost_picture"),
    ];
    for ranges in [0, 1] {
        for (index, (damage, code)) in damages.into_iter().enumerate() {
            let id: JobId = farm.submit(&small_job(2 * index as u32 + ranges)).await.id;
            worker.work_off().await;
            let path = format!("/v1/jobs/{id}/image");
            let picture = bytes(get(&farm, &path, &[]).await).await;
            damage(&file_of(&farm, &picture), &picture);
            let headers: &[_] = if ranges == 1 { &[(RANGE, "bytes=50-")] } else { &[] };
            refused(get(&farm, &path, headers).await, 500, code).await;
            assert_state(&farm, id, JobState::Running).await;
            refused(get(&farm, &path, headers).await, 404, "picture_not_stored").await;
            assert_eq!(worker.work_off().await, 1, "it is rendered again");
            assert_eq!(bytes(get(&farm, &path, &[]).await).await, picture);
            assert_state(&farm, id, JobState::Succeeded).await;
        }
    }
    farm.stop().await;
}

#[tokio::test]
async fn an_archive_and_a_thumbnail_find_damaged_pictures() {
    let farm = Farm::start().await;
    let worker = farm.worker("one").await;
    for (seed, path) in (0..).zip(["frames/0/thumbnail", "frames/0/preview", "frames.zip"]) {
        let id = farm.submit(&small_job(seed)).await.id;
        worker.work_off().await;
        let picture = bytes(get(&farm, &format!("/v1/jobs/{id}/image"), &[]).await).await;
        std::fs::write(file_of(&farm, &picture), "").expect("emptied");
        let answer = get(&farm, &format!("/v1/jobs/{id}/{path}"), &[]).await;
        if path == "frames.zip" {
            assert!(in_time(answer.bytes()).await.is_err(), "the archive breaks off");
        } else {
            refused(answer, 500, "damaged_picture").await;
        }
        assert_eq!(worker.work_off().await, 1, "{path}");
        assert_state(&farm, id, JobState::Succeeded).await;
    }
    farm.stop().await;
}
