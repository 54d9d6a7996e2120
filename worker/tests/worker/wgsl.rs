//! WGSL source of pictures, tested without a GPU: naga parses and validates the programs of every scene and every kind.

use naga::valid::{Capabilities, ValidationFlags, Validator};
use rayon::prelude::*;
use scene::nodes::{Example, Node};
use serde_json::{Value, json};
use worker::wgsl::{Shader, ShaderError};

use crate::shipped::{Shipped, few, large, shipped};

/// Scenes of the documents whose tables are too large for a browser.
const REFUSED: [&str; 1] = ["beach"];

fn shader(job: &scene::Job, frame: u32) -> Result<Shader, ShaderError> {
    Shader::new(&job.at(frame).expect("a valid job"))
}

fn assert_valid(name: &str, text: &str) {
    let module =
        naga::front::wgsl::parse_str(text).unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(text)));
    let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
    validator.validate(&module).unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(text)));
    let entries: Vec<&str> = module.entry_points.iter().map(|entry| entry.name.as_str()).collect();
    assert_eq!(entries, ["render"], "{name}");
}

/// Validates a program of each scene.
fn assert_all_valid(scenes: &[Shipped], samples: &[u32]) {
    scenes.par_iter().for_each(|shipped| {
        for &samples in samples {
            match shader(&shipped.png(480, samples), 0) {
                Ok(shader) if !REFUSED.contains(&shipped.name.as_str()) => assert_valid(&shipped.name, &shader.text),
                Ok(_) => panic!("{} is not refused", shipped.name),
                Err(refusal) => assert!(REFUSED.contains(&shipped.name.as_str()), "{}: {refusal}", shipped.name),
            }
        }
    });
}

#[test]
fn naga_validates_the_program_of_every_scene() {
    assert_all_valid(&shipped(), &[4]);
    assert_all_valid(&few(), &[1]);
}

#[test]
#[ignore = "long: the scenes of the documents too, with one sample and several; 40 s"]
fn naga_validates_all_programs_of_every_scene() {
    assert_all_valid(&[shipped(), large()].concat(), &[1, 4]);
}

/// A program with several nodes costs little more than with one: most of it is the integrator.
const NODES_A_PROGRAM: usize = 8;

#[test]
fn naga_validates_programs_with_every_node() {
    let examples = Node::examples();
    assert!(examples.len() > 40);
    examples.par_chunks(NODES_A_PROGRAM).for_each(|examples| {
        let objects: Vec<Value> = examples
            .iter()
            .map(|Example { json: node, .. }| {
                json!({ "shape": serde_json::from_str::<Value>(node).expect("an example is JSON") })
            })
            .collect();
        let scene = json!({ "camera": { "position": [1.5, 1.4, 3.2], "look_at": [0, 0, 0] }, "objects": objects });
        let job = json!({ "scene": scene, "image": { "width": 40, "height": 24, "samples": 1 } }).to_string();
        let names = examples.iter().map(|example| example.kind).collect::<Vec<_>>().join(", ");
        let job = scene::parse(job.as_bytes()).unwrap_or_else(|error| panic!("{names}: {error}"));
        assert_valid(&names, &shader(&job, 0).expect("a recorded tape is valid").text);
    });
}

#[test]
fn program_does_not_depend_on_a_scenes_size() {
    for shipped in shipped() {
        let [small, large] =
            [120, 480].map(|width| shader(&shipped.png(width, 1), 0).expect("a recorded tape is valid"));
        assert!(small.text == large.text, "the size of {} is in its program", shipped.name);
        assert_eq!(small.numbers.len(), large.numbers.len());
    }
}
