//! Tests the layers and pixel values of stored pictures, on a real farm.

use image::{Rgb, RgbImage};
use serde_json::{Value, json};

use crate::support::Farm;

/// A red ball and a blue one on a plane, in an EXR with all layers.
fn layered() -> Value {
    json!({
        "scene": {
            "camera": { "position": [0, 1, 6], "look_at": [0, 0, 0] },
            "background": { "color": [0.25, 0.5, 0.75] },
            "objects": [
                { "material": { "flat": { "color": [0.5, 0, 0] } }, "shape": { "sphere": { "radius": 1 } } },
                { "material": { "flat": { "color": [0, 0, 4] } },
                  "shape": { "translate": { "by": [2, 0, -1], "child": { "sphere": { "radius": 1 } } } } },
                { "material": { "flat": { "color": [0.2, 0.2, 0.2] } }, "shape": { "plane": { "normal": [0, 1, 0], "offset": -1 } } }
            ]
        },
        "image": {
            "width": 96, "height": 54, "samples": 1, "format": "exr", "precision": "float",
            "layers": ["depth", "normal", "position", "albedo", "object", "steps"]
        }
    })
}

fn decoded(png: &[u8]) -> RgbImage {
    image::load_from_memory_with_format(png, image::ImageFormat::Png).expect("a PNG").into_rgb8()
}

#[test]
fn layers_of_an_exr_are_pictures_and_its_pixels_have_all_values() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu"]);
    let id = farm.accept(&layered().to_string());
    let frame = format!("/v1/jobs/{id}/frames/0");
    farm.get(&format!("/v1/jobs/{id}/frames/1/layers")).problem(404, "unknown_frame");
    farm.succeeded(&id);
    let layers = farm.get(&format!("{frame}/layers")).json();
    let all = ["color", "depth", "normal", "position", "albedo", "object", "steps"];
    assert_eq!(layers, json!({ "layers": all, "width": 96, "height": 54, "format": "exr" }));
    // The middle of the red ball, the sky above it, and the floor in front.
    let at = |picture: &RgbImage| [(48, 27), (48, 1), (48, 52)].map(|(x, y)| picture.get_pixel(x, y).0);
    for name in all {
        let answer = farm.get(&format!("{frame}/layers/{name}?width=96"));
        assert_eq!(answer.status, 200, "{name}: {}", answer.text());
        assert_eq!(answer.header("cache-control"), "public, max-age=31536000, immutable");
        let picture = decoded(&answer.body);
        assert_eq!(picture.dimensions(), (96, 54), "{name}");
        let [ball, sky, floor] = at(&picture);
        match name {
            "color" => {
                assert!(ball[0].abs_diff(188) <= 1 && ball[1] == 0 && sky[2].abs_diff(225) <= 1, "{ball:?} {sky:?}");
            }
            "depth" => {
                assert!(floor[0] > ball[0] && ball[0] > 31 && sky == [0; 3], "{ball:?} {sky:?} {floor:?}");
                assert!(answer.header("layer-minimum").parse::<f32>().is_ok_and(|near| near > 1.0 && near < 6.0));
            }
            "normal" => assert!(floor == [128, 255, 128] && ball[2] > 200 && sky == [0; 3], "{ball:?} {floor:?}"),
            "position" => assert!(ball != floor && sky == [0; 3], "{ball:?} {floor:?}"),
            "albedo" => assert_eq!((ball, sky), ([188, 0, 0], [0; 3])),
            "object" => assert!(ball != floor && ball != [0; 3] && sky == [0; 3], "{ball:?} {floor:?}"),
            _ => assert!(ball != sky, "{ball:?} {sky:?}"),
        }
        let small = decoded(&farm.get(&format!("{frame}/layers/{name}?width=31")).body);
        assert_eq!(small.dimensions(), (31, if name == "color" { 17 } else { 18 }), "{name}");
        let tag = answer.header("etag").to_owned();
        let path = format!("{frame}/layers/{name}?width=96");
        assert_eq!(farm.send("GET", &path, &[("if-none-match", &tag)], Vec::new()).status, 304);
    }
    let bright = decoded(&farm.get(&format!("{frame}/layers/color?width=96&exposure=1")).body);
    assert_eq!(at(&bright)[0], [255, 0, 0], "0.5 one stop up");
    let dark = decoded(&farm.get(&format!("{frame}/layers/color?width=96&exposure=-20")).body);
    assert!(dark.pixels().all(|&Rgb(pixel)| pixel.iter().all(|&level| level <= 1)));

    let pixel = farm.get(&format!("{frame}/pixel?x=48&y=27")).json();
    let values = pixel["values"].as_object().expect("values");
    assert_eq!(values.len(), 4 + 1 + 3 + 3 + 3 + 1 + 1, "{pixel}");
    assert_eq!((&pixel["x"], &pixel["y"], &pixel["linear"]), (&json!(48), &json!(27), &Value::Null));
    assert_eq!(
        (&values["R"], &values["B"], &values["A"], &values["id"]),
        (&json!(0.5), &json!(0.0), &json!(1.0), &json!(0.0))
    );
    assert!(values["Z"].as_f64().is_some_and(|z| (z - 5.08).abs() < 0.1), "{pixel}");
    let sky = farm.get(&format!("{frame}/pixel?x=48&y=0")).json();
    assert_eq!((&sky["values"]["Z"], &sky["values"]["id"]), (&Value::Null, &json!(-1.0)), "{sky}");
    let outside = farm.get(&format!("{frame}/pixel?x=96&y=0")).problem(422, "wrong_query");
    assert!(outside["detail"].as_str().is_some_and(|detail| detail.contains("96×54")), "{outside}");
}

