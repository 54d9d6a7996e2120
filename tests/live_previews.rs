//! Tests pictures of jobs that are being edited, on a real farm: by their bytes, their time limit, and the processes that
//! draw them.

use std::io::Write;
use std::net::TcpStream;

use image::RgbImage;
use serde_json::{Value, json};

use crate::jobs;
use crate::support::{Answer, Farm, children, eventually, rendered_here};

fn drawn(farm: &Farm, job: &Value, query: &str) -> Answer {
    let json = [("content-type", "application/json")];
    let answer = farm.send("POST", &format!("/v1/preview{query}"), &json, job.to_string().into());
    assert_eq!(answer.status, 200, "{}\n{}", answer.text(), farm.log());
    assert_eq!(answer.header("content-type"), "image/png");
    assert!(answer.header("server-timing").starts_with("helper;dur="));
    answer
}

fn decoded(answer: &Answer) -> RgbImage {
    let format = image::ImageFormat::Png;
    image::load_from_memory_with_format(&answer.body, format).expect("a PNG").into_rgb8()
}

/// A job of this size with one sample, as a client would submit it.
fn sized(job: &Value, width: u32, height: u32, samples: u32) -> Value {
    let mut job = job.clone();
    for (key, value) in [("width", width), ("height", height), ("samples", samples)] {
        job["image"][key] = value.into();
    }
    job
}

#[test]
fn picture_has_the_bytes_of_a_job_of_that_size() {
    let farm = Farm::start(&["--workers", "0"]);
    let csg = sized(&jobs::named("csg"), 1600, 900, 16);
    // In a debug build, the default limit may be too short.
    let answer = drawn(&farm, &csg, "?width=160&limit_ms=5000");
    assert_eq!(answer.header("preview-width"), "160");
    assert_eq!(answer.header("preview-samples"), "1");
    assert!(answer.body == rendered_here(&sized(&csg, 160, 90, 1), 0), "other bytes than a render's");
    let turntable = sized(&jobs::named("turntable"), 640, 640, 4);
    let answer = drawn(&farm, &turntable, "?width=48&frame=7&samples=3&limit_ms=5000");
    assert_eq!((answer.header("preview-width"), answer.header("preview-samples")), ("48", "3"));
    assert!(answer.body == rendered_here(&sized(&turntable, 48, 48, 3), 7), "other bytes than a render's");
    let mut exr = csg;
    exr["image"]["format"] = "exr".into();
    exr["image"]["layers"] = json!(["depth"]);
    let answer = drawn(&farm, &exr, "?width=32&limit_ms=5000");
    exr["image"] = json!({ "width": 32, "height": 18, "samples": 1 });
    assert!(answer.body == rendered_here(&exr, 0), "an EXR is shown as the PNG of the same job");
}

#[test]
fn layers_are_shown_as_pictures() {
    let farm = Farm::start(&["--workers", "0"]);
    let job = json!({
        "scene": {
            "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
            "objects": [
                { "material": { "flat": { "color": [1, 0, 0] } }, "shape": { "sphere": { "radius": 1 } } },
                { "material": { "flat": { "color": [0, 0, 1] } },
                  "shape": { "translate": { "by": [2, 0, 0], "child": { "sphere": { "radius": 0.5 } } } } }
            ]
        },
        "image": { "width": 90, "height": 60 }
    });
    let layer = |name: &str| {
        let answer = drawn(&farm, &job, &format!("?width=90&layer={name}&limit_ms=5000"));
        let picture = decoded(&answer);
        assert_eq!(picture.dimensions(), (90, 60), "{name}");
        assert_eq!(answer.header("preview-width"), "90");
        let range = [answer.header("layer-minimum").to_owned(), answer.header("layer-maximum").to_owned()];
        (picture.get_pixel(45, 30).0, picture.get_pixel(2, 2).0, range)
    };
    let (center, corner, range) = layer("depth");
    assert!(center[0] > 250 && corner == [0; 3], "{center:?} {corner:?}");
    assert!(range[0].starts_with("4.0") && range[1].parse::<f32>().is_ok_and(|far| far > 4.5), "{range:?}");
    let (center, corner, range) = layer("normal");
    assert!(center[2] > 250 && center[0].abs_diff(128) < 8 && corner == [0; 3], "{center:?}");
    assert_eq!(range, ["", ""]);
    let (center, corner, _) = layer("albedo");
    assert_eq!((center, corner), ([255, 0, 0], [0; 3]));
    let (center, corner, _) = layer("object");
    assert!(center != [0; 3] && corner == [0; 3]);
    let (center, corner, range) = layer("steps");
    assert!(center > corner && range[0] == "0", "{center:?} {corner:?} {range:?}");
    let (center, _, range) = layer("position");
    assert!(center[2] > 200, "the nearest point has the largest z: {center:?}");
    assert_eq!(range[0].split(", ").count(), 3, "{range:?}");
}

