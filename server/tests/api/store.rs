//! A store that is not the data folder: everything goes over HTTP, also what previews and stitches need.

use reqwest::StatusCode;
use server::{StartError, StoreLocation};

use super::harness::{Farm, config, job};

#[tokio::test]
async fn frames_are_stitched_and_served_from_memory() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let farm = Farm::start_in(folder, |config| {
        config.store = StoreLocation::Memory;
        config.tile_edge_px = Some(32);
    })
    .await;
    let submitted = farm.submit(&job(512, 512, 64)).await;
    let worker = farm.worker("one").await;
    assert!(worker.work_off().await > 1, "tiles, then the stitch");
    let image = farm.get(&format!("/v1/jobs/{}/image", submitted.id)).await;
    assert_eq!(image.status(), StatusCode::OK);
    let size_bytes = image.content_length().expect("a size");
    assert_eq!(image.bytes().await.expect("a body").len() as u64, size_bytes);
    assert!(!farm.folder.path().join("pictures").exists() && !farm.folder.path().join("tiles").exists());
    farm.stop().await;
}

#[tokio::test]
async fn a_farm_does_not_start_on_another_store() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("store"), "s3://renders/farm\n").expect("writes");
    let error = server::Server::start(config(folder.path())).await.expect_err("its pictures would be missing");
    assert!(matches!(error, StartError::OtherStore { .. }), "{error:?}");
    let words = error.to_string();
    assert!(words.contains("has its pictures in s3://renders/farm, not in the data folder"), "{words}");
}
