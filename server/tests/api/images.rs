//! Stored pictures over HTTP: entity tags, ranges, media types.

use reqwest::header::{ETAG, HeaderMap, IF_NONE_MATCH, IF_RANGE, RANGE};
use reqwest::{Response, StatusCode};

use super::harness::{Farm, in_time, refused, small_job};

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

async fn text(response: Response) -> String {
    in_time(response.text()).await.expect("text")
}

#[tokio::test]
async fn a_picture_has_a_strong_tag_and_never_changes() {
    let farm = Farm::start().await;
    let path = stored(&farm).await;
    let whole = get(&farm, &path, &[]).await;
    let headers = whole.headers().clone();
    let tag = headers[ETAG].to_str().expect("text").to_owned();
    let bytes = text(whole).await;
    assert_eq!(tag, format!("\"{}\"", blake3::hash(bytes.as_bytes()).to_hex()));
    assert_eq!(headers["content-length"], bytes.len().to_string());
    assert_eq!(headers["cache-control"], "public, max-age=31536000, immutable");
    assert_eq!(headers["accept-ranges"], "bytes");

    let same = get(&farm, &path, &[(IF_NONE_MATCH, &tag)]).await;
    assert_eq!(same.status(), StatusCode::NOT_MODIFIED);
    assert_eq!(same.headers()[ETAG], tag);
    assert_eq!(text(same).await, "");
    let other = get(&farm, &path, &[(IF_NONE_MATCH, "\"another\"")]).await;
    assert_eq!(other.status(), StatusCode::OK);

    let head = in_time(farm.client.head(farm.url(&path)).send()).await.expect("a response");
    assert_eq!(head.headers()["content-length"], bytes.len().to_string());
    farm.stop().await;
}

#[tokio::test]
async fn a_range_of_a_picture_is_served() {
    let farm = Farm::start().await;
    let path = stored(&farm).await;
    let whole = get(&farm, &path, &[]).await;
    let tag = whole.headers()[ETAG].to_str().expect("text").to_owned();
    let whole = text(whole).await;

    let part = get(&farm, &path, &[(RANGE, "bytes=3-6")]).await;
    assert_eq!(part.status(), StatusCode::PARTIAL_CONTENT);
    assert_eq!(part.headers()["content-range"], format!("bytes 3-6/{}", whole.len()));
    assert_eq!(part.headers()["content-length"], "4");
    assert_eq!(text(part).await, whole[3..7]);
    let end = get(&farm, &path, &[(RANGE, "bytes=-5"), (IF_RANGE, &tag)]).await;
    assert_eq!(text(end).await, whole[whole.len() - 5..]);
    let changed = get(&farm, &path, &[(RANGE, "bytes=-5"), (IF_RANGE, "\"another\"")]).await;
    assert_eq!(changed.status(), StatusCode::OK);
    assert_eq!(text(changed).await, whole);
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