#[test]
fn what_takes_too_long_is_rendered_smaller_and_scaled_up() {
    let farm = Farm::start(&["--workers", "0"]);
    // Hours at full size.
    let answer = drawn(&farm, &jobs::named("mandelbox"), "?width=1000&samples=60000&limit_ms=100");
    let width: u32 = answer.header("preview-width").parse().expect("a width");
    assert!(width < 1000, "{width}");
    assert_eq!(decoded(&answer).width(), 1000);
    let layer = drawn(&farm, &jobs::named("mandelbox"), "?width=2048&layer=depth&limit_ms=1");
    assert!(layer.header("preview-width").parse::<u32>().is_ok_and(|width| width < 2048));
    assert_eq!(decoded(&layer).width(), 2048);
}

#[test]
fn invalid_jobs_and_queries_are_rejected_as_submissions_are() {
    let farm = Farm::start(&["--workers", "0"]);
    let json = [("content-type", "application/json")];
    let post = |path: &str, body: &str| farm.send("POST", path, &json, body.as_bytes().to_vec());
    let mut job = jobs::quick();
    job["scene"]["objects"][0]["shape"] = json!({ "sphere": { "radius": -1 } });
    let [preview, submitted] = ["/v1/preview", "/v1/jobs"].map(|path| post(path, &job.to_string()));
    let [preview, submitted] = [preview, submitted].map(|answer| answer.problem(422, "wrong_job")["errors"].clone());
    assert_eq!(preview, submitted);
    post("/v1/preview", "{").problem(400, "not_json");
    let job = jobs::quick().to_string();
    for (query, named) in [
        ("width=0", "width is 0"),
        ("width=2049", "2048"),
        ("samples=0", "samples is 0"),
        ("limit_ms=5001", "5000"),
        ("frame=1", "its only frame is 0"),
        ("layer=color2", "layer"),
        ("shade=1", "shade"),
    ] {
        let problem = post(&format!("/v1/preview?{query}"), &job).problem(422, "wrong_query");
        assert!(problem["detail"].as_str().is_some_and(|detail| detail.contains(named)), "{query}: {problem}");
    }
    let plain = farm.send("POST", "/v1/preview", &[("content-type", "text/plain")], job.into_bytes());
    plain.problem(415, "wrong_content_type");
}

#[test]
fn a_client_that_leaves_ends_its_render_and_other_clients_wait_for_nothing() {
    let farm = Farm::start(&["--workers", "0"]);
    let job = jobs::named("mandelbox").to_string();
    // More than may wait: each is sent before the one before has an answer, and takes its place.
    for _ in 0..12 {
        let address = farm.address.strip_prefix("http://").expect("an address");
        let mut connection = TcpStream::connect(address).expect("connects");
        let head = format!(
            "POST /v1/preview?width=2048&samples=60000&limit_ms=5000 HTTP/1.1\r\nhost: {address}\r\n\
             content-type: application/json\r\ncontent-length: {}\r\n\r\n",
            job.len()
        );
        connection.write_all(head.as_bytes()).and_then(|()| connection.write_all(job.as_bytes())).expect("sent");
        eventually("a helper draws", || (!children(farm.process()).is_empty()).then_some(()));
        drop(connection);
        eventually("the helper is gone", || children(farm.process()).is_empty().then_some(()));
    }
    drawn(&farm, &jobs::quick(), "?width=16&limit_ms=5000");
}

