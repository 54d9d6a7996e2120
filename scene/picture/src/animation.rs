//! Animated jobs: evaluates a job at one of its frames.
//!
//! Every number holds its track, so a frame is a clone of the scene with each animated number evaluated at the frame's
//! time.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::ops::Range;

use crate::film::{Frames, ImageSpec, Layer};
use crate::job::Job;
use crate::limits::{MAX_FULL_CHECK_BYTES, MAX_INSTANTS, MIN_SAMPLED_FRAMES};
use crate::scene::{LightGroups, Scene};
use crate::seek::{FrameTime, Seek, SeekError};

/// Job evaluated at one of its frames: the input of rendering a picture.
#[derive(Clone, Debug)]
pub struct JobAtFrame<'a> {
    job: &'a Job,
    scene: Cow<'a, Scene>,
    image: Cow<'a, ImageSpec>,
    frame: u32,
    /// The scene one frame later, if the picture shows motion.
    next: Option<Box<Scene>>,
}

/// A frame at the instants at which it is exposed while the shutter is open: one without motion blur.
#[derive(Clone, Debug)]
pub struct Exposure<'a> {
    /// In the order in which their samples are added. The layers are the last one's.
    pub instants: Vec<JobAtFrame<'a>>,
}

impl Exposure<'_> {
    /// The samples of a pixel in each round ([`ImageSpec::rounds`]), and of them those that are taken at each
    /// instant, in the order of the instants.
    pub fn samples(&self) -> Vec<Vec<Range<u32>>> {
        let count = self.instants.len() as u64;
        let of_round = |round: Range<u32>| {
            let first = |instant: u64| round.start + (round.len() as u64 * instant / count) as u32;
            (0..count).map(|instant| first(instant)..first(instant + 1)).collect()
        };
        self.last().image.rounds().into_iter().map(of_round).collect()
    }

    /// The last instant, in the middle of the exposure.
    pub fn last(&self) -> &JobAtFrame<'_> {
        self.instants.last().expect("there is one")
    }
}

impl JobAtFrame<'_> {
    /// The job.
    pub fn job(&self) -> &Job {
        self.job
    }

    /// The scene, with every number evaluated at this frame.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The scene one frame later, if the picture shows motion and something in the job is animated.
    pub fn next_scene(&self) -> Option<&Scene> {
        self.next.as_deref()
    }

    /// The same frame with another scene.
    pub(crate) fn with_scene(&self, scene: Scene) -> Self {
        Self { scene: Cow::Owned(scene), ..self.clone() }
    }

    /// The same frame of a picture whose light is summed as a whole alone: not by light groups, nor by brightness.
    pub fn without_parts_of_light(&self) -> Self {
        let mut at_frame = self.clone();
        if at_frame.image.film().has_parts_of_light() {
            at_frame.image.to_mut().clear_parts_of_light();
        }
        at_frame
    }

    /// The picture's size and file format, with every number evaluated at this frame.
    pub fn image(&self) -> &ImageSpec {
        &self.image
    }

    /// Number of frames of the job, and their rate.
    pub fn frames(&self) -> &Frames {
        &self.job.frames
    }

    /// Number of the frame, from 0.
    pub fn frame(&self) -> u32 {
        self.frame
    }

    /// Whether frames of the job differ in more than their sampling noise.
    pub fn is_animated(&self) -> bool {
        self.job.is_animated
    }

    /// Whether the frame has motion blur.
    pub fn is_blurred(&self) -> bool {
        self.job.is_blurred()
    }

    /// The instants at which the frame is exposed. Fails as [`Job::at`] does.
    pub fn exposure(&self) -> Result<Exposure<'_>, FrameError> {
        self.job.exposure(self.frame)
    }

    /// The light groups of the frame's picture; `None` if it has none.
    pub fn light_groups(&self) -> Option<LightGroups> {
        LightGroups::of(&self.image.light_groups, &self.scene)
    }

    /// JSON pointer in the document of a node of the scene; both pointers begin with `/scene`.
    pub fn pointer_in_document(&self, pointer: &str) -> String {
        let in_scene = pointer.strip_prefix("/scene").unwrap_or_default();
        self.job
            .written
            .as_ref()
            .map_or_else(|| pointer.to_owned(), |written| format!("/scene{}", written.pointer(in_scene)))
    }
}

/// Error returned when a job cannot be evaluated at a frame because the numbers of that frame are inconsistent.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{pointer} {message} (in frame {frame}, at {seconds} seconds)")]
pub struct FrameError {
    /// JSON pointer to the invalid value.
    pub pointer: String,
    /// The problem and its fix, worded to follow the pointer.
    pub message: String,
    /// Number of the frame, from 0.
    pub frame: u32,
    /// Time of the frame, in seconds.
    pub seconds: f64,
}

