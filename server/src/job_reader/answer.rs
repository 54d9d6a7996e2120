//! Questions about a job file, and the answers of the process that reads it.

use std::time::Duration;

use proto::problem::ValidationErrorView;
use scene::{Format, Job, ParseError};
use serde::{Deserialize, Serialize};

use crate::clock::monotonic_now;
use crate::delivery_check::ExpectedPicture;
use crate::queue::FrameOpening;
use crate::tile_plan::TilePlan;

/// Maximum number of frames of an answer about frames, and of one about a job, whose client waits.
const MAX_FRAMES: usize = 64;
const MAX_FIRST_FRAMES: usize = 4;
/// Time after which no further frame is added to an answer.
const FRAMES_TIME: Duration = Duration::from_millis(50);
/// Size of the frames of an answer, as JSON, beyond which no further one is added.
const FRAMES_BYTES: usize = 256 << 10;

/// Question about a job file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) enum Question {
    /// Facts of the job: [`Answer::Job`].
    Job {
        /// Whether it is to be accepted.
        accept: bool,
        /// Edge of a tile requested by the operator, in pixels.
        edge_px: Option<u32>,
    },
    /// Facts of frames from this one on: [`Answer::Frames`], as many as are found in a short time.
    Frames {
        /// The first frame.
        first: u32,
    },
    /// Whether the job can be rendered at a frame: [`Answer::Fine`].
    Frame(u32),
    /// The formatted text: [`Answer::Text`].
    Format,
    /// The text with values at paths: [`Answer::Text`] or [`Answer::WrongValue`].
    Set(Vec<(String, String)>),
}

/// Answer to a [`Question`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) enum Answer {
    /// The file is no valid job.
    Refused(Refusal),
    /// Facts of a job.
    Job(Box<JobFacts>),
    /// Frames of a job.
    Frames(Vec<FrameFacts>),
    /// The job has no such frame, but this many.
    NoFrame(u32),
    /// A value cannot be set, and why.
    WrongValue(String),
    /// A text.
    Text(String),
    /// It is as it should be.
    Fine,
}

/// Errors of a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{message}")]
pub(crate) struct Refusal {
    /// Whether the file is JSON.
    pub(crate) is_json: bool,
    pub(crate) errors: Vec<ValidationErrorView>,
    /// All errors as a text.
    message: String,
}

/// Facts of a job.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct JobFacts {
    pub(crate) name: String,
    pub(crate) priority: i32,
    pub(crate) plan: TilePlan,
    pub(crate) warnings: Vec<String>,
    pub(crate) is_png: bool,
    /// Number of nodes that a worker must be able to compile; 0 unless the job is to be accepted.
    pub(crate) nodes: u32,
    /// Its first frames; none unless the job is to be accepted.
    pub(crate) frames: Vec<FrameFacts>,
}

/// Facts of a frame of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct FrameFacts {
    pub(crate) frame: u32,
    /// Key of its picture, in hex.
    pub(crate) picture_key: String,
    /// Hash of its scene, in hex; `None` if it cannot be evaluated.
    pub(crate) scene: Option<String>,
    /// Its picture, or why it cannot be evaluated.
    pub(crate) expected: Result<ExpectedPicture, String>,
}

impl FrameFacts {
    fn of(job: &Job, frame: u32) -> Self {
        let (picture_key, scene, expected) = match job.at(frame) {
            Ok(at_frame) => {
                let scene = at_frame.scene_hash().to_hex().to_string();
                (at_frame.cache_key(), Some(scene), Ok(ExpectedPicture::new(&at_frame)))
            }
            Err(error) => (job.cache_key(frame), None, Err(error.to_string())),
        };
        Self { frame, picture_key: picture_key.to_hex().to_string(), scene, expected }
    }

    /// Opening of the frame, of a job with this number and plan.
    pub(crate) fn opening(&self, job: i64, plan: TilePlan) -> FrameOpening {
        let (picture_key, scene) = (self.picture_key.clone(), self.scene.clone());
        FrameOpening { job, frame: self.frame, picture_key, scene, tiles: plan.tiles(), samples: plan.samples }
    }