#[test]
fn a_job_whose_helper_crashes_costs_only_its_own_picture() {
    let farm = Farm::start(&["--workers", "0"]);
    let job = jobs::named("mandelbox").to_string();
    let picture = std::thread::scope(|scope| {
        let slow = scope.spawn(|| {
            let json = [("content-type", "application/json")];
            let path = "/v1/preview?width=2048&samples=60000&limit_ms=5000";
            farm.send("POST", path, &json, job.clone().into_bytes())
        });
        let helper = eventually("a helper draws", || children(farm.process()).first().copied());
        let other = scope.spawn(|| drawn(&farm, &jobs::quick(), "?width=16&limit_ms=5000"));
        crate::support::send_signal(helper, rustix::process::Signal::KILL);
        slow.join().expect("no panic").problem(503, "no_preview");
        other.join().expect("no panic")
    });
    assert_eq!(drawn(&farm, &jobs::quick(), "?width=16&limit_ms=5000").body, picture.body);
}

/// The JSON response to `POST /v1/pick`.
fn picked(farm: &Farm, job: &Value, query: &str) -> Value {
    let json = [("content-type", "application/json")];
    let answer = farm.send("POST", &format!("/v1/pick{query}"), &json, job.to_string().into());
    assert_eq!(answer.status, 200, "{}\n{}", answer.text(), farm.log());
    answer.json()
}

#[test]
fn picked_objects_have_pointers_into_the_file_as_sent() {
    let farm = Farm::start(&["--workers", "0"]);
    let csg = jobs::named("csg");
    for (at, object, material) in [("x=0.05&y=0.95", 0, "floor"), ("x=0.7&y=0.55", 2, "clay")] {
        let pick = picked(&farm, &csg, &format!("?{at}"));
        let pointer = pick["pointer"].as_str().expect("a pointer");
        assert_eq!((pointer, &pick["object"]), (&*format!("/scene/objects/{object}"), &json!(object)), "{pick}");
        assert!(csg.pointer(pointer).is_some(), "{pick}");
        assert_eq!(pick["material"], material, "{pick}");
        assert_eq!(pick["material_pointer"], format!("/scene/materials/{material}"), "{pick}");
        assert!(pick["distance"].as_f64().is_some_and(|distance| distance > 0.5), "{pick}");
        assert!(pick["position"].as_array().is_some_and(|position| position.len() == 3), "{pick}");
    }
    let sky = picked(&farm, &csg, "?x=0.5&y=0");
    assert!(sky.as_object().is_some_and(|members| members.len() == 8 && members.values().all(Value::is_null)), "{sky}");
    let json = [("content-type", "application/json")];
    for query in ["?x=0.5", "?x=0.5&y=1.5", "?x=nan&y=0", "?x=0&y=0&frame=9"] {
        let answer = farm.send("POST", &format!("/v1/pick{query}"), &json, csg.to_string().into());
        answer.problem(422, "wrong_query");
    }
}

#[test]
fn a_program_for_webgpu_is_sent_once_and_its_numbers_again() {
    let farm = Farm::start(&["--workers", "0"]);
    let ask = |job: &Value, query: &str| {
        let json = [("content-type", "application/json")];
        farm.send("POST", &format!("/v1/shader{query}"), &json, job.to_string().into())
    };
    let mut csg = jobs::named("csg");
    let first = ask(&csg, "?width=320").json();
    assert_eq!(
        (&first["width"], &first["height"], &first["exact"], &first["reason"]),
        (&json!(320), &json!(180), &json!(false), &Value::Null)
    );
    assert!(first["wgsl"].as_str().expect("a program").contains("@compute"), "{first}");
    let program = first["program"].as_str().expect("a hash");
    let query = format!("?width=320&program={program}");
    csg["scene"]["camera"]["position"][0] = json!(1.25);
    let moved = ask(&csg, &query).json();
    assert_eq!((&moved["program"], &moved["wgsl"]), (&first["program"], &Value::Null), "another view is other numbers");
    assert_ne!(moved["uniforms"], first["uniforms"]);
    csg["scene"]["objects"][0]["shape"] = json!({ "torus": { "radius": 0.5, "tube": 0.2 } });
    let other = ask(&csg, &query).json();
    assert_ne!(other["program"], first["program"]);
    assert!(other["wgsl"].is_string(), "another structure is another program: {other}");
    csg["scene"]["objects"][0]["shape"] = json!({ "sphere": { "radius": -1 } });
    let refused = ask(&csg, &query).problem(422, "wrong_job");
    assert_eq!(refused["errors"][0]["pointer"], json!("/scene/objects/0/shape/sphere/radius"), "{refused}");
}
