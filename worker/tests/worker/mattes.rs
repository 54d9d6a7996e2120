//! Mattes: coverage by objects and materials, as an EXR has it and as another program reads it.

use std::io::{Cursor, Write};
use std::process::{Command, Stdio};

use proto::Rect;
use scene::Job;
use serde_json::{Value, json};
use worker::image::PictureSpec;
use worker::stitch::TileRows;
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TilePixels, TileRequest};

const EDGE: u32 = 40;

fn parsed(text: &Value) -> Job {
    scene::parse(text.to_string().as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}\n{text}"))
}

/// Two balls of one name, one without a name in front of them, and a floor, before a transparent background.
fn job() -> Value {
    let ball = |x: f64, radius: f64| json!({ "translate": { "by": [x, 0, radius], "child": { "sphere": { "radius": radius } } } });
    json!({
        "scene": { "camera": { "position": [0, 1, 5], "look_at": [0, 0, 0], "lens": { "aperture": 0.1, "focus": 4 } },
            "background": "transparent",
            "materials": { "red": { "diffuse": { "kd": [1, 0, 0] } }, "grün/blau": { "diffuse": { "kd": [0, 1, 1] } } },
            "objects": [
                { "name": "Kugel ö", "material": "red", "shape": ball(-0.9, 0.6) },
                { "name": "Kugel ö", "material": "grün/blau", "shape": ball(0.9, 0.6) },
                { "material": { "normals": {} }, "shape": ball(0.0, 0.5) },
                { "name": "floor", "material": "red", "shape": { "translate": { "by": [0, -0.8, 0], "child": { "box": { "size": [4, 0.2, 4] } } } } }
            ] },
        "image": { "width": EDGE, "height": EDGE, "samples": 16, "format": "exr", "layers": ["crypto_object", "depth", "crypto_material"] }
    })
}

fn render(job: &Job, rect: Rect) -> TilePixels {
    let renderer = CpuRenderer::new(Some(1), Simd::Auto).expect("a renderer");
    renderer.render(&TileRequest { job, frame: 0, rect }, &CancelFlag::new(), &|_| ()).expect("pixels")
}

fn encoded(job: &Job, tiles: &[TilePixels]) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let picture = PictureSpec::new(&job.at(0).expect("a valid frame"));
    picture.write(&mut TileRows(tiles), &mut file, &CancelFlag::new()).expect("a picture");
    file.into_inner()
}

/// The pairs of ids and coverages of a pixel in a layer of mattes, whose planes begin with this one.
fn ranks(pixels: &TilePixels, first: usize, pixel: usize) -> Vec<(f32, f32)> {
    let value = |plane: usize| pixels.planes[plane][pixel];
    (0..6).map(|rank| (value(first + 2 * rank), value(first + 2 * rank + 1))).collect()
}

#[test]
fn coverages_are_ranked_and_sum_to_alpha() {
    let job = parsed(&job());
    let pixels = render(&job, Rect::full(EDGE, EDGE));
    let mut mixed = 0;
    for pixel in 0..(EDGE * EDGE) as usize {
        let alpha = pixels.planes[3][pixel];
        for first in [4, 17] {
            let ranks = ranks(&pixels, first, pixel);
            let sum: f32 = ranks.iter().map(|(_, coverage)| coverage).sum();
            assert!((sum - alpha).abs() < 1e-6, "pixel {pixel}: {ranks:?} of {alpha}");
            assert!(ranks.windows(2).all(|two| two[0].1 > two[1].1 || (two[0].1 == two[1].1 && two[0].0 <= two[1].0)));
            assert!(
                ranks
                    .iter()
                    .all(|&(id, coverage)| (id.to_bits() == 0) == (coverage == 0.0) && (id == 0.0 || id.is_normal()))
            );
            mixed += usize::from(ranks[1].1 > 0.0);
        }
    }
    assert!(mixed > 50, "{mixed} pixels show two things");
}