impl Job {
    /// Whether its frames differ in more than their sampling noise.
    pub fn is_animated(&self) -> bool {
        self.is_animated
    }

    /// Evaluates the job at a frame.
    ///
    /// Fails if only this frame is invalid and the job has too many frames for the parser to validate each.
    pub fn at(&self, frame: u32) -> Result<JobAtFrame<'_>, FrameError> {
        self.at_instant(frame, 0.0)
    }

    /// Whether its frames have motion blur.
    pub fn is_blurred(&self) -> bool {
        self.is_animated && self.frames.shutter.get() > 0.0
    }

    /// Number of instants at which a frame is exposed, each with a sample of every round.
    pub fn instants(&self) -> u32 {
        let first_round = self.image.rounds().first().map_or(1, |round| round.end);
        if self.is_blurred() { first_round.min(MAX_INSTANTS) } else { 1 }
    }

    /// Evaluates the job at the instants of a frame, evenly spread over the time that the shutter is open.
    ///
    /// Fails as [`Job::at`] does.
    pub fn exposure(&self, frame: u32) -> Result<Exposure<'_>, FrameError> {
        let count = self.instants();
        if !self.is_animated {
            return Ok(Exposure { instants: vec![self.at(frame)?] });
        }
        let shutter = f64::from(self.frames.shutter.get());
        // From the middle on, so that it ends there.
        let order = (0..count).map(|index| (index + count / 2 + 1) % count);
        let at = |instant| self.at_instant(frame, (f64::from(instant) + 0.5) / f64::from(count) * shutter);
        Ok(Exposure { instants: order.map(at).collect::<Result<_, _>>()? })
    }

    /// Evaluates the job `later` frames after the start of a frame.
    fn at_instant(&self, frame: u32, later: f64) -> Result<JobAtFrame<'_>, FrameError> {
        if !self.is_animated {
            let (scene, image) = (Cow::Borrowed(&self.scene), Cow::Borrowed(&self.image));
            return Ok(JobAtFrame { job: self, scene, image, frame, next: None });
        }
        let scene = Cow::Owned(self.scene_at(frame, later)?);
        let mut image = self.image.clone();
        let seconds = self.frames.time_of(f64::from(frame) + later);
        image.seek(&mut FrameTime::at(frame, seconds)).map_err(|misfit| {
            let pointer = format!("/image{}", misfit.pointer);
            FrameError { pointer, message: misfit.message, frame, seconds }
        })?;
        let next = self.shows_motion().then(|| self.scene_at(frame + 1, later).map(Box::new)).transpose()?;
        Ok(JobAtFrame { job: self, scene, image: Cow::Owned(image), frame, next })
    }

    /// Whether its pictures depend on the frame after their own.
    pub fn shows_motion(&self) -> bool {
        self.is_animated && self.image.layers.contains(&Layer::Motion)
    }

    /// The scene `later` frames after the start of a frame.
    fn scene_at(&self, frame: u32, later: f64) -> Result<Scene, FrameError> {
        let place = f64::from(frame) + later;
        let seconds = self.frames.time_of(place);
        let error = |pointer, message| FrameError { pointer, message, frame, seconds };
        let mut scene = self.scene.clone();
        let misfits = scene.seek(&mut FrameTime::at(frame, seconds));
        misfits.map_err(|misfit| error(self.pointer_in_scene(&misfit), misfit.message))?;
        scene.camera.apply_turntable(place, &self.frames);
        if let Some(&(key, message)) = scene.camera.errors().first() {
            return Err(error(format!("/scene/camera/{key}"), message.to_owned()));
        }
        Ok(scene)
    }

    /// JSON pointer in the document to an error in the scene, whose materials are stored by slot.
    fn pointer_in_scene(&self, misfit: &SeekError) -> String {
        let in_slot = misfit.pointer.strip_prefix("/materials/").and_then(|rest| {
            let (slot, rest) = rest.split_once('/')?;
            let place = self.material_pointers.get(slot.parse::<usize>().ok()?)?;
            Some(format!("/scene{place}/{rest}"))
        });
        in_slot.unwrap_or_else(|| {
            let written = self.written.as_ref();
            let pointer = written.map_or_else(|| misfit.pointer.clone(), |written| written.pointer(&misfit.pointer));
            format!("/scene{pointer}")
        })
    }
}

/// Frames after the first that are validated when a job of `bytes` bytes is submitted: all frames if that is cheap,
/// else the frames around keyframes and a sample of the others.
pub fn frames_to_check(frames: &Frames, key_seconds: &[f64], bytes: usize) -> BTreeSet<u32> {
    let count = frames.count;
    let most = (MAX_FULL_CHECK_BYTES / (bytes as u64).max(1)).max(MIN_SAMPLED_FRAMES.into());
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
