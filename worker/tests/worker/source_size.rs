//! The counted nodes and textures of a scene bound the source of its kernel, and so the time and memory of a compiler.

use scene::Job;
use serde_json::{Value, json};
use worker::cuda::{KernelSource, MAX_NODES};
use worker::wgsl::{Shader, ShaderError};

use crate::shipped::shipped;

/// Source that each counted node may add, in bytes.
const BYTES_OF_A_NODE: usize = 8 << 10;
/// Source of a scene of one node.
const BASE_BYTES: usize = 384 << 10;

fn job(integrator: &Value, shape: &Value, material: &Value, lights: usize) -> Job {
    let light = |number| json!({ "point": { "position": [number, 5, 5] } });
    let text = json!({
        "scene": {
            "camera": { "position": [0, 2, 9], "look_at": [0, 0, 0] },
            "integrator": integrator,
            "lights": (0..lights).map(light).collect::<Vec<_>>(),
            "objects": [{ "shape": shape, "material": material }],
        },
        "image": { "width": 64, "height": 64, "samples": 1 },
    });
    scene::parse(text.to_string().as_bytes()).unwrap_or_else(|error| panic!("{error}"))
}

fn diffuse(color: &Value) -> Value {
    json!({ "diffuse": { "kd": color } })
}

/// A ramp of 32 colors, the first of them textures.
fn ramp(textures: usize, texture: impl Fn(usize) -> Value) -> Value {
    let color = |stop: usize| if stop < textures { texture(stop) } else { json!([0.5, 0.25, 0.125]) };
    let stops: Vec<Value> = (0..32).map(|stop| json!([stop as f64 / 31.0, color(stop)])).collect();
    json!({ "marble": { "ramp": stops } })
}

/// A union that is one leaf, because it is twisted.
fn twisted(count: usize, child: impl Fn(usize) -> Value) -> Value {
    let children: Vec<Value> =
        (0..count).map(|place| json!({ "translate": { "by": [place, 0, 0], "child": child(place) } })).collect();
    json!({ "twist": { "degrees_per_unit": 5, "child": { "union": { "of": children } } } })
}

/// Scenes with many of something.
fn scenes(integrator: &Value) -> Vec<(&'static str, Job)> {
    let ball = json!({ "sphere": { "radius": 1 } });
    let gray = diffuse(&json!([0.5, 0.5, 0.5]));
    let checker = |stop: usize| json!({ "checker": { "cell": 0.1 * stop as f64 + 0.1 } });
    let marble = |stop: usize| json!({ "marble": { "width": 0.1 * stop as f64 + 0.1 } });
    let rough = |place: usize| {
        let noise = json!({ "noise": { "perlin": { "octaves": 8, "scale": 0.1 * place as f64 + 0.3 } } });
        json!({ "displace": { "by": noise, "amplitude": 0.1, "child": ball } })
    };
    // A saw with a point below its teeth.
    let teeth = (0..249).map(|place| json!([f64::from(place) / 100.0, f64::from(1 + place % 2)]));
    let points: Vec<Value> = teeth.chain([json!([1.2, -1])]).collect();
    let polygon = json!({ "extrude": { "height": 1, "profile": { "polygon": { "points": points } } } });
    let textured = |color: &Value| job(integrator, &ball, &diffuse(color), 1);
    let shaped = |shape: &Value| job(integrator, shape, &gray, 1);
    vec![
        ("a ball", shaped(&ball)),
        ("colors", textured(&ramp(0, checker))),
        ("checkers", textured(&ramp(32, checker))),
        ("marbles", textured(&ramp(32, marble))),
        ("ramps of checkers", textured(&ramp(8, |_| ramp(32, checker)))),
        ("balls", shaped(&twisted(200, |_| ball.clone()))),
        ("noise", shaped(&twisted(60, rough))),
        ("fractals", shaped(&twisted(60, |_| json!({ "mandelbulb": { "power": 8, "iterations": 12 } })))),
        ("points", shaped(&polygon)),
        ("lights", job(integrator, &ball, &gray, 64)),
    ]
}

#[test]
fn counted_nodes_and_textures_bound_the_source() {
    let mut wrong = Vec::new();
    for integrator in [json!("direct"), json!({ "path": {} })] {
        for (name, job) in scenes(&integrator) {
            let at_frame = job.at(0).expect("it is not animated");
            let nodes = scene::frame_compiled_nodes(&at_frame) as usize;
            let bytes = KernelSource::new(&at_frame).expect("a recorded tape is valid").text.len();
            let row = format!("{integrator}, {name}: {bytes} bytes of {nodes} nodes");
            println!("{row}");
            if bytes > BASE_BYTES + nodes * BYTES_OF_A_NODE {
                wrong.push(row);
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    let largest = BASE_BYTES + MAX_NODES as usize * BYTES_OF_A_NODE;
    assert!(largest < 8 << 20, "a GPU's worker compiles at most 8 MiB: {largest}");
}

#[test]
fn a_gpu_renders_every_shipped_scene() {
    for scene in shipped() {
        let nodes = scene::compiled_nodes(&scene.job());
        assert!(nodes <= MAX_NODES, "{}: {nodes} nodes", scene.name);
    }
}

#[test]
fn thousands_of_textures_have_no_program_and_no_kernel() {
    let textures = ramp(32, |_| ramp(32, |_| ramp(3, |stop| json!({ "checker": { "cell": stop + 1 } }))));
    let job = job(&json!("direct"), &json!({ "sphere": { "radius": 1 } }), &diffuse(&textures), 1);
    assert_eq!(scene::compiled_nodes(&job), 1 + 8 * (1 + 32 + 32 * 32 + 32 * 32 * 3));
    let shader = Shader::new(&job.at(0).expect("it is not animated"));
    assert!(matches!(shader, Err(ShaderError::LongText(_))), "{:?}", shader.map(|shader| shader.text.len()));
}
