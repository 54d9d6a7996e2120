//! Job files: returned, and submitted again; and jobs found by name or part of an id.

use proto::job::{JobPage, JobView};
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

use super::harness::{Farm, in_time, read, refused, small_job};
use super::keys::{locked_farm, make, new_key, send};
use proto::api_key::Scope;

/// Jobs that match a text.
async fn found(farm: &Farm, text: &str) -> Vec<proto::JobId> {
    let page: JobPage = read(farm.get(&format!("/v1/jobs?match={text}")).await, StatusCode::OK).await;
    page.jobs.iter().map(|job| job.id).collect()
}

fn named(name: &str, seed: u32) -> Value {
    let mut job = small_job(seed);
    job["name"] = name.into();
    job
}

#[tokio::test]
async fn a_job_file_is_returned_byte_for_byte() {
    let farm = Farm::start().await;
    let text = format!("  {}\n\n", serde_json::to_string_pretty(&small_job(1)).expect("JSON"));
    let job: JobView = read(farm.post("/v1/jobs", text.clone()).await, StatusCode::CREATED).await;
    assert_eq!((job.submitter.as_str(), job.priority), ("local", 0));
    let answer = farm.get(&format!("/v1/jobs/{}/file", job.id)).await;
    assert_eq!(answer.headers()["content-type"], "application/json");
    assert_eq!(in_time(answer.text()).await.expect("text"), text);
    refused(farm.get(&format!("/v1/jobs/{}/file", proto::JobId::new())).await, 404, "unknown_job").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_job_is_resubmitted_with_or_without_changes() {
    let farm = Farm::start().await;
    let first = farm.submit(&small_job(1)).await.id;
    let path = format!("/v1/jobs/{first}/resubmit");
    let same: JobView = read(farm.post(&path, "").await, StatusCode::CREATED).await;
    let patch = json!({ "name": "second", "priority": 7, "image": { "samples": 3 } });
    let changed: JobView = read(farm.post(&path, patch.to_string()).await, StatusCode::CREATED).await;
    assert_eq!((changed.name.as_str(), changed.priority), ("second", 7));
    assert!(first != same.id && same.id != changed.id);
    let file = async |id| read::<Value>(farm.get(&format!("/v1/jobs/{id}/file")).await, StatusCode::OK).await;
    let mut wanted = file(first).await;
    assert_eq!(file(same.id).await, wanted);
    wanted["name"] = "second".into();
    wanted["priority"] = 7.into();
    wanted["image"]["samples"] = 3.into();
    assert_eq!(file(changed.id).await, wanted);

    let dry: Value = read(farm.post(&format!("{path}?dry_run=true"), "{}").await, StatusCode::OK).await;
    assert_eq!(dry["valid"], true);
    let problem = refused(farm.post(&path, r#"{"image":{"width":0}}"#).await, 422, "wrong_job").await;
    assert_eq!(problem.errors[0].pointer, "/image/width");
    refused(farm.post(&path, "[]").await, 422, "wrong_body").await;
    refused(farm.post(&path, "{").await, 400, "not_json").await;
    refused(farm.post(&path, "7".repeat(2 << 20)).await, 413, "too_large").await;
    refused(farm.post(&format!("/v1/jobs/{}/resubmit", proto::JobId::new()), "").await, 404, "unknown_job").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_submission_sets_values_of_its_job() {
    let farm = Farm::start().await;
    let mut template = small_job(1);
    template["scene"]["numbers"] = json!({ "r": 0.5 });
    template["scene"]["objects"][0]["shape"] = json!({ "sphere": { "radius": { "expr": "r" } } });
    // Comments are kept, because the rest of the text keeps its bytes.
    let text = format!("// a template\n{template}");
    let path = "/v1/jobs?set=numbers.r%3D0.25&set=image.samples%3D2&set=name%3Dsmall";
    let posted: JobView = read(farm.post(path, text.clone()).await, StatusCode::CREATED).await;
    assert_eq!(posted.name, "small");
    let stored = in_time(farm.get(&format!("/v1/jobs/{}/file", posted.id)).await.text()).await.expect("text");
    assert!(stored.starts_with("// a template\n") && stored.contains(r#""r":0.25"#), "{stored}");
    // A stored job is a template, too; a change of it has no comments.
    let again = format!("/v1/jobs/{}/resubmit?set=numbers.r%3D1", posted.id);
    let again: JobView = read(farm.post(&again, r#"{ "priority": 3 }"#).await, StatusCode::CREATED).await;
    let stored = read::<Value>(farm.get(&format!("/v1/jobs/{}/file", again.id)).await, StatusCode::OK).await;
    assert_eq!((&stored["scene"]["numbers"]["r"], &stored["priority"]), (&json!(1), &json!(3)));
    for (query, words) in [
        ("numbers.q%3D1", "scene.numbers has no q, only r"),
        ("numbers.r", "write set=PATH=VALUE"),
        ("imgae.width%3D1", "did you mean image?"),
    ] {
        let problem =
            refused(farm.post(&format!("/v1/jobs?set={query}"), text.clone()).await, 422, "wrong_query").await;
        assert!(problem.detail.contains(words), "{query}: {}", problem.detail);
    }
    refused(farm.post("/v1/jobs?set=numbers.r%3D-1", text).await, 422, "wrong_job").await;
    farm.stop().await;
}

#[tokio::test]
async fn jobs_are_found_by_name_part_of_id_or_latest() {
    let farm = Farm::start().await;
    let castle = farm.submit(&named("castle", 1)).await.id;
    let twins = [farm.submit(&named("twin", 2)).await.id, farm.submit(&named("twin", 3)).await.id];
    assert_eq!(found(&farm, "latest").await, [twins[1]]);
    assert_eq!(found(&farm, "castle").await, [castle]);
    assert_eq!(found(&farm, "twin").await, [twins[1], twins[0]]);
    assert_eq!(found(&farm, &castle.short()).await, [castle]);
    assert_eq!(found(&farm, &castle.short().to_uppercase()).await, [castle]);
    assert_eq!(found(&farm, &castle.to_string()).await, [castle]);
    // All ids of one minute start alike, so three characters match nothing; a wildcard matches nothing either.
    assert_eq!(found(&farm, &castle.to_string()[..8]).await.len(), 3);
    for text in [&castle.short()[5..], "cast", "%25", "____", "nothing"] {
        assert_eq!(found(&farm, text).await, [], "{text}");
    }
    refused(farm.get("/v1/jobs?match=latest&state=queued").await, 422, "wrong_query").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_key_without_scope_read_finds_only_its_own_jobs() {
    let (farm, admin) = locked_farm().await;
    let owner = make(&farm, &admin, &new_key("owner", &[Scope::Submit])).await.secret;
    let other = make(&farm, &admin, &new_key("other", &[Scope::Submit])).await.secret;
    let job = named("castle", 1).to_string();
    let job: JobView = read(send(&farm, &owner, Method::POST, "/v1/jobs", job).await, StatusCode::CREATED).await;
    assert_eq!(job.submitter, "owner");
    for text in ["latest".to_owned(), "castle".to_owned(), job.id.short(), job.id.to_string()] {
        let path = format!("/v1/jobs?match={text}");
        let own: JobPage = read(send(&farm, &owner, Method::GET, &path, "").await, StatusCode::OK).await;
        assert_eq!(own.jobs.len(), 1, "{text}");
        let others: JobPage = read(send(&farm, &other, Method::GET, &path, "").await, StatusCode::OK).await;
        assert_eq!(others.jobs.len(), 0, "{text}");
    }
    farm.stop().await;
}
