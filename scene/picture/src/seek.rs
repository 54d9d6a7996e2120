//! Visits every number of a job: evaluates them at the time of a frame, or lists the keyframes of their tracks.
//!
//! `#[derive(Seek)]` (scene/derive) implements it for each struct and enum of the language, so that a field whose type
//! cannot be visited does not compile.

pub use scene_derive::Seek;

/// The time at which numbers are evaluated.
#[derive(Debug)]
pub struct FrameTime<'a> {
    /// Seconds from frame 0.
    pub seconds: f64,
    /// Number of the frame.
    pub frame: u32,
    /// Collects the times of all keyframes, if they are requested.
    keyframe_times: Option<&'a mut Vec<f64>>,
}

impl<'a> FrameTime<'a> {
    /// Time of a frame at a number of seconds.
    pub fn at(frame: u32, seconds: f64) -> Self {
        Self { seconds, frame, keyframe_times: None }
    }

    /// Time of the first frame, which also collects the times of all keyframes.
    pub fn recording(key_seconds: &'a mut Vec<f64>) -> Self {
        Self { seconds: 0.0, frame: 0, keyframe_times: Some(key_seconds) }
    }

    /// Collects the times of a track's keyframes.
    pub(crate) fn record_keyframes(&mut self, seconds: impl Iterator<Item = f64>) {
        if let Some(noted) = &mut self.keyframe_times {
            noted.extend(seconds);
        }
    }
}

/// Error returned when numbers are inconsistent at one time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SeekError {
    /// JSON pointer from the visited value to the invalid value.
    pub pointer: String,
    /// The problem and its fix, worded to follow the pointer.
    pub message: String,
}

impl SeekError {
    /// Error at the value itself.
    pub fn new(message: impl Into<String>) -> Box<Self> {
        Box::new(Self { pointer: String::new(), message: message.into() })
    }

    /// The same error, with its pointer prefixed by the member `key` of the parent.
    pub fn inside(mut self: Box<Self>, key: &str) -> Box<Self> {
        self.pointer.insert_str(0, key);
        self.pointer.insert(0, '/');
        self
    }
}

/// A value of a job file, whose numbers may be animated.
pub trait Seek {
    /// Evaluates every animated number at a time, and recomputes the values derived from them. Returns whether there
    /// was one.
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>>;
}

/// A value derived from other numbers of the same type, which is not in a job file.
pub(crate) trait Invalidate {
    /// Discards a value derived from numbers that have changed.
    fn invalidate(&mut self);
}

macro_rules! never_animated {
    ($($Type:ty),*) => { $(
        impl Seek for $Type {
            fn seek(&mut self, _: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
                Ok(false)
            }
        }
    )* };
}

never_animated![bool, u32, i32, String];

impl<T: Seek + ?Sized> Seek for Box<T> {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        (**self).seek(clock)
    }
}

impl<T: Seek> Seek for Option<T> {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        self.as_mut().map_or(Ok(false), |value| value.seek(clock))
    }
}

impl<T: Seek> Seek for [T] {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        let mut is_animated = false;
        for (index, value) in self.iter_mut().enumerate() {
            is_animated |= value.seek(clock).map_err(|misfit| misfit.inside(&index.to_string()))?;
        }
        Ok(is_animated)
    }
}

impl<T: Seek, const N: usize> Seek for [T; N] {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        self.as_mut_slice().seek(clock)
    }
}

impl<T: Seek> Seek for Vec<T> {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        self.as_mut_slice().seek(clock)
    }
}
