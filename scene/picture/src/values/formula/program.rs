//! A formula as a list of steps, which is evaluated for each frame.

use std::fmt;
use std::sync::Arc;

use serde::de::{Error, SeqAccess, Visitor};
use serde::ser::SerializeSeq;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::MAX_FORMULA_STEPS;
use super::functions::{Function, find};
use crate::values::track::Track;

/// One step of a formula: it takes its operands from a stack, and puts its value there.
#[derive(Clone, Debug)]
pub enum Step {
    /// A number.
    Number(f32),
    /// Seconds from frame 0.
    Seconds,
    /// Number of the frame.
    Frame,
    /// A number over time.
    Track(Arc<Track>),
    /// A function or an operator, and how many operands it has.
    Call(&'static Function, usize),
}

/// A number that follows from the time by a formula. In JSON it is the list of its steps, each after its operands:
/// `[0.2, 360, "t", ["*", 2], ["sin", 1], ["*", 2]]`. Jobs have texts instead, which are replaced when they are parsed.
#[derive(Debug)]
pub struct Formula(Vec<Step>);

impl Formula {
    /// The formula of some steps, if each finds its operands and one value is left.
    fn new(steps: Vec<Step>) -> Option<Self> {
        let mut height = 0_usize;
        for step in &steps {
            if let Step::Call(function, operands) = step {
                height = height.checked_sub(*operands).filter(|_| function.arity.contains(operands))?;
            }
            height += 1;
        }
        (height == 1 && steps.len() <= MAX_FORMULA_STEPS as usize).then_some(Self(steps))
    }

    /// The value in a frame, at a number of seconds; it may not be finite.
    pub fn at(&self, frame: u32, seconds: f64) -> f32 {
        let mut stack: Vec<f32> = Vec::with_capacity(16);
        for step in &self.0 {
            let value = match step {
                Step::Number(number) => *number,
                Step::Seconds => seconds as f32,
                Step::Frame => frame as f32,
                Step::Track(track) => track.at(seconds, f32::is_finite),
                Step::Call(function, operands) => {
                    let first = stack.len().saturating_sub(*operands);
                    let value = (function.apply)(&stack[first..]);
                    stack.truncate(first);
                    value
                }
            };
            stack.push(value);
        }
        stack.pop().unwrap_or(f32::NAN)
    }

    /// The tracks in it.
    pub fn tracks(&self) -> impl Iterator<Item = &Track> {
        self.0.iter().filter_map(|step| match step {
            Step::Track(track) => Some(track.as_ref()),
            Step::Number(_) | Step::Seconds | Step::Frame | Step::Call(..) => None,
        })
    }
}

impl Serialize for Step {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Number(number) => serializer.serialize_f32(*number),
            Self::Seconds => serializer.serialize_str("t"),
            Self::Frame => serializer.serialize_str("frame"),
            Self::Track(track) => track.serialize(serializer),
            Self::Call(function, operands) => {
                let mut call = serializer.serialize_seq(Some(2))?;
                call.serialize_element(function.name)?;
                call.serialize_element(operands)?;
                call.end()
            }
        }
    }
}

/// A step as it is parsed.
#[derive(Deserialize)]
#[serde(untagged)]
enum ReadStep {
    Number(f32),
    Name(String),
    Call(String, usize),
    Track(Track),
}

impl ReadStep {
    fn step(self) -> Option<Step> {
        match self {
            Self::Number(number) => Some(Step::Number(number)),
            Self::Name(name) => match name.as_str() {
                "t" => Some(Step::Seconds),
                "frame" => Some(Step::Frame),
                _ => None,
            },
            Self::Track(track) => Some(Step::Track(Arc::new(track))),
            Self::Call(name, operands) => Some(Step::Call(find(&name)?, operands)),
        }
    }
}

struct StepsVisitor;

impl<'de> Visitor<'de> for StepsVisitor {
    type Value = Formula;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a formula, as in \"0.2 * sin(360 * t)\"")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Formula, A::Error> {
        let wrong = || A::Error::custom("is not a formula: write one as text, as in \"0.2 * sin(360 * t)\"");
        let mut steps = Vec::new();
        while let Some(step) = list.next_element::<ReadStep>()? {
            if steps.len() == MAX_FORMULA_STEPS as usize {
                return Err(wrong());
            }
            steps.push(step.step().ok_or_else(wrong)?);
        }
        Formula::new(steps).ok_or_else(wrong)
    }
}

impl<'de> Deserialize<'de> for Formula {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(StepsVisitor)
    }
}
