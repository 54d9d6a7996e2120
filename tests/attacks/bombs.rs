//! Jobs that cost as much as the schema allows: by every node, material and light, made from their examples.

use scene::kinds::Example;
use scene::lights::Light;
use scene::materials::Material;
use scene::nodes::Node;
use serde_json::{Value, json};

use super::{Attack, Attacker, ball};
use crate::jobs;

/// Copies of a costly thing in one job.
const COPIES: usize = 200;

pub(super) fn attacks() -> Vec<Attack> {
    vec![
        Attack { name: "one pixel of 65,536 samples and 2,000 glass balls", run: heavy_pixel },
        Attack { name: "every node, many times, at many samples", run: nodes },
        Attack { name: "every node with its whole numbers at their maximum", run: iterations },
        Attack { name: "every material on mirrors within mirrors", run: materials },
        Attack { name: "every light, as many as are allowed", run: lights },
        Attack { name: "thousands of textures in textures", run: textures },
        Attack { name: "texts of 32 MiB", run: large_texts },
        Attack { name: "texts nested as deep as they go", run: deep_texts },
        Attack { name: "moving jobs of many frames", run: moving },
        Attack {
            name: "a track of 9,000 keys in a shape that is used 40,000 times, or in a group",
            run: shared_tracks,
        },
        Attack { name: "few pixels of very many rays", run: long_tiles },
        Attack { name: "small texts that take long, or much memory, to read", run: costly_texts },
    ]
}

/// Submits jobs in turn, and cancels each after a moment, so that every one reaches a worker.
fn submit_each(attacker: &Attacker<'_>, jobs: &[Value]) {
    attacker.flood(2, |number| {
        let job = jobs::seeded(&jobs[number as usize % jobs.len()], number);
        let Some(id) = attacker.submit(&job) else {
            std::thread::sleep(super::PAUSE);
            return;
        };
        std::thread::sleep(super::PAUSE * 4);
        attacker.send("POST", &format!("/v1/jobs/{id}/cancel"), "");
    });
}

/// A large picture of these objects.
fn heavy(objects: Value) -> Value {
    let mut job = ball();
    job["scene"]["objects"] = objects;
    job["image"] = json!({ "width": 640, "height": 360, "samples": 1024 });
    job
}

fn translated(shape: &Value, number: usize) -> Value {
    json!({ "translate": { "by": [number % 10, number / 10 % 10, number / 100], "child": shape } })
}

fn heavy_pixel(attacker: &Attacker<'_>) {
    let glass = json!({ "surface": { "transmission": 1, "ior": 1.5 } });
    let balls: Vec<_> = (0..2000).map(|number| translated(&json!({ "sphere": { "radius": 0.6 } }), number)).collect();
    let mut job = heavy(json!([{ "shape": { "union": { "smooth": 0.1, "of": balls } }, "material": glass }]));
    job["image"] = json!({ "width": 1, "height": 1, "samples": 65_536 });
    submit_each(attacker, &[job]);
}

fn long_tiles(attacker: &Attacker<'_>) {
    let job = jobs::of_long_tiles(32, 65_536);
    let ids: Vec<_> = (0..4).filter_map(|seed| attacker.submit(&jobs::seeded(&job, seed))).collect();
    while attacker.goes_on() {
        std::thread::sleep(super::PAUSE);
    }
    for id in ids {
        attacker.send("POST", &format!("/v1/jobs/{id}/cancel"), "");
    }
}

fn value(json: &str) -> Value {
    serde_json::from_str(json).expect("an example is JSON")
}

fn nodes(attacker: &Attacker<'_>) {
    let jobs: Vec<Value> = Node::examples()
        .iter()
        .map(|example| {
            let copies: Vec<_> = (0..COPIES).map(|number| translated(&value(&example.json), number)).collect();
            heavy(json!([{ "shape": { "union": { "of": copies } }, "material": { "diffuse": {} } }]))
        })
        .collect();
    submit_each(attacker, &jobs);
}

/// Sets every whole number above 1 in a value.
fn raise(value: &mut Value, to: u64) {
    match value {
        Value::Object(members) => members.values_mut().for_each(|value| raise(value, to)),
        Value::Array(entries) => entries.iter_mut().for_each(|value| raise(value, to)),
        Value::Number(number) if number.as_u64().is_some_and(|number| number > 1) => *value = json!(to),
        _ => {}
    }
}

fn iterations(attacker: &Attacker<'_>) {
    // The limits differ by node, so each number is tried: those beyond a limit are refused.
    let jobs: Vec<Value> = Node::examples()
        .iter()
        .flat_map(|example| [8, 12, 16, 32, 64, 256].map(|to| (value(&example.json), to)))
        .map(|(mut node, to)| {
            raise(&mut node, to);
            heavy(json!([{ "shape": node, "material": { "diffuse": {} } }]))
        })
        .filter(|job| scene::parse(job.to_string().as_bytes()).is_ok())
        .collect();
    submit_each(attacker, &jobs);
}

