//! Workers and their keys: only the key that registered a worker speaks for it, and transfers what its leases need.

use proto::api_key::Scope;
use proto::worker_protocol;
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};

use super::fake_pictures;
use super::harness::{Farm, read, refused, small_job};
use super::keys::{locked_farm, make, new_key, send};

/// Registers a worker with a key; returns its id.
async fn register(farm: &Farm, key: &str) -> String {
    let hello = json!({
        "name": "host", "device": "cpu", "picture_version": scene::PICTURE_VERSION, "max_nodes": null, "process": 1
    });
    let answer = send(farm, key, Method::POST, worker_protocol::REGISTER_PATH, hello.to_string()).await;
    read::<Value>(answer, StatusCode::OK).await["worker"].as_str().expect("an id").to_owned()
}

/// Sends a worker's sync with a key.
async fn sync(farm: &Farm, key: &str, worker: &str, reports: Value) -> Response {
    let wants_work = reports == json!([]);
    let said = json!({
        "worker": worker, "rays_per_second": null, "held_leases": [], "reports": reports, "wants_work": wants_work,
        "wait_ms": 0
    });
    send(farm, key, Method::POST, worker_protocol::SYNC_PATH, said.to_string()).await
}

#[tokio::test]
async fn a_worker_belongs_to_the_key_that_registered_it() {
    let (farm, admin) = locked_farm().await;
    let owner = make(&farm, &admin, &new_key("host-1", &[Scope::Worker])).await.secret;
    let other = make(&farm, &admin, &new_key("host-2", &[Scope::Worker])).await.secret;
    let job: Value =
        read(send(&farm, &admin, Method::POST, "/v1/jobs", small_job(1).to_string()).await, StatusCode::CREATED).await;
    let job = job["id"].as_str().expect("an id");
    let worker = register(&farm, &owner).await;
    let stranger = register(&farm, &other).await;
    let picture =
        fake_pictures::picture(&scene::parse(small_job(1).to_string().as_bytes()).expect("a job"), 0, b"a picture");
    let hash = blake3::hash(&picture).to_hex().to_string();
    let (upload, file) = (worker_protocol::picture_path(&hash), format!("/v1/worker/jobs/{job}"));

    // Without a lease, a key transfers nothing.
    refused(send(&farm, &owner, Method::PUT, &upload, picture.clone()).await, 403, "no_lease").await;
    refused(send(&farm, &owner, Method::GET, &file, "").await, 403, "no_lease").await;
    let batch: Value = read(sync(&farm, &owner, &worker, json!([])).await, StatusCode::OK).await;
    let lease = &batch["batch"]["work"]["render"]["tiles"][0]["lease"];
    assert!(lease.is_string(), "{batch}");

    // Another key speaks neither for the worker nor with its lease.
    let report = json!([{ "lease": lease, "outcome": "released" }]);
    refused(sync(&farm, &other, &worker, report.clone()).await, 403, "foreign_worker").await;
    refused(sync(&farm, &admin, &worker, json!([])).await, 403, "foreign_worker").await;
    refused(send(&farm, &other, Method::PUT, &upload, picture.clone()).await, 403, "no_lease").await;
    refused(
        send(&farm, &other, Method::PUT, &upload.replace("pictures", "blobs"), picture.clone()).await,
        403,
        "no_lease",
    )
    .await;
    refused(send(&farm, &other, Method::GET, &file, "").await, 403, "no_lease").await;
    let blob = worker_protocol::blob_path(&hash);
    refused(send(&farm, &other, Method::GET, &blob, "").await, 403, "no_lease").await;
    let lost: Value = read(sync(&farm, &other, &stranger, report).await, StatusCode::OK).await;
    assert_eq!(lost["revoked_leases"], json!([lease]), "a foreign lease is not its own");

    assert_eq!(send(&farm, &owner, Method::GET, &file, "").await.status(), StatusCode::OK);
    assert_eq!(send(&farm, &owner, Method::PUT, &upload, picture.clone()).await.status(), StatusCode::NO_CONTENT);
    let outcome = json!({ "picture": { "hash": hash, "size_bytes": picture.len() } });
    let done = sync(&farm, &owner, &worker, json!([{ "lease": lease, "outcome": outcome }])).await;
    assert_eq!(read::<Value>(done, StatusCode::OK).await["revoked_leases"], json!([]));

    // Only its key's owner may keep the picture; a signed link may always be shared, and is revalidated.
    for path in ["image", "frames/0/image"] {
        let image = send(&farm, &admin, Method::GET, &format!("/v1/jobs/{job}/{path}"), "").await;
        assert_eq!(image.headers()["cache-control"], "private, max-age=31536000, immutable", "{path}");
    }
    for path in ["frames.zip", "frames", "file", ""] {
        let answer = send(&farm, &admin, Method::GET, format!("/v1/jobs/{job}/{path}").trim_end_matches('/'), "").await;
        assert_eq!(answer.headers()["cache-control"], "private", "{path}");
    }
    farm.stop().await;
}
