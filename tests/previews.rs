//! Tests previews, thumbnails, estimates, and links on a real farm, by the pixels of the pictures.

use std::time::Instant;

use serde_json::{Value, json};

use crate::support::{Farm, eventually, run, succeed, text};

/// Job of a ball in front of a gradient sky, off center, so that a flipped picture is detected.
fn ball(width: u32, height: u32, samples: u32) -> Value {
    json!({
        "name": "ball",
        "scene": {
            "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
            "background": { "color": [0.05, 0.1, 0.4] },
            "objects": [{
                "material": { "flat": { "color": [0.9, 0.5, 0.1] } },
                "shape": { "translate": { "by": [-1, 0.6, 0], "child": { "sphere": { "radius": 0.7 } } } }
            }]
        },
        "image": { "width": width, "height": height, "samples": samples, "exposure": 0.5, "tone_map": "filmic" }
    })
}

/// Decodes a PNG to 8-bit RGB, row by row from the top; returns it with the width.
fn pixels(png: &[u8]) -> (Vec<[u8; 3]>, usize) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("pixels");
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
    (bytes.as_chunks().0.to_vec(), info.width as usize)
}

fn preview(farm: &Farm, id: &str, query: &str) -> Vec<u8> {
    let answer = farm.get(&format!("/v1/jobs/{id}/frames/0/preview{query}"));
    assert_eq!(answer.status, 200, "{}\n{}", answer.text(), farm.log());
    assert_eq!(answer.header("content-type"), "image/png");
    answer.body
}

/// Maximum and mean difference of the channels of two pictures of the same size.
fn difference(left: &[[u8; 3]], right: &[[u8; 3]]) -> (u8, f64) {
    assert_eq!(left.len(), right.len());
    let each: Vec<u8> = left.as_flattened().iter().zip(right.as_flattened()).map(|(a, b)| a.abs_diff(*b)).collect();
    let sum: f64 = each.iter().map(|&n| f64::from(n)).sum();
    (each.iter().copied().max().expect("pixels"), sum / each.len() as f64)
}

#[test]
fn preview_of_a_queued_job_is_the_coarse_pass() {
    let farm = Farm::start(&["--workers", "0"]);
    let id = farm.accept(&ball(320, 180, 4).to_string());
    let start = Instant::now();
    let png = preview(&farm, &id, "");
    println!("the first preview took {} ms in a debug build", start.elapsed().as_millis());
    let (coarse, width) = pixels(&png);
    assert_eq!((width, coarse.len()), (320, 320 * 180));
    let [r, _, b] = coarse[55 * 320 + 100];
    assert!(r > b, "the ball is up and to the left: {r} {b}");
    let [r, _, b] = coarse[125 * 320 + 220];
    assert!(r < b, "the sky is everywhere else: {r} {b}");
    let (small, width) = pixels(&preview(&farm, &id, "?width=32"));
    assert_eq!((width, small.len()), (32, 32 * 18));
    let (one, _) = pixels(&preview(&farm, &id, "?width=1"));
    assert_eq!(one.len(), 1);
}

#[test]
fn stored_picture_is_its_preview_and_thumbnails_average_it() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu"]);
    for format in ["png", "exr"] {
        let mut job = ball(256, 144, 1);
        if format == "exr" {
            job["image"] = json!({ "width": 256, "height": 144, "samples": 1, "format": "exr", "precision": "float" });
        }
        let id = farm.accept(&job.to_string());
        farm.succeeded(&id);
        let (shown, width) = pixels(&preview(&farm, &id, ""));
        assert_eq!(width, 256);
        if format == "png" {
            assert_eq!(shown, pixels(&farm.picture(&id)).0, "a picture that fits is shown as it is");
        }
        let answer = farm.get(&format!("/v1/jobs/{id}/frames/0/thumbnail?width=64"));
        assert_eq!(answer.status, 200, "{}", answer.text());
        assert_eq!(answer.header("cache-control"), "public, max-age=31536000, immutable");
        let (thumbnail, width) = pixels(&answer.body);
        assert_eq!((width, thumbnail.len()), (64, 64 * 36));
        // Far from edges, a value between two levels may be rounded to either.
        let shades = (140..144).flat_map(|y| shown[y * 256 + 240..][..4].to_vec());
        let shades: Vec<[u8; 3]> = shades.collect();
        for (channel, &level) in thumbnail[35 * 64 + 60].iter().enumerate() {
            let levels = shades.iter().map(|shade| shade[channel]);
            let (least, most) = (levels.clone().min().expect("sixteen"), levels.max().expect("sixteen"));
            assert!(least <= level && level <= most && most - least <= 1, "{channel}: {level}, {shades:?}");
        }
        let tag = answer.header("etag").to_owned();
        let path = format!("/v1/jobs/{id}/frames/0/thumbnail?width=64");
        assert_eq!(farm.send("GET", &path, &[("if-none-match", &tag)], Vec::new()).status, 304);
    }
}