fn each(examples: &[Example], job: impl Fn(Value) -> Value) -> Vec<Value> {
    let jobs = examples.iter().map(|example| job(value(&example.json)));
    jobs.filter(|job| scene::parse(job.to_string().as_bytes()).is_ok()).collect()
}

fn materials(attacker: &Attacker<'_>) {
    let jobs = each(&Material::examples(), |material| {
        let mirror = json!({ "surface": { "metallic": 1, "roughness": 0 } });
        let room = json!({ "onion": { "thickness": 0.1, "child": { "sphere": { "radius": 20 } } } });
        heavy(json!([
            { "shape": { "sphere": { "radius": 1 } }, "material": material },
            { "shape": room, "material": mirror },
        ]))
    });
    assert!(!jobs.is_empty(), "no material's example makes a valid job");
    submit_each(attacker, &jobs);
}

fn lights(attacker: &Attacker<'_>) {
    let jobs = each(&Light::examples(), |light| {
        let mut job = heavy(ball()["scene"]["objects"].clone());
        job["scene"]["lights"] = json!(vec![light; scene::limits::MAX_LIGHTS]);
        job
    });
    assert!(!jobs.is_empty(), "no light's example makes a valid job");
    submit_each(attacker, &jobs);
}

/// Each texture is a part of a scene's program.
fn textures(attacker: &Attacker<'_>) {
    let job = jobs::of_nested_textures(3_000);
    attacker.flood(1, |_| drop(attacker.send("POST", "/v1/shader", job.to_string())));
    submit_each(attacker, &[job]);
}

fn large_texts(attacker: &Attacker<'_>) {
    let mut job = ball();
    job["name"] = json!("x".repeat(31 << 20));
    let named = job.to_string();
    let keys: String = (0..900_000).fold(String::new(), |text, key| text + &format!("\"unknown {key}\": [1, 2, 3], "));
    let unknown = ball().to_string().replacen('{', &format!("{{ {keys}"), 1);
    attacker.flood(4, |number| {
        let text = if number % 2 == 0 { &named } else { &unknown };
        attacker.send("POST", "/v1/jobs", text.clone());
    });
}

fn deep_texts(attacker: &Attacker<'_>) {
    let text = format!("{}{}", "[".repeat(16 << 20), "]".repeat(16 << 20));
    attacker.flood(4, |_| drop(attacker.send("POST", "/v1/jobs", text.clone())));
}

fn moving(attacker: &Attacker<'_>) {
    let mut job = ball();
    job["scene"]["camera"]["position"] = json!([{ "keys": [[0, -3], [4000, 3]] }, 0.5, 4]);
    job["frames"] = json!({ "count": 50_000 });
    submit_each(attacker, &[job]);
}

/// Small texts that become gigabytes if each use of a shape gets its track, or each object that of its group.
fn shared_tracks(attacker: &Attacker<'_>) {
    let keys: Vec<Value> = (0..9_000).map(|key| json!([key, 1])).collect();
    let uses = |name: &str| json!({ "union": { "of": vec![json!({ "use": name }); 200] } });
    let mut used = ball();
    used["scene"]["shapes"] = json!({ "ball": { "sphere": { "radius": { "keys": &keys } } }, "row": uses("ball") });
    used["scene"]["objects"] = json!([{ "shape": uses("row") }]);
    let mut grouped = ball();
    let objects = vec![json!({ "shape": { "sphere": { "radius": 1 } } }); 2_000];
    grouped["scene"]["groups"] = json!([{ "axis": [0, 1, 0], "degrees": { "keys": keys }, "objects": objects }]);
    let texts = [used.to_string(), grouped.to_string()];
    attacker.flood(2, |number| {
        for path in
            ["/v1/jobs", "/v1/jobs?dry_run=true", "/v1/pick?x=0.5&y=0.5", "/v1/preview", "/v1/price", "/v1/shader"]
        {
            let answer = attacker.send("POST", path, &*texts[number as usize % texts.len()]);
            assert!(answer.is_none_or(|answer| [422, 429, 503].contains(&answer.status)), "{path}");
        }
    });
}

/// Small texts with a million formulas of noise, and with a million nodes by doubling: of the accepted ones, many.
fn costly_texts(attacker: &Attacker<'_>) {
    let texts = [jobs::of_noisy_copies(900_000).to_string(), jobs::of_doublings(18).to_string()];
    attacker.flood(4, |number| {
        for path in ["/v1/jobs?dry_run=true", "/v1/jobs", "/v1/pick?x=0.5&y=0.5", "/v1/price"] {
            let answer = attacker.send("POST", path, &*texts[number as usize % texts.len()]);
            assert!(answer.is_none_or(|answer| [200, 201, 422, 429, 503].contains(&answer.status)), "{path}");
        }
    });
}
