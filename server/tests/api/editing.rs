//! The table of nodes, and the shipped scenes.

use proto::shipped_scenes::SceneList;
use reqwest::StatusCode;
use serde_json::Value;

use super::harness::{Farm, in_time, read, refused};

#[tokio::test]
async fn node_table_has_every_family_and_a_picture_of_each_kind() {
    let farm = Farm::start().await;
    let answer = farm.get("/v1/schema/nodes").await;
    let tag = answer.headers()["etag"].to_str().expect("text").to_owned();
    let table: Value = read(answer, StatusCode::OK).await;
    let kinds = table["kinds"].as_array().expect("kinds");
    let sphere = kinds.iter().find(|kind| kind["name"] == "sphere").expect("the sphere");
    assert_eq!(sphere["keys"][0]["name"], "radius");
    let pictures = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../web/pictures");
    let mut count = 0;
    for path in kinds.iter().filter_map(|kind| kind["picture"].as_str()) {
        let name = path.strip_prefix("/ui/pictures/").expect("where pictures are served");
        assert!(pictures.join(name).is_file(), "{path} is missing");
        count += 1;
    }
    assert!(count > 90, "only {count} pictures");
    let request = farm.client.get(farm.url("/v1/schema/nodes")).header("if-none-match", &tag);
    assert_eq!(in_time(request.send()).await.expect("a response").status(), StatusCode::NOT_MODIFIED);
    farm.stop().await;
}

#[tokio::test]
async fn shipped_scenes_are_listed_and_served() {
    let farm = Farm::start().await;
    let list: SceneList = read(farm.get("/v1/scenes").await, StatusCode::OK).await;
    for scene in &list.scenes {
        let answer = farm.get(&scene.address).await;
        assert_eq!(answer.headers()["content-type"], "application/json");
        let job = in_time(answer.bytes()).await.expect("a body");
        assert_eq!(job.len() as u64, scene.bytes, "{}", scene.name);
        scene::parse(&job).expect("a valid job");
    }
    assert!(list.scenes.iter().any(|scene| scene.name == "paper/csg"));
    refused(farm.get("/v1/scenes/no-such").await, 404, "unknown_scene").await;
    refused(farm.get("/v1/scenes/..%2Fhashes").await, 404, "unknown_scene").await;
    farm.stop().await;
}
