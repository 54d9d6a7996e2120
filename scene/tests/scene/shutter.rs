//! Motion blur: instants of a frame, their samples, keys, and the blur itself.

use scene::{Integrator, Job, JobAtFrame};
use serde_json::{Value, json};

const SIZE: u32 = 32;

/// A job of a white square of edge 1 that moves to the right by one unit a second, before black; a pixel is 0.125 wide.
fn job(frames: &Value, samples: u32) -> Job {
    let text = text(&json!({ "keys": [[0, -1.5], [100, 98.5]] }), frames, samples);
    scene::parse(text.as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}\n{text}"))
}

fn text(x: &Value, frames: &Value, samples: u32) -> String {
    json!({
        "scene": {
            "camera": { "position": [0, 0, 6], "look_at": [0, 0, 0], "projection": { "orthographic": { "height": 4 } } },
            "background": { "color": [0, 0, 0] },
            "objects": [{ "material": { "flat": { "color": [1, 1, 1] } },
                "shape": { "translate": { "by": [x, 0, 0], "child": { "box": { "size": [1, 1, 1] } } } } }] },
        "image": { "width": SIZE, "height": SIZE, "samples": samples }, "frames": frames })
    .to_string()
}

fn parsed(x: &Value, frames: &Value, samples: u32) -> Result<Job, String> {
    scene::parse(text(x, frames, samples).as_bytes()).map_err(|refusal| refusal.to_string())
}

/// Brightness of the middle row of a frame.
fn row(job: &Job, frame: u32) -> Vec<f32> {
    let exposure = job.exposure(frame).expect("a valid frame");
    let integrators: Vec<Integrator<'_>> = exposure.instants.iter().map(Integrator::new).collect();
    let pixel = |x: u32| {
        let parts = integrators.iter().zip(exposure.samples().concat());
        let sum = parts.fold(integrators[0].no_light(0.0), |sum, (integrator, samples)| {
            integrator.accumulate(x as f32, (SIZE / 2) as f32, samples.start as f32, samples.end as f32, sum)
        });
        integrators[0].mean(sum).color.x
    };
    (0..SIZE).map(pixel).collect()
}

#[test]
fn a_moving_edge_is_blurred_over_the_distance_that_it_moves() {
    for (frame, shutter) in [(0, 0.5), (1, 1.0), (2, 0.25)] {
        let seen = row(&job(&json!({ "count": 3, "fps": 1, "shutter": shutter }), 256), frame);
        for (column, seen) in seen.into_iter().enumerate() {
            let x = (column as f32 + 0.5) * 0.125 - 2.0;
            // The square covers the point while its center is within 0.5 of it.
            let start = frame as f32 - 1.5;
            let (enters, leaves) = (x - 0.5 - start, x + 0.5 - start);
            let covered = (leaves.clamp(0.0, shutter) - enters.clamp(0.0, shutter)) / shutter;
            // The pixel's own width smooths corners.
            assert!((seen - covered).abs() < 0.04, "frame {frame}, column {column}: {seen}, not {covered}");
        }
    }
}

#[test]
fn instants_are_evenly_spread_and_end_in_the_middle() {
    let exposed = |samples| {
        let job = job(&json!({ "count": 2, "fps": 1, "shutter": 0.5 }), samples);
        let exposure = job.exposure(1).expect("a valid frame");
        // The right edge of the square is at the time since the start of the frame.
        let at = |at_frame: &JobAtFrame<'_>| (at_frame.scene().objects[0].shape.bounds(0.0).max.x * 1e4).round() / 1e4;
        let times: Vec<f32> = exposure.instants.iter().map(at).collect();
        (times, exposure.samples().concat())
    };
    let (times, samples) = exposed(4);
    assert_eq!((times, samples), (vec![0.4375, 0.0625, 0.1875, 0.3125], vec![0..1, 1..2, 2..3, 3..4]));
    assert_eq!(exposed(1).0, [0.25]);
    let (times, samples) = exposed(100);
    assert_eq!(times.len(), 64);
    assert!(samples.windows(2).all(|pair| pair[0].end == pair[1].start) && samples[63].end == 100);
    assert!(samples.iter().all(|samples| (1..=2).contains(&samples.len())));
}

#[test]
fn every_round_of_adaptive_samples_has_samples_of_all_instants() {
    let mut job = job(&json!({ "count": 2, "fps": 1, "shutter": 0.5 }), 4);
    job.image.samples =
        serde_json::from_value(json!({ "adaptive": { "min": 16, "max": 64 } })).expect("a valid number");
    let exposure = job.exposure(1).expect("a valid frame");
    assert_eq!(exposure.instants.len(), 8);
    let rounds = exposure.samples();
    let lengths: Vec<Vec<usize>> =
        rounds.iter().map(|round| round.iter().map(ExactSizeIterator::len).collect()).collect();
    assert_eq!(lengths, [vec![1; 8], vec![1; 8], vec![2; 8], vec![4; 8]]);
    let all = rounds.concat();
    assert!(all.windows(2).all(|pair| pair[0].end == pair[1].start) && all[31].end == 64);
}

#[test]
fn a_shutter_changes_the_keys_of_what_moves_while_it_is_open() {
    let moves = json!({ "keys": [[0, 0], [1, 1]] });
    let key = |x: &Value, shutter: f64, frame| {
        let frames = json!({ "count": 4, "fps": 1, "shutter": shutter });
        parsed(x, &frames, 8).expect("a valid job").cache_key(frame)
    };
    assert_ne!(key(&moves, 0.0, 0), key(&moves, 0.5, 0));
    assert_ne!(key(&moves, 0.25, 0), key(&moves, 0.5, 0));
    assert_eq!(key(&json!(0.5), 0.0, 0), key(&json!(0.5), 0.5, 0), "nothing moves");
    // The same at the start of the frame, and not in it.
    assert_ne!(key(&json!({ "keys": [[0, 0], [1, 2]] }), 0.5, 0), key(&moves, 0.5, 0));
    let later = json!({ "keys": [[0, 0], [1, 1], [2, 7]] });
    assert_eq!(key(&later, 0.5, 0), key(&moves, 0.5, 0), "what moves after the shutter has closed");
}

#[test]
fn errors_while_the_shutter_is_open_name_the_instant() {
    let frames = |shutter: f64| json!({ "count": 1, "fps": 1, "shutter": shutter });
    let x = json!({ "expr": "1 / (t - 0.25)" });
    assert!(parsed(&x, &frames(0.0), 1).is_ok());
    let reported = parsed(&x, &frames(0.5), 1).expect_err("it divides by 0 at 0.25 s");
    assert!(reported.contains("at 0.25 seconds"), "{reported}");
    let reported = parsed(&json!(1), &json!({ "shutter": 2 }), 1).expect_err("it is out of range");
    assert!(
        reported.contains("/frames/shutter") && reported.contains("a fraction of a frame from 0 to 1"),
        "{reported}"
    );
    let reported = parsed(&json!(1), &json!({ "shutter": { "keys": [[0, 0.5]] } }), 1).expect_err("it is constant");
    assert!(reported.contains("/frames/shutter"), "{reported}");
}

#[test]
fn one_blurred_frame_of_an_animation_gets_no_warning() {
    let warnings = |shutter: f64| scene::warnings(&job(&json!({ "count": 1, "shutter": shutter }), 16));
    assert!(warnings(0.0).iter().any(|text| text.contains("frames.count")));
    assert!(!warnings(0.5).iter().any(|text| text.contains("frames.count")));
}
