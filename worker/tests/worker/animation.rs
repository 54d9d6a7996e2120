//! Animated jobs: one kernel source for all frames, and each frame equals the picture of a job with those
//! constants.

use proto::Rect;
use scene::backgrounds::Background;
use scene::camera::{Lens, Projection};
use scene::lights::Light;
use scene::nodes::{Example, Node};
use scene::{Job, effects};
use serde_json::{Value, json};
use worker::cuda::KernelSource;
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TileRequest};

fn job(scene: &Value, frames: u32) -> Job {
    let text = json!({ "scene": scene,
        "image": { "width": 24, "height": 16, "samples": 2, "format": "exr", "layers": ["motion"] },
        "frames": { "count": frames, "fps": 1 } });
    scene::parse(text.to_string().as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}: {text}"))
}

/// A scene of one shape over a floor.
fn scene_of(shape: &Value) -> Value {
    json!({ "camera": { "position": [1.5, 1.4, 3.2], "look_at": [0, 0, 0] },
        "objects": [{ "shape": shape, "material": { "diffuse": { "ks": [0.4, 0.4, 0.4] } } },
                    { "shape": { "plane": { "normal": [0, 1, 0], "offset": -1.5 } } }] })
}

/// Gives every number a track from its value to a slightly different one, from second 0 to 2.
fn set_moving(value: &mut Value) {
    match value {
        Value::Number(number) => {
            let from = number.as_f64().expect("a number of a scene is one of f64");
            *value = json!({ "keys": [[0, from], [2, from * 0.984_375]] });
        }
        Value::Array(items) => items.iter_mut().for_each(set_moving),
        Value::Object(entries) => entries.values_mut().for_each(set_moving),
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

/// The scene with all numbers animated except counts, which cannot be, and those for which this track is
/// invalid.
fn moving(scene: &Value) -> Value {
    let mut moving = scene.clone();
    set_moving(&mut moving);
    loop {
        let text = json!({ "scene": moving, "image": { "width": 8, "height": 8 }, "frames": { "count": 3, "fps": 1 } });
        let Err(scene::ParseError::Invalid(faults)) = scene::parse(text.to_string().as_bytes()) else { return moving };
        for fault in faults {
            let place = fault.pointer.strip_prefix("/scene").unwrap_or_else(|| panic!("{fault}"));
            let place = place.split("/keys/").next().expect("a split has a first part");
            let (track, own) = (moving.pointer_mut(place), scene.pointer(place));
            let (Some(track), Some(own)) = (track, own) else { panic!("{fault}") };
            assert_ne!(track, own, "{fault}");
            *track = own.clone();
        }
    }
}

#[test]
fn all_frames_of_a_job_share_one_kernel_source() {
    for Example { kind, index: number, json: node, .. } in Node::examples() {
        let shape: Value = serde_json::from_str(&node).unwrap();
        let job = job(&moving(&scene_of(&shape)), 3);
        assert!(job.is_animated(), "{kind} {number} has numbers");
        let [first, second, third] = [0, 1, 2].map(|frame| KernelSource::new(&job.at(frame).unwrap()).unwrap());
        assert!(
            first.text == second.text && first.text == third.text,
            "{kind} {number}: frames differ in their source"
        );
        assert_ne!(first.parameters, second.parameters, "{kind} {number} moves");
    }
}

/// A scene for each example of each family that is not part of an object.
fn scenes_around_objects() -> Vec<(String, Value)> {
    let ball = json!({ "sphere": { "radius": 1 } });
    let with = |examples: Vec<Example>, keys: fn(Value) -> Value| {
        let ball = &ball;
        let scenes = examples.into_iter().map(move |example| {
            let mut scene = scene_of(ball);
            let keys = keys(serde_json::from_str(&example.json).unwrap());
            for (key, value) in keys.as_object().unwrap() {
                scene[key] = value.clone();
            }
            (format!("{} {}", example.kind, example.index), scene)
        });
        scenes.collect::<Vec<_>>()
    };
    let lights = with(
        Light::examples(),
        |light| json!({ "lights": [light], "background": { "day": { "sun": [0.6, 0.5, 0.4] } } }),
    );
    let backgrounds = with(Background::examples(), |background| json!({ "background": background }));
    let projections = with(
        Projection::examples(),
        |projection| json!({ "camera": { "position": [1.5, 1.4, 3.2], "look_at": [0, 0, 0], "projection": projection } }),
    );
    let lenses = with(
        Lens::examples(),
        |lens| json!({ "camera": { "position": [1.5, 1.4, 3.2], "look_at": [0, 0, 0], "lens": lens } }),
    );
    [lights, backgrounds, projections, lenses, with(effects::examples(), |keys| keys)].concat()
}

#[test]
fn frames_share_one_source_for_any_animated_part() {
    for (name, scene) in scenes_around_objects() {
        let job = job(&moving(&scene), 3);
        let [first, second, third] = [0, 1, 2].map(|frame| KernelSource::new(&job.at(frame).unwrap()).unwrap());
        assert!(first.text == second.text && first.text == third.text, "{name}: frames differ in their source");
        assert_ne!(first.parameters, second.parameters, "{name} moves");
    }
}

#[test]
fn numbers_that_pass_a_special_value_share_one_source() {
    let through = |low: f64, middle: f64, high: f64| json!({ "keys": [[0, low], [1, middle], [2, high]] });
    let many = |shape: Value| Value::Array(vec![shape; 12]);
    let tilted = json!({ "rotate": { "degrees": [0, 0, through(-20.0, 0.0, 20.0)],
        "child": { "cylinder": { "radius": 0.2, "height": 1 } } } });
    let slab = |sign: f64| json!({ "plane": { "normal": [through(-0.5, 0.0, 0.5), sign, 0], "offset": 0.5 } });
    for shape in [
        json!({ "union": { "smooth": through(0.2, 0.0, 0.1), "of": many(tilted.clone()) } }),
        json!({ "intersection": { "smooth": through(0.2, 0.0, 0.1), "of": many(tilted.clone()) } }),
        json!({ "difference": { "smooth": through(0.0, 0.1, 0.0), "of": many(tilted) } }),
        json!({ "intersection": { "of": [slab(1.0), slab(-1.0), { "infinite_cylinder": { "radius": 1 } },
            { "union": { "of": many(slab(1.0)) } }] } }),
        json!({ "mandelbulb": { "power": through(7.5, 8.0, 2.5), "iterations": 4 } }),
        json!({ "scale": { "by": through(0.5, 1.0, 2.0), "child": { "box": { "size": [1, 1, 1], "round": through(0.1, 0.0, 0.1) } } } }),
    ] {
        let mut scene = scene_of(&shape);
        scene["objects"][0]["material"]["diffuse"]["ks"] = json!([through(0.5, 0.0, 0.5), 0, 0]);
        let job = job(&scene, 3);
        let [first, second, third] = [0, 1, 2].map(|frame| KernelSource::new(&job.at(frame).unwrap()).unwrap());
        assert!(first.text == second.text && first.text == third.text, "{shape}: frames differ in their source");
    }
}

#[test]
fn a_frame_equals_the_picture_of_a_constant_scene() {
    let through = |low: f64, middle: f64| json!({ "keys": [[0, low], [1, middle], [2, 3]] });
    let scene = |offset: Value, smooth: Value, red: Value| {
        let mut scene = scene_of(&json!({ "union": { "smooth": smooth, "of": [
            { "sphere": { "radius": 0.7 } },
            { "translate": { "by": [offset, 0.3, 0], "child": { "box": { "size": [0.9, 0.9, 0.9] } } } } ] } }));
        scene["objects"][0]["material"]["diffuse"]["kd"] = json!([red, 0.5, 0.5]);
        scene
    };
    let moving = job(&scene(through(-1.0, 0.75), through(0.5, 0.0), through(0.0, 0.25)), 3);
    let constant = job(&scene(json!(0.75), json!(0), json!(0.25)), 3);
    let renderer = CpuRenderer::new(Some(1), Simd::Auto).unwrap();
    let render = |job: &Job, frame| {
        let run = TileRequest { job, frame, rect: Rect::full(job.image.width, job.image.height) };
        let pixels = renderer.render(&run, &CancelFlag::new(), &|_| ()).unwrap();
        // The motion differs.
        pixels.planes[..4].iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>()
    };
    assert_eq!(render(&moving, 1), render(&constant, 1));
    assert_ne!(render(&moving, 0), render(&constant, 0));
}
