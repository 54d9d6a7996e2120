//! Jobs that move: a job as it stands in one of its frames.
//!
//! A job that moves keeps its text, and is read again for each frame; nothing else knows of tracks.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::sync::Arc;

use crate::fault::Refusal;
use crate::job::{Frames, Image, Job};
use crate::limits::{MAX_CHECKED_BYTES, MIN_CHECKED_FRAMES};
use crate::parse;

/// What a job that moves is read from.
#[derive(Clone, PartialEq, Eq)]
pub struct Motion(Arc<str>);

impl std::fmt::Debug for Motion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Motion({} bytes)", self.0.len())
    }
}

impl Motion {
    pub(crate) fn of(text: &str) -> Self {
        Self(text.into())
    }

    pub(crate) fn text(&self) -> &str {
        &self.0
    }
}

/// A job as it stands in one of its frames: what a picture is made of.
#[derive(Clone, Debug)]
pub struct Still<'a> {
    job: Cow<'a, Job>,
    frame: u32,
}

impl Still<'_> {
    /// The job, with every number as it is in this frame.
    pub fn job(&self) -> &Job {
        &self.job
    }

    /// Which frame it is, from 0.
    pub fn frame(&self) -> u32 {
        self.frame
    }
}

impl Job {
    /// Whether its frames differ in more than their sampling noise.
    pub fn is_moving(&self) -> bool {
        self.motion.is_some()
    }

    /// The job as it stands in a frame. Size, samples and format are those of this value, the scene
    /// of a job that moves is that of its text.
    ///
    /// It is refused where the frame alone has a fault, and the job too many frames for each to be
    /// looked over by [`crate::parse`].
    pub fn at(&self, frame: u32) -> Result<Still<'_>, Refusal> {
        let Some(Motion(text)) = &self.motion else {
            return Ok(Still { job: Cow::Borrowed(self), frame });
        };
        let Self { scene, image, .. } = parse::at(text, frame, &self.frames)?;
        let job = Self {
            name: self.name.clone(),
            scene,
            image: Image { exposure: image.exposure, ..self.image.clone() },
            frames: self.frames.clone(),
            priority: self.priority,
            motion: self.motion.clone(),
        };
        Ok(Still { job: Cow::Owned(job), frame })
    }
}

/// The frames behind the first that are looked over when a job of so many bytes is handed in: all
/// of them if that is cheap, else those around keys and others between them.
pub(crate) fn frames_to_check(frames: &Frames, key_seconds: &[f64], bytes: usize) -> BTreeSet<u32> {
    let count = frames.count;
    let most = (MAX_CHECKED_BYTES / (bytes as u64).max(1)).max(MIN_CHECKED_FRAMES.into());
    if u64::from(count) <= most {
        return (1..count).collect();
    }
    let most = most as usize;
    let near_key = |seconds: &f64| {
        let frame = seconds * f64::from(frames.fps.get());
        [frame.floor(), frame.ceil()]
    };
    let last = f64::from(count - 1);
    let near_keys = key_seconds.iter().flat_map(near_key).filter(|frame| (1.0..=last).contains(frame));
    let near_keys: BTreeSet<u32> = near_keys.map(|frame| frame as u32).collect();
    let every = near_keys.len().div_ceil(most / 2).max(1);
    let mut chosen: BTreeSet<u32> = near_keys.into_iter().step_by(every).collect();
    let others = (most - chosen.len()) as u64;
    chosen.extend((1..=others).map(|other| (u64::from(count - 1) * other / others) as u32));
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::values::FrameRate;

    /// A job whose sphere has the radius `radius`, with `more` behind its image.
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
    fn a_frame_shows_numbers_as_they_are_then() {
        let job = job(GROWS, r#", "frames": { "count": 9, "fps": 4 }"#);
        assert!(job.is_moving());
        let reach = |frame| {
            let still = job.at(frame).unwrap();
            let seen: f32 = still.job().scene.objects[0].shape.bounds(0.0).high.x;
            seen
        };
        assert_eq!([0, 1, 2, 4, 8].map(reach), [1.0, 1.5, 2.0, 3.0, 3.0]);
    }

    #[test]
    fn a_frame_keeps_the_size_that_was_asked_for_last() {
        let mut job = job(GROWS, r#", "frames": { "count": 2 }"#);
        job.image.width = 5;
        assert_eq!(job.at(1).unwrap().job().image.width, 5);
    }

    #[test]
    fn what_does_not_move_is_not_read_again() {
        let job = job("1", r#", "frames": { "count": 2 }"#);
        assert!(!job.is_moving());
        assert!(std::ptr::eq(job.at(1).unwrap().job(), &raw const job));
    }

    #[test]
    fn keys_are_those_of_the_scene_as_it_stands() {
        let frames = r#", "frames": { "count": 3, "fps": 1 }"#;
        let (slow, fast) = (job(GROWS, frames), job(r#"{ "keys": [[0, 1], [1, 3], [2, 9]] }"#, frames));
        assert_eq!([0, 1].map(|n| slow.picture_key(n)), [0, 1].map(|n| fast.picture_key(n)));
        assert_ne!(slow.picture_key(2), fast.picture_key(2));
        assert_ne!(slow.picture_key(1), slow.picture_key(2));
    }

    #[test]
    fn only_a_job_in_which_nothing_moves_is_warned_of_that() {
        let frames = r#", "frames": { "count": 2 }"#;
        assert!(job("1", frames).warnings()[0].contains("nothing in the scene moves"));
        assert_eq!(job(GROWS, frames).warnings(), Vec::<String>::new());
        assert!(job(GROWS, "").warnings()[0].contains("frames.count"));
    }

    #[test]
    fn a_fault_of_a_later_frame_names_the_frame() {
        let camera = r#"{ "keys": [[0, 3], [2, -1]] }"#;
        let wrong =
            text("1", r#", "frames": { "count": 5, "fps": 2 }"#).replace("0, 0, 3]", &format!("0, 0, {camera}]"));
        let Err(Refusal::Wrong(faults)) = parse(wrong.as_bytes()) else { panic!("{wrong} is right") };
        assert_eq!(faults[0].pointer, "/scene/camera/look_at");
        assert!(faults[0].message.contains("frame 3"), "{}", faults[0].message);
    }

    #[test]
    fn many_frames_are_looked_over_around_keys_and_evenly() {
        let frames = Frames { count: 100_000, fps: FrameRate::new(10.0).unwrap() };
        let chosen = frames_to_check(&frames, &[-4.0, 777.77, 1e6], 1 << 20);
        assert!(chosen.len() <= 64 && chosen.len() > 48, "{chosen:?}");
        assert!([7_777, 7_778, 99_999].iter().all(|frame| chosen.contains(frame)), "{chosen:?}");
        assert!(!chosen.contains(&0));
        let all = frames_to_check(&Frames { count: 50, ..frames }, &[], 1 << 20);
        assert!(all.into_iter().eq(1..50));
    }
}
