//! Verifies pictures of a real farm: by their job and as files, genuine and forged.

use std::path::Path;

use serde_json::{Value, json};

use crate::support::{Farm, run, succeed, text};

/// A ball over a gradient, of 3 by 2 tiles.
fn ball(samples: u32, format: &str) -> Value {
    json!({
        "name": "ball",
        "scene": {
            "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
            "background": { "gradient": { "bottom": [0.1, 0.1, 0.2], "top": [0.5, 0.6, 0.9] } },
            "objects": [{ "material": { "diffuse": { "kd": "#d08040" } }, "shape": { "sphere": { "radius": 1 } } }]
        },
        "image": { "width": 160, "height": 100, "samples": samples, "format": format }
    })
}

/// Runs `sdfarm verify`; returns its exit code and its JSON, if it printed some.
fn verify(arguments: &[&str]) -> (Option<i32>, Value) {
    let output = run(&[&["verify"], arguments, &["--json", "--device", "cpu"]].concat());
    (output.status.code(), serde_json::from_slice(&output.stdout).unwrap_or_else(|_| json!(text(&output.stderr))))
}

/// Changes one value of a PNG by one, and writes a valid PNG with the same metadata.
fn forge(from: &Path, to: &Path, x: usize, y: usize) {
    let file = std::fs::read(from).expect("a picture");
    let mut reader = png::Decoder::new(std::io::Cursor::new(&file)).read_info().expect("a PNG");
    let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
    let frame = reader.next_frame(&mut pixels).expect("pixels");
    reader.finish().expect("complete");
    pixels[(y * frame.width as usize + x) * 3 + 1] ^= 1;
    let out = std::fs::File::create(to).expect("created");
    let mut encoder = png::Encoder::new(out, frame.width, frame.height);
    encoder.set_color(frame.color_type);
    encoder.set_depth(frame.bit_depth);
    for chunk in &reader.info().utf8_text {
        encoder.add_itxt_chunk(chunk.keyword.clone(), chunk.get_text().expect("text")).expect("added");
    }
    encoder.write_header().expect("written").write_image_data(&pixels).expect("written");
}

#[test]
fn pictures_of_a_farm_are_verified_by_their_job_and_as_files() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu"]);
    let server = farm.address.as_str();
    let folder = tempfile::tempdir().expect("a folder");
    let place = |name: &str| folder.path().join(name).to_str().expect("a plain name").to_owned();
    // Two jobs of one scene, whose files say the same of themselves.
    let few = farm.accept(&ball(1, "png").to_string());
    let id = farm.accept(&ball(4, "png").to_string());
    farm.succeeded(&few);
    farm.succeeded(&id);
    let (genuine, forged) = (place("genuine.png"), place("forged.png"));
    succeed(&["fetch", &id, "--server", server, "-o", &genuine]);

    let (code, by_job) = verify(&[&id, "--server", server, "--all"]);
    assert_eq!((code, &by_job["same"], &by_job["tiles_checked"]), (Some(0), &json!(true), &json!(6)), "{by_job}");
    assert_eq!(by_job["made_by"][0]["device"], "cpu", "{by_job}");
    let (code, by_file) = verify(&[&genuine, "--server", server, "--all"]);
    assert_eq!((code, by_file), (Some(0), by_job.clone()));

    forge(Path::new(&genuine), Path::new(&forged), 150, 70);
    let marked = place("marked.png");
    let (code, found) = verify(&[&forged, "--server", server, "--all", "-o", &marked]);
    assert_eq!((code, &found["same"], &found["pixels_different"]), (Some(1), &json!(false), &json!(1)), "{found}");
    let tile = &found["differs"][0];
    assert_eq!([&tile["x"], &tile["y"], &tile["width"], &tile["height"]], [128, 64, 32, 36], "{found}");
    assert_eq!(
        (&tile["first"]["x"], &tile["first"]["y"], &tile["first"]["channel"]),
        (&json!(150), &json!(70), &json!("G"))
    );
    assert!(std::fs::read(&marked).expect("drawn").starts_with(b"\x89PNG"));
    let printed = run(&["verify", &forged, "--server", server, "--all", "--device", "cpu"]);
    let printed = text(&printed.stdout);
    assert!(printed.contains("tile 32×36 at (128, 64): 1 pixel; at (150, 70), G is"), "{printed}");

    // Without a farm: by the job's file, with the right number of samples and with another.
    let job = place("job.json");
    std::fs::write(&job, ball(4, "png").to_string()).expect("written");
    assert_eq!(verify(&[&genuine, "--job", &job, "--all"]).0, Some(0));
    assert_eq!(verify(&[&genuine, "--job", &job, "--all", "--samples", "2"]).0, Some(1));
    let unknown = Farm::start(&["--workers", "0"]);
    let (code, reason) = verify(&[&genuine, "--server", &unknown.address]);
    assert!(code == Some(2) && reason.as_str().is_some_and(|reason| reason.contains("--job")), "{reason}");
    for (wrong, words) in [(place("none.png"), "there is no file"), (job.clone(), "neither a PNG nor an EXR")] {
        let (code, reason) = verify(&[&wrong, "--server", server]);
        assert!(code == Some(2) && reason.as_str().is_some_and(|reason| reason.contains(words)), "{reason}");
    }
}

#[test]
fn server_verifies_what_it_stores() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu"]);
    for format in ["png", "exr"] {
        let id = farm.accept(&ball(2, format).to_string());
        farm.succeeded(&id);
        let ask = |query: &str| {
            let answer = farm.send("POST", &format!("/v1/jobs/{id}/frames/0/verify{query}"), &[], Vec::new());
            assert_eq!(answer.status, 200, "{}\n{}", answer.text(), farm.log());
            answer.json()
        };
        let verified = ask("?tiles=4");
        assert_eq!(
            (&verified["same"], &verified["tiles_checked"], &verified["tiles_total"]),
            (&json!(true), &json!(4), &json!(6))
        );
        assert_eq!(verified["made_by"][0]["tiles"][0], json!([0, 0, 160, 100]), "{verified}");
        let named = ask("?tiles=0");
        assert_eq!((&named["made_by"], &named["scene"]), (&verified["made_by"], &verified["scene"]), "{named}");
        let found = farm.get(&format!("/v1/jobs?scene={}", verified["scene"].as_str().expect("a hash"))).json();
        assert!(found["jobs"].as_array().expect("a list").iter().any(|job| job["id"] == id.as_str()), "{found}");
    }
    // A job that takes its picture from the cache was made by the same worker.
    let again = farm.accept(&ball(2, "png").to_string());
    farm.succeeded(&again);
    let answer = farm.send("POST", &format!("/v1/jobs/{again}/frames/0/verify?tiles=0"), &[], Vec::new());
    assert_eq!(answer.json()["made_by"][0]["device"], "cpu");
}
