//! The table of nodes, the shipped scenes, and formatting.

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

#[tokio::test]
async fn a_job_file_is_formatted_and_its_comments_stay() {
    let farm = Farm::start().await;
    let format = async |text: &str| farm.post("/v1/format", text.to_owned()).await;
    let text = "// a job\n{\"image\":{\"width\":8,\n\"height\":8 /* rows */,}, \"b\":\n\n[1.50,2,],}";
    let wanted = "// a job\n{\n  \"image\": { \"width\": 8, \"height\": 8 /* rows */ },\n  \"b\": [1.50, 2]\n}\n";
    for text in [text, wanted] {
        let answer = format(text).await;
        assert_eq!(answer.status(), StatusCode::OK);
        assert_eq!(answer.headers()["content-type"], "application/json");
        assert_eq!(in_time(answer.text()).await.expect("text"), wanted);
    }
    // A large text is formatted on the thread of large ones.
    let large = format!("[{}0]", "0,\n".repeat(100_000));
    let filled = in_time(format(&large).await.text()).await.expect("text");
    assert_eq!(filled.lines().nth(1).map(str::len), Some(100));
    farm.stop().await;
}

#[tokio::test]
async fn what_cannot_be_formatted_is_refused_at_its_place() {
    let farm = Farm::start().await;
    let format = async |text: String| farm.post("/v1/format", text).await;
    let problem = refused(format("{\n\"a\": 1 \"b\": 2}".to_owned()).await, 400, "not_json").await;
    assert_eq!((problem.errors[0].line, problem.errors[0].column), (2, 8));
    assert!(problem.errors[0].message.contains("a comma is missing"), "{problem:?}");
    let problem = refused(format("[".repeat(300) + &"]".repeat(300)).await, 422, "wrong_job").await;
    assert!(problem.detail.contains("nests deeper"), "{problem:?}");
    // Each of the lines is indented by 500 spaces.
    let members = (0..80_000).map(|key| format!("\"{key}\":0,")).collect::<Vec<_>>().concat();
    let deep = format!("{}{{{members}}}{}", "[".repeat(250), "]".repeat(250));
    let problem = refused(format(deep).await, 422, "wrong_job").await;
    assert!(problem.detail.contains("would be larger than 32 MiB when formatted"), "{problem:?}");
    let plain = farm.client.post(farm.url("/v1/format")).header("content-type", "text/plain").body("{}");
    refused(in_time(plain.send()).await.expect("a response"), 415, "wrong_content_type").await;
    farm.stop().await;
}
