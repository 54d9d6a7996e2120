//! Number of samples of a pixel: the same for all, or as many as its noise needs.
//!
//! With [`AdaptiveSamples`], samples are taken in rounds, each of as many as all before it. After a round, the pixels of a
//! block are done if the means of the two halves of their samples differ little: Holger Dammertz, Johannes Hanika,
//! Alexander Keller and Hendrik Lensch, "A hierarchical automatic stopping condition for Monte Carlo global
//! illumination", WSCG 2010, <http://wscg.zcu.cz/WSCG2010/Papers_2010/!_2010_FULL-proceedings.pdf>. Blocks are aligned
//! to the picture, and are decided by their own pixels alone, so that no tile, thread or device changes a decision.

use std::borrow::Cow;
use std::fmt;
use std::ops::Range;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::limits::MAX_SAMPLES;
use crate::real::Real;
use crate::seek::{FrameTime, Seek, SeekError};
use crate::values::{ErrorGoal, PeekedMap, in_range, integer, integer_in_range};

/// Standard error of a pixel's brightness, from the sums of its first samples, `half` of them, and of all `count`.
pub fn standard_error([half, count]: [u32; 2], first: [f32; 4], all: [f32; 4]) -> f32 {
    let brightness = |sums: [f32; 4]| (sums[0] + sums[1] + sums[2]) * (1.0 / 3.0);
    let (first, all) = (brightness(first), brightness(all));
    // Half the difference of the halves' means has the standard deviation of their mean.
    (first / half as f32 - (all - first) / (count - half) as f32).abs() * 0.5
}

/// Number of samples of a pixel that are summed one after another: a batch. Their sum is added to that of the batches before,
/// because each addition to an `f32` rounds: the sum of 65,536 equal numbers is wrong by up to 0.1 % without batches, and by
/// less than 0.001 % with them.
pub const BATCH: u32 = 256;

/// The parts of a range of samples, at most `most` in each, which divides [`BATCH`], so that each is in one batch.
pub fn within_batches(samples: Range<u32>, most: u32) -> impl Iterator<Item = Range<u32>> {
    let end_of_part = move |first: u32| ((first / most + 1) * most).min(samples.end);
    let part = move |first: u32| (first < samples.end).then(|| first..end_of_part(first));
    std::iter::successors(part(samples.start), move |before| part(before.end))
}

/// Edge of the blocks of pixels that have the same number of samples, in pixels.
pub const BLOCK_PX: u32 = 8;
/// Least number of samples that an adaptive pixel may have, so that each half has two.
const MIN_ADAPTIVE: u32 = 4;
/// Brightness below which an error is not relative: a quarter of the darkest level of 8 bits.
const DARK: f32 = 1e-4;

/// Number of samples of a pixel.
#[derive(Clone, Debug, PartialEq)]
pub enum SampleCount {
    /// The same number for all pixels.
    Fixed(u32),
    /// As many as the noise of a block needs.
    Adaptive(AdaptiveSamples),
}

/// As many samples as a block of 8 × 8 pixels needs: a power of two from `min` to `max`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields, default)]
pub struct AdaptiveSamples {
    /// Least number of samples of a pixel: 4, 8, 16 and so on. What so few samples do not find is not waited for.
    #[serde(deserialize_with = "power_of_two")]
    #[schemars(range(min = MIN_ADAPTIVE, max = MAX_SAMPLES))]
    pub min: u32,
    /// Greatest number of samples of a pixel: 4, 8, 16 and so on.
    #[serde(deserialize_with = "power_of_two")]
    #[schemars(range(min = MIN_ADAPTIVE, max = MAX_SAMPLES))]
    pub max: u32,
    /// Error at which a block is done, on the scale of a display from 0 to 1: with 0.02, its pixels are wrong by about 5 of
    /// 255 levels.
    pub error: ErrorGoal,
}

impl Default for AdaptiveSamples {
    fn default() -> Self {
        Self { min: 16, max: 1024, error: ErrorGoal::new(0.02).expect("0.02 is in range") }
    }
}

impl SampleCount {
    /// Greatest number of samples of a pixel.
    pub fn max(&self) -> u32 {
        match self {
            Self::Fixed(count) => *count,
            Self::Adaptive(adaptive) => adaptive.max,
        }
    }

    /// Least number of samples of a pixel.
    pub fn min(&self) -> u32 {
        match self {
            Self::Fixed(count) => *count,
            Self::Adaptive(adaptive) => adaptive.min,
        }
    }

