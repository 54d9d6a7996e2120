//! Jobs as large as they may be: what reading them takes.

use std::fmt::Write;
use std::fs;
use std::process::Command;
use std::time::Duration;

use scene::limits::{MAX_BODY_BYTES, MAX_NODES};

/// Limit of the memory of reading a text, in sizes of the text.
const MAX_MEMORY: f64 = 10.0;
/// Limit of the time of reading a job of 30 MB, in a release build on an idle machine.
const MAX_TIME: Duration = Duration::from_secs(1);
/// Limit of the time until such a text is refused.
const MAX_REFUSAL_TIME: Duration = Duration::from_secs(2);
/// Variable that chooses one text, for a process of its own.
const CASE: &str = "SDFARM_LARGE_TEXT";

/// A job with one object of this shape.
fn job(shape: &str) -> String {
    format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 30], "look_at": [0, 0, 0] }}, "objects": [{{ "shape": {shape} }}] }},
            "image": {{ "width": 64, "height": 64 }} }}"#
    )
}

/// A list of `count` texts, each made from numbers from 0 to 1 that differ.
fn list(count: usize, text: impl Fn(&[f64; 6]) -> String) -> String {
    let mut all = String::from("[");
    for index in 0..count {
        let number = |way: usize| (((index * 7919 + way * 104_729) % 99_991) as f64 / 99_991.0 * 1e4).round() / 1e4;
        write!(all, "{}{}", if index == 0 { "" } else { ",\n" }, text(&[0, 1, 2, 3, 4, 5].map(number)))
            .expect("memory");
    }
    all + "]"
}