#[test]
fn light_groups_of_an_exr_are_layers_with_an_exposure() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu"]);
    let rectangle = |x: f32, color: Value, group: Option<&str>| {
        json!({ "rectangle": {
            "position": [x, 3, 2], "direction": [-x, -3, -2], "width": 1, "height": 1, "color": color, "group": group
        } })
    };
    let mut job = layered();
    job["scene"]["integrator"] = json!({ "path": {} });
    job["scene"]["lights"] =
        json!([rectangle(-2.0, json!([20, 0, 0]), Some("warm-1")), rectangle(2.0, json!([0, 0, 20]), None),]);
    for object in job["scene"]["objects"].as_array_mut().expect("a list") {
        object["material"] = json!({ "diffuse": { "kd": [0.5, 0.5, 0.5] } });
    }
    job["image"]["layers"] = json!(["noisy"]);
    job["image"]["samples"] = json!(4);
    job["image"]["denoise"] = json!(true);
    job["image"]["light_groups"] = json!(["warm-1"]);
    let id = farm.accept(&job.to_string());
    let frame = format!("/v1/jobs/{id}/frames/0");
    farm.succeeded(&id);
    let layers = farm.get(&format!("{frame}/layers")).json();
    assert_eq!(layers["layers"], json!(["color", "noisy", "light.rest", "light.warm-1"]));
    let sum = |name: &str, stops: i32| {
        let picture = decoded(&farm.get(&format!("{frame}/layers/{name}?width=96&exposure={stops}")).body);
        assert_eq!(picture.dimensions(), (96, 54), "{name}");
        [0, 2].map(|color| picture.pixels().map(|pixel| u32::from(pixel[color])).sum::<u32>())
    };
    let [red, blue] = sum("light.warm-1", 0);
    assert!(red > 10_000 && blue == 0, "{red} {blue}");
    let [red, blue] = sum("light.rest", 0);
    assert!(blue > 10_000 && blue > red, "the background is of no listed group: {red} {blue}");
    for name in ["color", "noisy", "light.warm-1", "light.rest"] {
        let ([dark, _], [bright, _]) = (sum(name, 0), sum(name, 1));
        assert!(bright > dark, "{name}: {dark} {bright}");
    }
    for unknown in ["light.cold", "light.", "light.a%0Ab", "light.warm-1.R"] {
        let problem = farm.get(&format!("{frame}/layers/{unknown}")).problem(404, "unknown_layer");
        let detail = problem["detail"].as_str().expect("a text");
        assert!(detail.contains("color, noisy, light.rest, light.warm-1"), "{detail}");
    }
}

#[test]
fn a_png_has_colors_and_their_linear_light() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu"]);
    let mut job = layered();
    job["image"] = json!({ "width": 64, "height": 36, "samples": 1 });
    let id = farm.accept(&job.to_string());
    farm.get(&format!("/v1/jobs/{id}/frames/0/layers/color?width=0")).problem(422, "wrong_query");
    farm.succeeded(&id);
    let frame = format!("/v1/jobs/{id}/frames/0");
    let layers = farm.get(&format!("{frame}/layers")).json();
    assert_eq!(layers, json!({ "layers": ["color"], "width": 64, "height": 36, "format": "png" }));
    let unknown = farm.get(&format!("{frame}/layers/depth")).problem(404, "unknown_layer");
    assert!(unknown["detail"].as_str().is_some_and(|detail| detail.contains("it has color")), "{unknown}");
    farm.get(&format!("{frame}/layers/shade")).problem(404, "unknown_layer");
    farm.get(&format!("{frame}/layers/color?exposure=21")).problem(422, "wrong_query");
    let color = farm.get(&format!("{frame}/layers/color"));
    assert_eq!(decoded(&color.body), decoded(&farm.picture(&id)), "a picture that fits is shown as it is");
    let pixel = farm.get(&format!("{frame}/pixel?x=32&y=18")).json();
    let (srgb, linear) =
        (pixel["values"]["R"].as_f64().expect("a value"), pixel["linear"]["R"].as_f64().expect("light"));
    assert!((srgb - 188.0 / 255.0).abs() < 0.005 && (linear - 0.5).abs() < 0.01, "{pixel}");
    assert!(
        pixel["values"]["A"].is_null() && pixel["linear"].as_object().is_some_and(|light| light.len() == 3),
        "{pixel}"
    );
}