    /// The adaptive number, if it is one.
    pub fn adaptive(&self) -> Option<&AdaptiveSamples> {
        match self {
            Self::Fixed(_) => None,
            Self::Adaptive(adaptive) => Some(adaptive),
        }
    }

    /// The samples of each round: one round, or the rounds of [`AdaptiveSamples`]; all pixels have the first two.
    pub fn rounds(&self) -> Vec<Range<u32>> {
        match self {
            Self::Fixed(count) => std::iter::once(0..*count).collect(),
            Self::Adaptive(AdaptiveSamples { min, max, error: _ }) => {
                let doubled = std::iter::successors(Some(*min), |&end| Some(2 * end)).take_while(|end| end < max);
                [0..min / 2, min / 2..*min].into_iter().chain(doubled.map(|start| start..2 * start)).collect()
            }
        }
    }
}

impl From<u32> for SampleCount {
    fn from(count: u32) -> Self {
        Self::Fixed(count)
    }
}

impl AdaptiveSamples {
    /// Errors between its numbers: the key of one, and a message that follows its pointer.
    pub fn error_between(&self) -> Option<(&'static str, String)> {
        let Self { min, max, error: _ } = self;
        (min > max).then(|| ("min", format!("is {min}, above max, which is {max}: make it smaller, or max greater")))
    }

    /// Whether the pixels of a block need no more samples than these: the sums of red, green, blue and alpha of each, of
    /// the first half of its samples, and of all. The order of the pixels matters to the last bit.
    pub fn is_done(&self, samples: u32, sums: impl Iterator<Item = ([f32; 4], [f32; 4])>) -> bool {
        let share = 1.0 / samples as f32;
        let (mut pixels, mut variance, mut brightness) = (0.0, 0.0, 0.0);
        for (half, all) in sums {
            // Half the difference of the halves' means has the standard deviation of their mean.
            let error = |channel: usize| (2.0 * half[channel] - all[channel]) * share;
            let [red, green, blue, alpha] = [0, 1, 2, 3].map(error);
            variance += (red * red + green * green + blue * blue) * (1.0 / 3.0) + alpha * alpha;
            brightness += (all[0] + all[1] + all[2]) * (share / 3.0);
            pixels += 1.0;
        }
        let (error, brightness) = (Real::sqrt(variance / pixels), (brightness / pixels).max(DARK));
        // A display's levels are about the roots of light, whose derivative is 1/(2√x). Errors of light that no
        // display has are relative.
        error <= 2.0 * self.error.get() * Real::sqrt(brightness).max(brightness)
    }
}

impl Serialize for SampleCount {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Fixed(count) => serializer.serialize_u32(*count),
            Self::Adaptive(adaptive) => serializer.collect_map([("adaptive", adaptive)]),
        }
    }
}

impl<'de> Deserialize<'de> for SampleCount {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(SampleCountVisitor)
    }
}

/// A number of samples that is not a plain number.
#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum NotFixed {
    Adaptive(AdaptiveSamples),
}

struct SampleCountVisitor;

impl SampleCountVisitor {
    fn fixed<E: Error>(value: i64) -> Result<SampleCount, E> {
        in_range(value, 1, MAX_SAMPLES, "samples").map(SampleCount::Fixed)
    }
}

