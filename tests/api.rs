//! Tests the HTTP API as users and scripts see it.

use std::collections::HashSet;
use std::fs;

use serde_json::Value;

use crate::jobs;
use crate::support::{Farm, eventually, finish, sdfarm, succeed, text};

/// Renders a job with `sdfarm render`.
fn rendered_here(job: &Value, extension: &str) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(format!("picture.{extension}"));
    let command = sdfarm(&["render", "-", "-o", path.to_str().expect("plain")]);
    let output = finish(command, job.to_string().as_bytes());
    assert!(output.status.success(), "{}", text(&output.stderr));
    fs::read(path).expect("a picture")
}

#[test]
fn posted_job_gives_the_picture_that_render_writes() {
    let farm = Farm::start(&["--workers", "1"]);
    let small = jobs::sized(&jobs::named("csg"), 96, 2);
    for (job, extension, kind) in
        [(jobs::as_png(&small), "png", "image/png"), (jobs::as_exr(&small), "exr", "image/x-exr")]
    {
        let accepted = farm.post(&job.to_string());
        assert_eq!(accepted.status, 201, "{}", accepted.text());
        let id = accepted.json()["id"].as_str().expect("an id").to_owned();
        assert_eq!(accepted.header("location"), format!("/v1/jobs/{id}"));
        let view = farm.succeeded(&id);
        assert_eq!(view["name"], "csg");
        assert_eq!(view["progress"], 1.0);
        assert_eq!(view["tiles"]["done"], view["tiles"]["total"]);
        assert_eq!(view["frames"]["done"], 1);
        for time in ["created_at", "started_at", "finished_at"] {
            assert!(view[time].as_str().is_some_and(|time| time.ends_with('Z')), "{view}");
        }

        let image = farm.get(&format!("/v1/jobs/{id}/image"));
        assert_eq!((image.status, image.header("content-type")), (200, kind));
        assert!(image.header("cache-control").contains("immutable"));
        assert!(image.body == rendered_here(&job, extension), "the farm's {extension} is not render's");
        assert!(image.body == farm.picture(&id), "the two addresses of frame 0 differ");
    }
}

#[test]
fn stored_picture_is_cacheable_and_can_be_read_in_ranges() {
    let farm = Farm::start(&["--workers", "1"]);
    let id = farm.accept(&jobs::quick().to_string());
    farm.succeeded(&id);
    let path = format!("/v1/jobs/{id}/image");
    let whole = farm.get(&path);
    let tag = whole.header("etag").to_owned();
    assert!(tag.starts_with('"') && tag.len() > 10, "a strong tag: {tag}");

    let same = farm.send("GET", &path, &[("if-none-match", &tag)], Vec::new());
    assert_eq!((same.status, same.body.len()), (304, 0));
    let other = farm.send("GET", &path, &[("if-none-match", "\"other\"")], Vec::new());
    assert_eq!(other.status, 200);
    let part = farm.send("GET", &path, &[("range", "bytes=1-3")], Vec::new());
    assert_eq!((part.status, part.body.as_slice()), (206, b"PNG".as_slice()));
    assert_eq!(part.header("content-range"), format!("bytes 1-3/{}", whole.body.len()));
    let beyond = farm.send("GET", &path, &[("range", "bytes=999999999-")], Vec::new());
    assert_eq!(beyond.status, 416);
}

#[test]
fn jobs_are_listed_newest_first_and_in_pages() {
    let farm = Farm::start(&["--workers", "0"]);
    let mut ids: Vec<String> =
        (0..5).map(|seed| farm.accept(&jobs::seeded(&jobs::quick(), seed).to_string())).collect();
    ids.reverse();
    let mut seen = Vec::new();
    let mut path = "/v1/jobs?limit=2".to_owned();
    loop {
        let page = farm.get(&path).json();
        let jobs = page["jobs"].as_array().expect("jobs");
        assert!(jobs.len() <= 2);
        seen.extend(jobs.iter().map(|job| job["id"].as_str().expect("an id").to_owned()));
        let Some(cursor) = page["next_cursor"].as_str() else { break };
        path = format!("/v1/jobs?limit=2&cursor={cursor}");
    }
    assert_eq!(seen, ids);
    assert_eq!(farm.get("/v1/jobs?state=succeeded").json()["jobs"], Value::Array(Vec::new()));
    assert_eq!(farm.get("/v1/jobs?state=queued").json()["jobs"].as_array().map(Vec::len), Some(5));
}