#[test]
fn preview_shows_finished_tiles_exactly() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu", "--threads", "1", "--tile", "32"]);
    // Large enough for several batches, so that there are blobs while it renders.
    let id = farm.accept(&ball(256, 256, 400).to_string());
    let before = eventually("a run of tiles is finished", || {
        let job = farm.get(&format!("/v1/jobs/{id}")).json();
        let done = job["tiles"]["done"].as_u64().expect("a count");
        assert_ne!(job["state"], "failed", "{job}");
        (done > 0).then_some(job)
    });
    let (shown, _) = pixels(&preview(&farm, &id, ""));
    farm.succeeded(&id);
    let (picture, _) = pixels(&farm.picture(&id));
    let same = |tile: usize| {
        let (x, y) = (tile % 8 * 32, tile / 8 * 32);
        (y..y + 32).all(|row| shown[row * 256 + x..][..32] == picture[row * 256 + x..][..32])
    };
    let exact = (0..64).filter(|&tile| same(tile)).count() as u64;
    let done = before["tiles"]["done"].as_u64().expect("a count");
    assert!(exact >= done, "{exact} tiles are exact, {done} were finished before");
    let (_, mean) = difference(&shown, &picture);
    assert!(mean < 8.0, "the coarse pass has another brightness: {mean}");
}

#[test]
fn dry_run_estimates_time_and_memory() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu"]);
    farm.ready(1);
    for name in ["csg", "menger", "turntable"] {
        let job = std::fs::read_to_string(crate::support::root().join(format!("scenes/{name}.json"))).expect("shipped");
        let answer = farm.send("POST", "/v1/jobs?dry_run=true", &[], job.into_bytes());
        assert_eq!(answer.status, 200, "{}", answer.text());
        let dry = answer.json();
        let estimate = &dry["estimate"];
        assert_eq!(estimate["rays"], dry["rays"], "{dry}");
        assert!(estimate["sample_rays"].as_u64().is_some_and(|rays| rays > 0), "{dry}");
        assert!(estimate["seconds"].as_f64().is_some_and(|seconds| seconds > 0.0), "{dry}");
        assert!(estimate["memory_bytes"].as_u64().is_some_and(|bytes| bytes > 1 << 20), "{dry}");
        println!("{name}: {estimate}");
    }
    let scene = crate::support::root().join("scenes/csg.json");
    let local = succeed(&["check", "--estimate", scene.to_str().expect("a plain path")]);
    assert!(local.contains("camera rays"), "{local}");
}

#[test]
fn preview_and_link_commands_work() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu"]);
    let id = farm.accept(&ball(64, 64, 1).to_string());
    farm.succeeded(&id);
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("so-far.png");
    let name = file.to_str().expect("a plain name");
    succeed(&["preview", &id, "--server", &farm.address, "-o", name, "--width", "16"]);
    assert_eq!(pixels(&std::fs::read(&file).expect("written")).1, 16);
    let link = succeed(&["link", &id, "--server", &farm.address, "--expires", "1h"]);
    let path = link.trim().strip_prefix(farm.address.as_str()).expect("the server's address");
    assert_eq!(farm.get(path).body, farm.picture(&id));
    let shown = succeed(&["link", &id, "--server", &farm.address, "--preview"]);
    let path = shown.trim().strip_prefix(farm.address.as_str()).expect("the server's address");
    assert_eq!(pixels(&farm.get(path).body).1, 64);
    let wrong = run(&["link", &id, "--server", &farm.address, "--expires", "forever"]);
    assert_eq!(wrong.status.code(), Some(2), "{}", text(&wrong.stderr));
    let printed = succeed(&["gc", "--server", &farm.address, "--dry-run", "--json"]);
    assert_eq!(serde_json::from_str::<Value>(&printed).expect("JSON")["jobs"], json!([]));
}

#[test]
fn preview_helper_exits_with_its_input_and_reports_errors() {
    for line in ["", "{}\n", "{\"what\":\"thumbnail\",\"file\":\"/nonexistent\",\"width_px\":9}\n"] {
        let output = crate::support::finish(crate::support::sdfarm(&["preview-helper"]), line.as_bytes());
        assert_eq!(output.status.code(), Some(1), "{line}");
    }
}
