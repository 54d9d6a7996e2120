//! Jobs that are based on recorded ones have the bytes of a full render, and render only what can differ.

use serde_json::{Value, json};

use crate::support::{Farm, new_key, rendered_here, root, send, succeed};

/// Balls on a floor, far apart, with an edge of tiles of 32 pixels.
pub(crate) fn balls(count: u32, format: &str) -> Value {
    let ball = |index: u32| {
        let at = [f64::from(index % 6) * 2.0 - 5.0, 0.5, f64::from(index / 6) * -2.0];
        json!({ "material": { "diffuse": { "kd": [0.8, 0.2, 0.1] } },
                "shape": { "translate": { "by": at, "child": { "sphere": { "radius": 0.5 } } } } })
    };
    let mut objects: Vec<Value> = (0..count).map(ball).collect();
    objects.push(json!({ "material": { "diffuse": { "kd": [0.5, 0.5, 0.5] } }, "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } }));
    json!({
        "scene": {
            "camera": { "position": [0, 6, 10], "look_at": [0, 0, -2] },
            "lights": [{ "directional": { "direction": [1, -2, -1], "color": [2, 2, 2] } }],
            "objects": objects
        },
        "image": { "width": 320, "height": 192, "samples": 2, "format": format }
    })
}

fn submit(farm: &Farm, query: &str, job: &Value) -> String {
    let answer = farm.send(
        "POST",
        &format!("/v1/jobs{query}"),
        &[("Content-Type", "application/json")],
        job.to_string().into_bytes(),
    );
    assert_eq!(answer.status, 201, "{}", answer.text());
    answer.json()["id"].as_str().expect("an id").to_owned()
}

#[test]
fn an_edit_renders_only_the_tiles_that_can_differ() {
    let farm = Farm::start(&["--workers", "2", "--device", "cpu", "--tile", "32"]);
    for format in ["png", "exr"] {
        let before = balls(12, format);
        let first = submit(&farm, "?record=true", &before);
        let view = farm.succeeded(&first);
        assert_eq!(
            (&view["recorded"], &view["tiles_kept"], &view["based_on"]),
            (&json!(true), &json!(0), &Value::Null)
        );
        assert!(farm.picture(&first) == rendered_here(&before, 0), "the bytes of a full render");
        // A ball in a corner moves.
        let mut moved = before.clone();
        moved["scene"]["objects"][6]["shape"]["translate"]["by"][0] = json!(-5.25);
        let second = submit(&farm, &format!("?based_on={first}"), &moved);
        let view = farm.succeeded(&second);
        assert_eq!((&view["recorded"], &view["based_on"]), (&json!(true), &json!(first)));
        assert!(farm.picture(&second) == rendered_here(&moved, 0), "the bytes of a full render");
        let kept = view["tiles_kept"].as_u64().expect("a number");
        assert!((20..60).contains(&kept), "{kept} of 60 tiles are kept");
        // The result is recorded as well: kept tiles with the records that they had.
        moved["scene"]["objects"][11]["material"]["diffuse"]["kd"] = json!([0.1, 0.2, 0.8]);
        let third = submit(&farm, &format!("?based_on={second}"), &moved);
        let kept = farm.succeeded(&third)["tiles_kept"].as_u64().expect("a number");
        assert!((20..60).contains(&kept), "{kept} of 60 tiles are kept");
        assert!(farm.picture(&third) == rendered_here(&moved, 0), "the bytes of a full render");
        // An undone edit is in the cache, and what is based on it finds the tiles of the jobs before.
        let fourth = submit(&farm, &format!("?based_on={third}"), &before);
        assert_eq!(farm.succeeded(&fourth)["tiles_kept"], json!(0));
        assert!(farm.picture(&fourth) == farm.picture(&first), "the bytes of a full render");
        moved["scene"]["objects"][0]["material"]["diffuse"]["kd"] = json!([0.1, 0.8, 0.2]);
        let fifth = submit(&farm, &format!("?based_on={fourth}"), &moved);
        let kept = farm.succeeded(&fifth)["tiles_kept"].as_u64().expect("a number");
        assert!((20..60).contains(&kept), "{kept} of 60 tiles are kept");
        assert!(farm.picture(&fifth) == rendered_here(&moved, 0), "the bytes of a full render");
        // Another camera changes everything; another size has other tiles.
        moved["scene"]["camera"]["position"][0] = json!(1);
        let sixth = submit(&farm, &format!("?based_on={fifth}"), &moved);
        assert_eq!(farm.succeeded(&sixth)["tiles_kept"], json!(0));
        assert!(farm.picture(&sixth) == rendered_here(&moved, 0), "the bytes of a full render");
        moved["image"]["width"] = json!(288);
        let seventh = submit(&farm, &format!("?based_on={sixth}"), &moved);
        assert_eq!(farm.succeeded(&seventh)["tiles_kept"], json!(0));
        assert!(farm.picture(&seventh) == rendered_here(&moved, 0), "the bytes of a full render");
    }
}

#[test]
fn tiles_are_kept_with_their_job_and_deleted_with_it() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu", "--tile", "32"]);
    let blobs = || farm.blobs();
    let before = balls(6, "png");
    let plain = submit(&farm, "", &before);
    farm.succeeded(&plain);
    crate::support::eventually("the blobs of a job that is not recorded are gone", || (blobs() == 0).then_some(()));
    let refused = |query: &str| {
        farm.send(
            "POST",
            &format!("/v1/jobs{query}"),
            &[("Content-Type", "application/json")],
            before.to_string().into_bytes(),
        )
    };
    let problem = refused(&format!("?based_on={plain}")).problem(422, "wrong_query");
    assert!(problem["detail"].as_str().expect("a text").contains("record=true"), "{problem}");
    let problem = refused("?based_on=").problem(422, "wrong_query");
    assert!(problem["detail"].as_str().expect("a text").contains("based_on is empty"), "{problem}");
    refused("?based_on=01890a5d-ac96-774b-bcce-b302099a8057").problem(404, "unknown_job");
    refused("?based_on=csg").problem(404, "unknown_job");
    // Although its picture is in the cache, it is rendered, because its tiles are to be kept.
    let first = submit(&farm, "?record=true", &before);
    farm.succeeded(&first);
    assert_eq!(blobs(), 120, "60 tiles with their records");
    let deleted = farm.send("DELETE", &format!("/v1/jobs/{first}?dry_run=true"), &[], Vec::new()).json();
    assert_eq!(deleted["blobs"], json!(120), "{deleted}");
    assert!(deleted["size_bytes"].as_u64().expect("a number") > 320 * 192 * 16, "{deleted}");
    let second = submit(&farm, &format!("?based_on={first}"), &{
        let mut edited = before.clone();
        edited["scene"]["objects"][5]["material"]["diffuse"]["kd"] = json!([0, 0, 1]);
        edited
    });
    let kept = farm.succeeded(&second)["tiles_kept"].as_u64().expect("a number");
    assert!((30..60).contains(&kept), "{kept}");
    assert!(blobs() > 120, "{}", blobs());
    for (job, left) in [(&first, 120), (&second, 0)] {
        assert_eq!(send(&farm.address, "DELETE", &format!("/v1/jobs/{job}"), &[], Vec::new()).status, 204);
        crate::support::eventually("only the blobs of the other job are left", || (blobs() == left).then_some(()));
    }
}

#[test]
fn a_job_is_based_on_jobs_that_its_submitter_may_see() {
    let folder = tempfile::tempdir().expect("a folder");
    let [ops, anna, bert] = [("ops", "admin"), ("anna", "submit"), ("bert", "submit")]
        .map(|(name, scope)| new_key(folder.path(), name, scope));
    let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
    let job = balls(2, "png").to_string();
    let post = |key: &str, path: &str, body: &str| {
        farm.send(
            "POST",
            path,
            &[("content-type", "application/json"), ("authorization", key)],
            body.as_bytes().to_vec(),
        )
    };
    let first = post(&anna, "/v1/jobs?record=true", &job).json()["id"].as_str().expect("an id").to_owned();
    let own = post(&bert, "/v1/jobs", &job).json()["id"].as_str().expect("an id").to_owned();
    post(&bert, &format!("/v1/jobs?based_on={first}"), &job).problem(404, "unknown_job");
    let beside = format!(r#"{{ "before": "{first}" }}"#);
    post(&bert, &format!("/v1/jobs/{own}/move"), &beside).problem(404, "unknown_job");
    for key in [&anna, &ops] {
        assert_eq!(post(key, &format!("/v1/jobs?based_on={first}"), &job).status, 201);
    }
    assert_eq!(post(&ops, &format!("/v1/jobs/{own}/move"), &beside).status, 200);
}

#[test]
fn the_command_line_submits_edits() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu"]);
    let scene = root().join("scenes/csg.json");
    let scene = scene.to_str().expect("UTF-8");
    let small = [
        "--set",
        "image.width=320",
        "--set",
        "image.height=180",
        "--set",
        "image.samples=1",
        "--server",
        &farm.address,
    ];
    let first = succeed(&[&["submit", scene, "--wait", "--record"], &small[..]].concat());
    let edit = ["submit", scene, "--wait", "--based-on", first.trim(), "--set", "name=edited"];
    let second = succeed(&[&edit[..], &small[..]].concat());
    let (first, second) = (
        farm.get(&format!("/v1/jobs/{}", first.trim())).json(),
        farm.get(&format!("/v1/jobs/{}", second.trim())).json(),
    );
    assert_eq!((&first["recorded"], &second["based_on"]), (&json!(true), &first["id"]));
}