#[test]
fn queued_job_can_be_cancelled_once_then_deleted() {
    let farm = Farm::start(&["--workers", "0"]);
    let id = farm.accept(&jobs::quick().to_string());
    let path = format!("/v1/jobs/{id}");
    let cancelled = farm.send("POST", &format!("{path}/cancel"), &[], Vec::new());
    assert_eq!((cancelled.status, &cancelled.json()["state"]), (200, &Value::from("cancelled")));
    assert_eq!(farm.send("POST", &format!("{path}/cancel"), &[], Vec::new()).status, 409);
    assert_eq!(farm.send("DELETE", &path, &[], Vec::new()).status, 204);
    assert_eq!(farm.get(&path).status, 404);
}

#[test]
fn cancel_stops_a_running_job_and_frees_its_worker() {
    let farm = Farm::start(&["--workers", "1"]);
    let id = farm.accept(&jobs::endless().to_string());
    let path = format!("/v1/jobs/{id}");
    eventually("the job runs", || (farm.get(&path).json()["state"] == "running").then_some(()));
    assert_eq!(farm.send("DELETE", &path, &[], Vec::new()).status, 409);
    assert_eq!(farm.send("POST", &format!("{path}/cancel"), &[], Vec::new()).status, 200);
    assert_eq!(farm.get(&path).json()["state"], "cancelled");
    let next = farm.accept(&jobs::quick().to_string());
    farm.succeeded(&next);
    assert_eq!(farm.send("DELETE", &path, &[], Vec::new()).status, 204);
}

#[test]
fn pool_grows_and_shrinks_while_it_serves() {
    let farm = Farm::start(&["--workers", "0"]);
    for workers in [2, 3, 1, 0] {
        farm.set_pool(workers);
        eventually("the processes are as many", || (farm.workers().len() == workers as usize).then_some(()));
        let listed = farm.get("/v1/workers").json();
        let listed = listed["workers"].as_array().expect("workers");
        assert_eq!(listed.iter().filter(|worker| worker["state"] == "ready").count(), workers as usize);
    }
}

#[test]
fn resubmitted_job_takes_its_picture_from_the_store() {
    let farm = Farm::start(&["--workers", "1"]);
    let job = jobs::quick().to_string();
    let first = farm.accept(&job);
    farm.succeeded(&first);
    farm.set_pool(0);
    let again = farm.accept(&job);
    farm.succeeded(&again);
    assert!(farm.picture(&first) == farm.picture(&again));
    let headers = [("content-type", "application/json"), ("cache-control", "no-cache")];
    let uncached = farm.send("POST", "/v1/jobs", &headers, job.into_bytes());
    assert_eq!((uncached.status, &uncached.json()["state"]), (201, &Value::from("queued")));
}

#[test]
fn dry_run_checks_and_accepts_nothing() {
    let farm = Farm::start(&["--workers", "0"]);
    let job = jobs::quick();
    let answer = farm.send("POST", "/v1/jobs?dry_run=true", &[], job.to_string().into_bytes());
    assert_eq!(answer.status, 200, "{}", answer.text());
    let checked = answer.json();
    assert_eq!((&checked["valid"], &checked["frames"]), (&Value::from(true), &Value::from(1)));
    assert_eq!(checked["rays"], 96 * 54 * 2);
    assert_eq!(farm.get("/v1/jobs").json()["jobs"].as_array().map(Vec::len), Some(0));
}

