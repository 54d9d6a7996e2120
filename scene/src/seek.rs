//! The walk over every number of a job: to the time of a frame, or over the keyframes of its tracks.
//!
//! `#[derive(Seek)]` (scene/derive) writes it for each struct and enum of the language, so that a field whose
//! type can't be sought does not compile.

pub(crate) use scene_derive::Seek;

/// The time that numbers are taken to.
#[derive(Debug)]
pub(crate) struct FrameTime<'a> {
    /// Seconds from frame 0.
    pub seconds: f64,
    /// Where the times of all keyframes are noted, if somebody asks for them.
    keyframe_times: Option<&'a mut Vec<f64>>,
}

impl<'a> FrameTime<'a> {
    /// A clock that stands at a time.
    pub(crate) fn at(seconds: f64) -> Self {
        Self { seconds, keyframe_times: None }
    }

    /// The same, which notes the times of all keyframes.
    pub(crate) fn recording(seconds: f64, key_seconds: &'a mut Vec<f64>) -> Self {
        Self { seconds, keyframe_times: Some(key_seconds) }
    }

    /// Notes the times of a track's keyframes.
    pub(crate) fn record_keyframes(&mut self, seconds: impl Iterator<Item = f64>) {
        if let Some(noted) = &mut self.keyframe_times {
            noted.extend(seconds);
        }
    }
}

/// Numbers that do not go together at one time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct SeekError {
    /// JSON pointer from what was sought to what is wrong.
    pub pointer: String,
    /// What is wrong and what to do about it, as it reads behind the place.
    pub message: String,
}

impl SeekError {
    /// One of the value itself.
    pub(crate) fn new(message: impl Into<String>) -> Box<Self> {
        Box::new(Self { pointer: String::new(), message: message.into() })
    }

    /// The same, seen from the object or list that has the value under `key`.
    pub(crate) fn inside(mut self: Box<Self>, key: &str) -> Box<Self> {
        self.pointer.insert_str(0, key);
        self.pointer.insert(0, '/');
        self
    }
}

/// What stands in a job file: its numbers may be animated.
pub(crate) trait Seek {
    /// Takes every animated number to the clock's time, and derives anew what follows from such. Says whether
    /// there was one.
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>>;
}

/// What follows from numbers beside it and does not stand in a job file.
pub(crate) trait Invalidate {
    /// Forgets what was derived from numbers that have changed.
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