    /// Size, in bytes, about.
    pub(crate) fn bytes(&self) -> usize {
        size_of::<Self>() + 2 * 64 + self.expected.as_ref().map_or_else(String::len, ExpectedPicture::bytes)
    }
}

impl From<&ParseError> for Refusal {
    fn from(error: &ParseError) -> Self {
        let (is_json, errors) = match error {
            ParseError::NotJson(fault) => (false, vec![fault.into()]),
            ParseError::Invalid(faults) => (true, faults.iter().map(Into::into).collect()),
        };
        Self { is_json, errors, message: error.to_string() }
    }
}

impl Refusal {
    /// A file that takes more than it may.
    pub(crate) fn too_costly(message: String) -> Self {
        let error = ValidationErrorView { pointer: String::new(), message: message.clone(), line: 1, column: 1 };
        Self { is_json: true, errors: vec![error], message }
    }
}

/// The last job that was read, for further questions about its frames.
#[derive(Debug, Default)]
pub(super) struct LastJob(Option<(blake3::Hash, Job)>);

impl LastJob {
    /// Answers a question about a job file.
    pub(super) fn answer(&mut self, question: &Question, text: &[u8]) -> Answer {
        self.try_answer(question, text).unwrap_or_else(|error| Answer::Refused((&error).into()))
    }

    fn try_answer(&mut self, question: &Question, text: &[u8]) -> Result<Answer, ParseError> {
        let last = self.0.take();
        match question {
            Question::Job { accept, edge_px } => {
                let job = scene::parse(text)?;
                let facts = JobFacts {
                    plan: TilePlan::new(&job, *edge_px),
                    priority: job.priority,
                    warnings: scene::warnings(&job),
                    is_png: job.image.format == Format::Png,
                    nodes: if *accept { scene::compiled_nodes(&job) } else { 0 },
                    frames: if *accept { frames(&job, 0, MAX_FIRST_FRAMES) } else { Vec::new() },
                    name: job.name,
                };
                Ok(Answer::Job(Box::new(facts)))
            }
            Question::Frames { first } => {
                let hash = blake3::hash(text);
                let job = match last.filter(|(known, _)| *known == hash) {
                    Some((_, job)) => job,
                    None => scene::parse(text)?,
                };
                let frames = frames(&job, *first, MAX_FRAMES);
                self.0 = Some((hash, job));
                Ok(Answer::Frames(frames))
            }
            Question::Frame(frame) => {
                let job = scene::parse(text)?;
                if *frame >= job.frames.count {
                    return Ok(Answer::NoFrame(job.frames.count));
                }
                job.at(*frame).map_err(|error| scene::error_in_frame(text, error))?;
                Ok(Answer::Fine)
            }
            Question::Format => scene::format(text).map(Answer::Text),
            Question::Set(values) => {
                let Ok(mut changed) = std::str::from_utf8(text).map(str::to_owned) else {
                    return scene::parse(text).map(|_| Answer::Fine);
                };
                for (path, value) in values {
                    match scene::set_value(&changed, path, value) {
                        Ok(text) => changed = text,
                        Err(message) => return Ok(Answer::WrongValue(format!("could not set {path}: {message}"))),
                    }
                }
                Ok(Answer::Text(changed))
            }
        }
    }
}

/// The first of these frames, and as many further ones, up to `most`, as are found in a short time.
fn frames(job: &Job, first: u32, most: usize) -> Vec<FrameFacts> {
    let (start, mut bytes, mut frames) = (monotonic_now(), 0, Vec::new());
    for frame in (first..job.frames.count.max(first.saturating_add(1))).take(most) {
        let facts = FrameFacts::of(job, frame);
        bytes += facts.bytes();
        frames.push(facts);
        if bytes > FRAMES_BYTES || start.elapsed() > FRAMES_TIME {
            break;
        }
    }
    frames
}