impl<'de> Visitor<'de> for SampleCountVisitor {
    type Value = SampleCount;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a whole number, or {\"adaptive\": {\"min\": 16, \"max\": 1024, \"error\": 0.02}}")
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<SampleCount, E> {
        Self::fixed(value)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<SampleCount, E> {
        Self::fixed(i64::try_from(value).unwrap_or(i64::MAX))
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<SampleCount, E> {
        integer(serde::de::value::F64Deserializer::new(value)).and_then(Self::fixed)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<SampleCount, A::Error> {
        let first = map.next_key::<String>()?;
        let is_motion = matches!(first.as_deref(), Some("expr" | "keys" | "ease" | "loop" | "path"));
        let map = MapAccessDeserializer::new(PeekedMap::new(first, map));
        if is_motion {
            return integer(map).and_then(Self::fixed);
        }
        let NotFixed::Adaptive(adaptive) = NotFixed::deserialize(map)?;
        Ok(SampleCount::Adaptive(adaptive))
    }
}

impl Seek for SampleCount {
    fn seek(&mut self, _: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        Ok(false)
    }
}

impl JsonSchema for SampleCount {
    fn schema_name() -> Cow<'static, str> {
        "SampleCount".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let adaptive = generator.subschema_for::<AdaptiveSamples>();
        json_schema!({
            "description": "Rays per pixel: a number, or as many as its noise needs.",
            "anyOf": [
                { "type": "integer", "minimum": 1, "maximum": MAX_SAMPLES },
                {
                    "type": "object",
                    "properties": { "adaptive": adaptive },
                    "required": ["adaptive"],
                    "additionalProperties": false
                }
            ]
        })
    }
}

fn power_of_two<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    let count = integer_in_range(deserializer, MIN_ADAPTIVE, MAX_SAMPLES, "samples")?;
    if count.is_power_of_two() {
        return Ok(count);
    }
    let above = count.next_power_of_two();
    Err(D::Error::custom(format_args!("must be a power of two: {} or {above}, not {count}", above / 2)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adaptive(min: u32, max: u32, error: f32) -> AdaptiveSamples {
        AdaptiveSamples { min, max, error: ErrorGoal::new(error).expect("it is in range") }
    }

    #[test]
    fn rounds_double_and_end_at_the_greatest_number() {
        let rounds = |min, max| SampleCount::Adaptive(adaptive(min, max, 0.02)).rounds();
        assert_eq!(rounds(16, 128), [0..8, 8..16, 16..32, 32..64, 64..128]);
        assert_eq!(rounds(4, 4), [0..2, 2..4]);
        assert_eq!(SampleCount::Fixed(7).rounds().as_slice(), std::slice::from_ref(&(0..7)));
        let last = rounds(4, MAX_SAMPLES).pop();
        assert_eq!(last, Some(MAX_SAMPLES / 2..MAX_SAMPLES));
    }

    #[test]
    fn parts_of_samples_are_in_one_batch() {
        let parts = |samples, most| within_batches(samples, most).collect::<Vec<_>>();
        assert_eq!(parts(250..600, BATCH), [250..256, 256..512, 512..600]);
        assert_eq!(parts(60..130, 64), [60..64, 64..128, 128..130]);
        assert_eq!(parts(0..256, BATCH).as_slice(), std::slice::from_ref(&(0..256)));
        assert!(parts(7..7, BATCH).is_empty());
    }

    #[test]
    fn a_block_is_done_at_its_error_on_the_scale_of_a_display() {
        // Means of the halves differ by 2·δ: the error of 16 samples is δ.
        let done = |light: f32, delta: f32, goal: f32| {
            let pixel = (
                [8.0 * (light + delta), 8.0 * light, 8.0 * light, 8.0],
                [16.0 * light, 16.0 * light, 16.0 * light, 16.0],
            );
            adaptive(16, 64, goal).is_done(16, std::iter::repeat_n(pixel, 64))
        };
        // One of three channels: an error of δ/√3, and of δ/(2·√3·√light) on the scale of a display.
        for light in [0.01_f32, 0.18, 1.0] {
            let delta = 0.02 * 2.0 * (3.0 * light).sqrt();
            assert!(done(light, delta * 0.99, 0.02), "{light}");
            assert!(!done(light, delta * 1.01, 0.02), "{light}");
        }
        // Light of 100 has an error relative to itself.
        let delta = 0.02 * 2.0 * 3.0_f32.sqrt() * 100.0;
        assert!(done(100.0, delta * 0.99, 0.02) && !done(100.0, delta * 1.01, 0.02));
        assert!(done(0.0, 0.0, 0.0001));
    }

    #[test]
    fn coverage_counts_where_there_is_no_light() {
        let edge = ([0.0, 0.0, 0.0, 8.0], [0.0, 0.0, 0.0, 8.0]);
        assert!(!adaptive(16, 64, 0.02).is_done(16, std::iter::repeat_n(edge, 64)));
    }

    #[test]
    fn both_forms_are_read_and_written() {
        for text in ["12", r#"{"adaptive":{"min":8,"max":64,"error":0.01}}"#] {
            let count: SampleCount = serde_json::from_str(text).expect(text);
            assert_eq!(serde_json::to_string(&count).expect("it can be written"), text);
        }
        let refusal = |text: &str| serde_json::from_str::<SampleCount>(text).expect_err(text).to_string();
        assert!(refusal("0").contains("must be 1 to 65536 samples, not 0"), "{}", refusal("0"));
        assert!(refusal("1.5").contains("whole number"));
        assert!(refusal(r#"{"adaptive":{"min":24}}"#).contains("must be a power of two: 16 or 32, not 24"));
        assert!(refusal(r#"{"adaptive":{"error":2}}"#).contains("0.0001 to 1"));
        assert!(refusal(r#"{"keys":[[0,1]]}"#).contains("cannot be a track"));
    }
}