#[test]
fn tiles_and_repeated_encodings_have_the_same_bytes() {
    let job = parsed(&job());
    let whole = encoded(&job, &[render(&job, Rect::full(EDGE, EDGE))]);
    let rects = [(0, 0, 32, 32), (32, 0, 8, 32), (0, 32, 32, 8), (32, 32, 8, 8)];
    let tiles = rects.map(|(x, y, width, height)| render(&job, Rect { x, y, width, height }));
    assert!((0..20).all(|_| encoded(&job, &tiles) == whole), "the bytes differ");
}

#[test]
fn an_independent_reader_finds_ids_names_and_coverages() {
    let tools = concat!(env!("CARGO_MANIFEST_DIR"), "/../.whl");
    let python = |program: &str| {
        let mut command = Command::new("python3");
        command.env("PYTHONPATH", tools).args(["-c", program]).stdin(Stdio::piped()).stdout(Stdio::piped());
        command
    };
    if !python("import OpenEXR").stderr(Stdio::null()).status().is_ok_and(|status| status.success()) {
        eprintln!("python3 or its package OpenEXR is missing: the independent EXR reader was NOT run");
        return;
    }
    let job = parsed(&job());
    let pixels = render(&job, Rect::full(EDGE, EDGE));
    let mut child = python(include_str!("read_mattes.py")).spawn().expect("python3 starts");
    child.stdin.take().expect("it is piped").write_all(&encoded(&job, &[pixels])).expect("it reads");
    let output = child.wait_with_output().expect("it ends");
    assert!(output.status.success(), "the reader failed");
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let names = |key: &str| {
        found[key]["seen"]
            .as_array()
            .expect("a list")
            .iter()
            .map(|name| name.as_str().expect("a name"))
            .collect::<Vec<_>>()
    };
    assert_eq!(names("CryptoObject"), ["Kugel ö", "floor", "object 2"]);
    assert_eq!(names("CryptoMaterial"), ["grün/blau", "objects/2/material", "red"]);
    assert_eq!(
        (&found["CryptoObject"]["key"], &found["CryptoMaterial"]["key"]),
        (&json!("3ae39a5"), &json!("be359d6"))
    );
}

#[test]
fn names_change_the_key_of_a_picture_with_mattes_alone() {
    let keys = |name: &str, layers: Value| {
        let mut text = job();
        text["scene"]["objects"][3]["name"] = json!(name);
        text["image"]["layers"] = layers;
        let job = parsed(&text);
        let at_frame = job.at(0).expect("a valid frame");
        (at_frame.pixels_cache_key(), at_frame.cache_key())
    };
    assert_eq!(keys("a", json!(["depth"])), keys("b", json!(["depth"])));
    let (one, other) = (keys("a", json!(["crypto_object"])), keys("b", json!(["crypto_object"])));
    assert!(one.0 != other.0 && one.1 != other.1);
}

/// Many shapes are rendered by cells, whose rows have the ids.
#[test]
fn many_objects_have_their_ids() {
    let ball = |index: u32| {
        let (x, y) = (f64::from(index % 12) * 0.4 - 2.2, f64::from(index / 12) * 0.4 - 2.0);
        json!({ "name": format!("ball {}", index % 7), "shape": { "translate": { "by": [x, y, 0], "child": { "sphere": { "radius": 0.18 } } } } })
    };
    let text = json!({
        "scene": { "camera": { "position": [0, 0, 6], "look_at": [0, 0, 0] }, "objects": (0..132).map(ball).collect::<Vec<_>>() },
        "image": { "width": EDGE, "height": EDGE, "samples": 4, "format": "exr", "layers": ["object", "crypto_object"] }
    });
    let job = parsed(&text);
    let ids = job.at(0).expect("a valid frame").mattes()[0].ids();
    let pixels = render(&job, Rect::full(EDGE, EDGE));
    let mut whole = 0;
    for pixel in 0..(EDGE * EDGE) as usize {
        let (object, (id, coverage)) = (pixels.planes[4][pixel], ranks(&pixels, 5, pixel)[0]);
        if object >= 0.0 && coverage == 1.0 {
            whole += 1;
            assert_eq!(id.to_bits(), ids[object as usize], "pixel {pixel}");
        }
    }
    assert!(whole > 100, "{whole} pixels show one object");
}
