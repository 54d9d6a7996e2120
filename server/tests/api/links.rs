//! Signed links: any client with a link can read that picture, and nothing else, until the link expires.

use std::time::Duration;

use proto::link::LinkView;
use reqwest::StatusCode;

use super::harness::{Farm, in_time, read, refused, small_job};

/// A farm with one stored picture, and the path of its frame.
async fn stored() -> (Farm, String) {
    let farm = Farm::start().await;
    farm.hand.advance(Duration::from_hours(24));
    let posted = farm.submit(&small_job(1)).await;
    farm.worker("one").await.work_off().await;
    let frame = format!("/v1/jobs/{}/frames/0", posted.id);
    (farm, frame)
}

async fn sign(farm: &Farm, frame: &str, requested: &str) -> LinkView {
    read(farm.post(&format!("{frame}/link"), requested.to_owned()).await, StatusCode::OK).await
}

#[tokio::test]
async fn a_link_returns_the_picture_until_it_expires() {
    let (farm, frame) = stored().await;
    let link = sign(&farm, &frame, r#"{"expires_in_seconds": 60}"#).await;
    assert_eq!(link.expires_at, "1970-01-02T00:01:00.000Z");
    let whole = farm.get(&format!("{frame}/image")).await;
    let linked = farm.get(&link.url).await;
    assert_eq!(linked.status(), StatusCode::OK);
    assert_eq!(linked.headers()["cache-control"], "private, no-cache");
    assert_eq!(linked.headers()["etag"], whole.headers()["etag"]);
    assert_eq!(in_time(linked.bytes()).await.expect("bytes"), in_time(whole.bytes()).await.expect("bytes"));
    farm.hand.advance(Duration::from_secs(59));
    assert_eq!(farm.get(&link.url).await.status(), StatusCode::OK);
    farm.hand.advance(Duration::from_secs(1));
    refused(farm.get(&link.url).await, 410, "link_expired").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_changed_link_is_rejected() {
    let (farm, frame) = stored().await;
    let other = farm.submit(&small_job(2)).await;
    let link = sign(&farm, &frame, r#"{"expires_in_seconds": 60}"#).await.url;
    let (path, query) = link.split_once('?').expect("a query");
    let (expires, signature) = query.split_once('&').expect("two parts");
    let later = format!("expires={}", 1_000_000 + expires["expires=".len()..].parse::<i64>().expect("seconds"));
    let changed = [
        format!("{path}?{later}&{signature}"),
        format!("{}?{query}", path.replace("/0/image", "/1/image")),
        format!("{}?{query}", path.replace("/image", "/preview")),
        format!("{}?{query}", path.replace("/image", "/thumbnail")),
        format!("/v1/pictures/{}/0/image?{query}", other.id),
        format!("/v1/pictures/nobody/0/image?{query}"),
        format!("{path}?{expires}&signature="),
        format!("{path}?{expires}&signature={}", "A".repeat(43)),
    ];
    for link in changed {
        refused(farm.get(&link).await, 403, "wrong_signature").await;
    }
    for wrong in [path.to_owned(), format!("{path}?{expires}"), format!("{path}?expires=soon&{signature}")] {
        refused(farm.get(&wrong).await, 422, "wrong_query").await;
    }
    farm.stop().await;
}

#[tokio::test]
async fn a_link_signed_before_its_picture_survives_a_restart() {
    let farm = Farm::start().await;
    farm.hand.advance(Duration::from_hours(24));
    let posted = farm.submit(&small_job(1)).await;
    let link = sign(&farm, &format!("/v1/jobs/{}/frames/0", posted.id), r#"{"expires_in_seconds": 600}"#).await.url;
    refused(farm.get(&link).await, 404, "picture_not_stored").await;
    farm.worker("one").await.work_off().await;
    let folder = farm.stop().await;
    let farm = Farm::start_in(folder, |_| {}).await;
    assert_eq!(farm.get(&link).await.status(), StatusCode::OK);
    farm.stop().await;
}

#[tokio::test]
async fn an_invalid_link_request_is_rejected_with_a_json_pointer() {
    let (farm, frame) = stored().await;
    for (requested, pointer) in [
        (r#"{"expires_in_seconds": 0}"#, "/expires_in_seconds"),
        (r#"{"expires_in_seconds": 31622401}"#, "/expires_in_seconds"),
        (r#"{"expires_in_seconds": -1}"#, "/expires_in_seconds"),
        (r#"{"expires_in_seconds": "soon"}"#, "/expires_in_seconds"),
        (r#"{"expires_in_seconds": 1, "shows": "all"}"#, "/shows"),
        (r#"{"expires_in_seconds": 1, "for": "ever"}"#, "/for"),
        ("{}", ""),
    ] {
        let problem = refused(farm.post(&format!("{frame}/link"), requested).await, 422, "wrong_body").await;
        assert_eq!(problem.errors[0].pointer, pointer, "{requested}: {problem:?}");
    }
    let requested = r#"{"expires_in_seconds": 1}"#;
    refused(farm.post(&frame.replace("/0", "/7"), requested).await, 404, "unknown_route").await;
    refused(
        farm.post(&format!("{}/link", frame.replace("frames/0", "frames/1")), requested).await,
        404,
        "unknown_frame",
    )
    .await;
    refused(
        farm.post(&format!("{}/link", frame.replace("frames/0", "frames/x")), requested).await,
        404,
        "unknown_frame",
    )
    .await;
    refused(farm.post("/v1/jobs/nobody/frames/0/link", requested).await, 404, "unknown_job").await;
    farm.stop().await;
}
