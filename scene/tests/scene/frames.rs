//! Frames: a job evaluated at a time, its errors, and which frames are checked.

use picture::animation::frames_to_check;
use scene::values::FrameRate;
use scene::{Frames, Job, ParseError, parse};

/// Job whose sphere has the radius `radius`, with `more` after its image.
fn text(radius: &str, more: &str) -> String {
    format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 3], "look_at": [0, 0, 0] }},
            "objects": [{{ "shape": {{ "sphere": {{ "radius": {radius} }} }} }}] }},
            "image": {{ "width": 8, "height": 8 }}{more} }}"#
    )
}

const GROWS: &str = r#"{ "keys": [[0, 1], [1, 3]] }"#;

fn job(radius: &str, more: &str) -> Job {
    parse(text(radius, more).as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}"))
}

#[test]
fn a_frame_has_numbers_at_its_time() {
    let job = job(GROWS, r#", "frames": { "count": 9, "fps": 4 }"#);
    assert!(job.is_animated());
    let reach = |frame| {
        let at_frame = job.at(frame).unwrap();
        let seen: f32 = at_frame.scene().objects[0].shape.bounds(0.0).max.x;
        seen
    };
    assert_eq!([0, 1, 2, 4, 8].map(reach), [1.0, 1.5, 2.0, 3.0, 3.0]);
}

#[test]
fn a_frame_has_the_size_set_last() {
    let mut job = job(GROWS, r#", "frames": { "count": 2 }"#);
    job.image.width = 5;
    assert_eq!(job.at(1).unwrap().image().width, 5);
}

#[test]
fn constant_jobs_are_not_copied() {
    let job = job("1", r#", "frames": { "count": 2 }"#);
    assert!(!job.is_animated());
    assert!(std::ptr::eq(job.at(1).unwrap().scene(), &raw const job.scene));
}

#[test]
fn cache_keys_are_those_of_the_evaluated_scene() {
    let frames = r#", "frames": { "count": 3, "fps": 1 }"#;
    let (slow, fast) = (job(GROWS, frames), job(r#"{ "keys": [[0, 1], [1, 3], [2, 9]] }"#, frames));
    assert_eq!([0, 1].map(|n| slow.cache_key(n)), [0, 1].map(|n| fast.cache_key(n)));
    assert_ne!(slow.cache_key(2), fast.cache_key(2));
    assert_ne!(slow.cache_key(1), slow.cache_key(2));
}

#[test]
fn only_a_job_without_animation_gets_that_warning() {
    let frames = r#", "frames": { "count": 2 }"#;
    assert!(scene::warnings(&job("1", frames))[0].contains("nothing in the scene is animated"));
    assert_eq!(scene::warnings(&job(GROWS, frames)), Vec::<String>::new());
    assert!(scene::warnings(&job(GROWS, ""))[0].contains("frames.count"));
}

#[test]
fn an_error_in_a_later_frame_names_the_frame() {
    let camera = r#"{ "keys": [[0, 3], [2, -1]] }"#;
    let wrong = text("1", r#", "frames": { "count": 5, "fps": 2 }"#).replace("0, 0, 3]", &format!("0, 0, {camera}]"));
    let Err(ParseError::Invalid(faults)) = parse(wrong.as_bytes()) else { panic!("{wrong} is right") };
    assert_eq!(faults[0].pointer, "/scene/camera/look_at");
    assert!(faults[0].message.contains("frame 3"), "{}", faults[0].message);
}

#[test]
fn many_frames_are_checked_around_keyframes_and_evenly() {
    let frames = Frames { count: 100_000, fps: FrameRate::new(10.0).unwrap(), ..Frames::default() };
    let chosen = frames_to_check(&frames, &[-4.0, 777.77, 1e6], 1 << 24);
    assert!(chosen.len() <= 64 && chosen.len() > 48, "{chosen:?}");
    assert!([7_777, 7_778, 99_999].iter().all(|frame| chosen.contains(frame)), "{chosen:?}");
    assert!(!chosen.contains(&0));
    let all = frames_to_check(&Frames { count: 50, ..frames }, &[], 1 << 24);
    assert!(all.into_iter().eq(1..50));
}