fn union(of: &str) -> String {
    format!(r#"{{ "union": {{ "of": {of} }} }}"#)
}

/// Peak of this process's resident memory since `reset_peak`.
fn peak_bytes() -> u64 {
    let status = fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("Linux reports it");
    line.trim().trim_end_matches(" kB").parse::<u64>().expect("a number") << 10
}

fn reset_peak() -> u64 {
    fs::write("/proc/self/clear_refs", "5").expect("a process may reset its own peak");
    peak_bytes()
}

/// Time for which this thread ran so far.
fn time_ran() -> Duration {
    let times = fs::read_to_string("/proc/thread-self/schedstat").expect("Linux");
    Duration::from_nanos(times.split(' ').next().and_then(|run| run.parse().ok()).expect("a number"))
}

fn box_at([x, y, z, a, b, c]: &[f64; 6]) -> String {
    let rotated = format!(r#"{{"rotate":{{"degrees":[{a},{b},{c}],"child":{{"box":{{"size":[0.1,0.2,0.3]}}}}}}}}"#);
    format!(r#"{{"translate":{{"by":[{x},{y},{z}],"child":{rotated}}}}}"#)
}

fn capsule([x, y, z, a, b, c]: &[f64; 6]) -> String {
    format!(r#"{{"capsule":{{"a":[{x},{y},{z}],"b":[{a},{b},{c}],"radius":0.05}}}}"#)
}

fn placement([x, y, z, a, b, c]: &[f64; 6]) -> String {
    format!(r#"{{"by":[{x},{y},{z}],"degrees":[{a},{b},{c}],"scale":1.5}}"#)
}

fn point([x, y, z, ..]: &[f64; 6]) -> String {
    format!("[{x},{y},{z}]")
}

fn copies(at: &str) -> String {
    job(&format!(r#"{{ "copies": {{ "child": {{ "sphere": {{ "radius": 0.05 }} }}, "at": {at} }} }}"#))
}

fn objects(of: &str) -> String {
    job("[]").replacen(r#"[{ "shape": [] }]"#, of, 1)
}

fn boxes() -> String {
    job(&union(&list(230_000, box_at)))
}

/// A large text by its name.
type NamedText = (&'static str, fn() -> String);

/// Large texts: jobs, and what is refused.
const TEXTS: [NamedText; 10] = [
    ("columns of placements", || copies(&format!(r#"{{ "by": {} }}"#, list(MAX_NODES - 1, point)))),
    ("placements of a sphere", || copies(&list(430_000, placement))),
    ("capsules", || job(&union(&list(330_000, capsule)))),
    ("spheres", || job(&union(&list(MAX_NODES - 1, |_| r#"{"sphere":{"radius":1}}"#.to_owned())))),
    ("boxes, rotated and translated", boxes),
    ("objects of one material", || {
        let objects = objects(&list(600_000, |_| r#"{"material":"clay","shape":{"sphere":{"radius":1}}}"#.to_owned()));
        objects.replacen(r#""objects""#, r#""materials": { "clay": { "diffuse": {} } }, "objects""#, 1)
    }),
    ("refused: objects of a material each", || {
        objects(&list(950_000, |_| r#"{"shape":{"sphere":{"radius":1}}}"#.to_owned()))
    }),
    ("refused: boxes, and an unknown key", || boxes().replacen(r#""image""#, r#""imagf""#, 1)),
    ("refused: a list of numbers", || format!("[{}0]", "0,".repeat((16 << 20) - 2))),
    ("refused: an object of many keys", || {
        format!("{{{}\"\":1}}", (0..2_700_000).fold(String::new(), |text, key| text + &format!("\"{key}\":1,")))
    }),
];

#[test]
#[ignore = "long: jobs of 30 MB in a release build, each in a process of its own; 30 s"]
fn a_job_of_thirty_megabytes_is_read_in_bounded_time_and_memory() {
    if let Ok(index) = std::env::var(CASE) {
        return read_one(index.parse().expect("a number"));
    }
    let program = std::env::current_exe().expect("this test");
    let unmet: Vec<&str> = TEXTS
        .iter()
        .enumerate()
        .filter(|(index, _)| {
            let this = [
                "large::a_job_of_thirty_megabytes_is_read_in_bounded_time_and_memory",
                "--exact",
                "--ignored",
                "--nocapture",
            ];
            !Command::new(&program).args(this).env(CASE, index.to_string()).status().expect("it starts").success()
        })
        .map(|(_, (name, _))| *name)
        .collect();
    assert!(unmet.is_empty(), "above the limits: {unmet:?}");
}

fn read_one(index: usize) {
    let (name, text) = (TEXTS[index].0, TEXTS[index].1());
    assert!(text.len() <= MAX_BODY_BYTES, "{name}: {} bytes", text.len());
    let before_bytes = reset_peak();
    let begun = time_ran();
    let read = scene::parse(text.as_bytes());
    let time = time_ran().saturating_sub(begun);
    let memory = (peak_bytes() - before_bytes) as f64 / text.len() as f64;
    assert_eq!(read.is_err(), name.starts_with("refused"), "{name}: {:?}", read.err());
    let begun = time_ran();
    let reported =
        read.map_or_else(|_| String::new(), |job| format!("{} nodes, key {}", job.nodes(), job.cache_key(0)));
    let (megabytes, seconds, key_seconds) =
        (text.len() as f64 / 1e6, time.as_secs_f64(), time_ran().saturating_sub(begun).as_secs_f64());
    eprintln!("{name}: {megabytes:.1} MB in {seconds:.2} s, {memory:.1} times its size; {reported} {key_seconds:.2} s");
    let limit = if name.starts_with("refused") { MAX_REFUSAL_TIME } else { MAX_TIME };
    let is_in_time = time <= limit || std::env::var_os("SDFARM_CHECK_TIMES").is_none();
    assert!(is_in_time && memory <= MAX_MEMORY, "{name}: {seconds} s, {memory} times its size");
}

#[test]
fn nodes_are_counted_in_every_tree_at_every_depth() {
    let text = br#"{
        "scene": {
            "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
            "objects": [
                { "shape": { "sphere": { "radius": 1 } } },
                { "shape": { "union": { "of": [
                    { "sphere": { "radius": 1 } },
                    { "translate": { "by": [1, 0, 0], "child": { "sphere": { "radius": 1 } } } }
                ] } } }
            ]
        },
        "image": { "width": 8, "height": 8 }
    }"#;
    assert_eq!(scene::parse(text).expect("a valid job").nodes(), 5);
}