#[test]
fn openapi_document_is_valid_and_names_every_route() {
    let farm = Farm::start(&["--workers", "0"]);
    let document = farm.get("/openapi.json").json();
    assert!(document["openapi"].as_str().is_some_and(|version| version.starts_with("3.1")));
    for (path, methods) in [
        ("/v1/jobs", vec!["get", "post"]),
        ("/v1/jobs/{id}", vec!["get", "delete"]),
        ("/v1/jobs/{id}/cancel", vec!["post"]),
        ("/v1/jobs/{id}/image", vec!["get"]),
        ("/v1/jobs/{id}/frames/{frame}/image", vec!["get"]),
        ("/v1/workers", vec!["get"]),
        ("/v1/pool", vec!["get", "put"]),
        ("/v1/scaling", vec!["get"]),
        ("/v1/schema/job", vec!["get"]),
        ("/livez", vec!["get"]),
        ("/readyz", vec!["get"]),
    ] {
        for method in methods {
            assert!(document["paths"][path][method].is_object(), "{method} {path} is missing");
        }
    }
    let mut operations = HashSet::new();
    every_reference(&document, &mut |reference| {
        let pointer = reference.strip_prefix('#').expect("references stay within the document");
        assert!(document.pointer(pointer).is_some(), "{reference} leads nowhere");
    });
    for methods in document["paths"].as_object().expect("paths").values() {
        for operation in methods.as_object().expect("methods").values().filter(|value| value.is_object()) {
            if let Some(id) = operation["operationId"].as_str() {
                assert!(operations.insert(id.to_owned()), "{id} occurs twice");
            }
        }
    }
}

fn every_reference(value: &Value, visit: &mut impl FnMut(&str)) {
    match value {
        Value::Object(object) => {
            for (key, value) in object {
                if let ("$ref", Some(reference)) = (key.as_str(), value.as_str()) {
                    visit(reference);
                }
                every_reference(value, visit);
            }
        }
        Value::Array(values) => values.iter().for_each(|value| every_reference(value, visit)),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
    }
}

#[test]
fn documentation_page_fetches_nothing_from_other_hosts() {
    let farm = Farm::start(&["--workers", "0"]);
    let mut page = farm.get("/docs");
    if (300..400).contains(&page.status) {
        page = farm.get(page.header("location"));
    }
    assert_eq!(page.status, 200);
    assert!(page.header("content-type").starts_with("text/html"));
    for attribute in ["src=\"http", "href=\"http", "src=\"//", "href=\"//", "url(http"] {
        assert!(!page.text().contains(attribute), "{attribute}");
    }
}

#[test]
fn served_schema_is_the_one_the_command_prints() {
    let farm = Farm::start(&["--workers", "0"]);
    let printed: Value = serde_json::from_str(&succeed(&["schema"])).expect("JSON");
    let served = farm.get("/v1/schema/job");
    assert_eq!(served.json(), printed);
    assert_eq!(printed["$schema"], "https://json-schema.org/draft/2020-12/schema");
}

#[test]
fn health_is_degraded_without_workers_and_ready_with_them() {
    let farm = Farm::start(&["--workers", "0"]);
    assert_eq!(farm.get("/livez").status, 200);
    let alone = farm.get("/readyz");
    assert_eq!(alone.status, 200, "{}", alone.text());
    assert!(alone.text().contains("degraded"), "{}", alone.text());
    farm.set_pool(1);
    let ready = farm.get("/readyz");
    assert!(ready.status == 200 && !ready.text().contains("degraded"), "{}", ready.text());
}

#[test]
fn every_response_has_a_request_id() {
    let farm = Farm::start(&["--workers", "0"]);
    let answer = farm.get("/livez");
    assert!(!answer.header("x-request-id").is_empty());
    let problem = farm.get("/v1/nothing");
    assert_eq!(problem.status, 404);
    assert_eq!(problem.json()["request_id"].as_str(), Some(problem.header("x-request-id")));
}

#[test]
fn jobs_and_pictures_survive_a_restart() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm = Farm::start_on(folder.path(), &["--workers", "1"]);
    let id = farm.accept(&jobs::quick().to_string());
    farm.succeeded(&id);
    let picture = farm.picture(&id);
    assert!(farm.terminate().success(), "a graceful shutdown exits with 0");
    let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
    assert!(farm.picture(&id) == picture);
}
