//! A color ramp: maps a number to a color.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{DeserializeSeed, Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::limits::MAX_RAMP_STOPS;
use crate::materials::param::lerp_colors;
use crate::materials::{ColorParam, ShadingPoint};
use crate::real::{Real, Vec3};
use crate::seek::{FrameTime, Seek, SeekError};
use crate::values::Fraction;

/// Minimum width between stops: two stops at one position make an edge of this width.
const MIN_STEP: f32 = 1e-6;

/// Colors at numbers from 0 to 1, in order, interpolated linearly between them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ramp(Vec<RampStop>);

/// A color on a ramp: `[position, color]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
pub struct RampStop(pub Fraction, pub ColorParam);

impl Ramp {
    /// From black to white.
    pub(super) fn black_to_white() -> Self {
        let end = |place, color| RampStop(Fraction::new(place).expect("an end of the range"), color);
        Self(vec![end(0.0, ColorParam::black()), end(1.0, ColorParam::white())])
    }

    /// Color at `share`; before the first stop that stop's color, after the last stop the last's.
    pub fn at<R: Real>(&self, share: R, place: &ShadingPoint<R>) -> Vec3<R> {
        let mut color = self.0[0].1.at(place);
        for pair in self.0.windows(2) {
            let (from, to) = (pair[0].0.in_frame(), pair[1].0.in_frame());
            let slope = 1.0 / (to - from).max(MIN_STEP);
            let way = ((share - share.uniform(from)) * share.uniform(slope)).at_least(0.0).at_most(1.0);
            color = lerp_colors(color, pair[1].1.at(place), way);
        }
        color
    }

    /// Its colors, which may be textures.
    pub(super) fn color_params(&self) -> impl Iterator<Item = &ColorParam> {
        self.0.iter().map(|RampStop(_, color)| color)
    }
}

fn out_of_order(before: &RampStop, stop: &RampStop) -> String {
    format!(
        "is at {}, less than the stop before it at {}: put stops in order, from 0 to 1",
        stop.0.in_frame(),
        before.0.in_frame()
    )
}

impl Seek for Ramp {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        let Self(stops) = self;
        let is_animated = stops.seek(clock)?;
        let mut steps = stops.windows(2).enumerate();
        if is_animated && let Some((index, pair)) = steps.find(|(_, pair)| pair[1].0 < pair[0].0) {
            return Err(SeekError::new(out_of_order(&pair[0], &pair[1])).inside(&(index + 1).to_string()));
        }
        Ok(is_animated)
    }
}

/// Deserializes a stop that must not be before another.
struct RampStopSeed<'a>(Option<&'a RampStop>);

impl<'de> DeserializeSeed<'de> for RampStopSeed<'_> {
    type Value = RampStop;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<RampStop, D::Error> {
        let stop = RampStop::deserialize(deserializer)?;
        match self.0 {
            Some(before) if stop.0 < before.0 => Err(D::Error::custom(out_of_order(before, &stop))),
            _ => Ok(stop),
        }
    }
}

/// Deserializes the stops of a ramp.
struct RampVisitor;

impl<'de> Visitor<'de> for RampVisitor {
    type Value = Ramp;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a ramp: [[0, color], …, [1, color]]")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Ramp, A::Error> {
        let mut stops: Vec<RampStop> = Vec::new();
        while let Some(stop) = list.next_element_seed(RampStopSeed(stops.last()))? {
            stops.push(stop);
            if stops.len() > MAX_RAMP_STOPS {
                let message = format_args!("has more than {MAX_RAMP_STOPS} stops: remove some");
                return Err(A::Error::custom(message));
            }
        }
        if stops.len() < 2 {
            let count = stops.len();
            let message =
                format_args!("has {count} of at least 2 stops: for a single color, write the color without a texture");
            return Err(A::Error::custom(message));
        }
        Ok(Ramp(stops))
    }
}

impl<'de> Deserialize<'de> for Ramp {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(RampVisitor)
    }
}

impl JsonSchema for Ramp {
    fn schema_name() -> Cow<'static, str> {
        "Ramp".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let stop = generator.subschema_for::<RampStop>();
        json_schema!({
            "type": "array", "items": stop, "minItems": 2, "maxItems": MAX_RAMP_STOPS,
            "description": "Colors at numbers from 0 to 1, in order: [[0, color], …, [1, color]]."
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::materials::texture::tests::at;

    fn reds(ramp: &str, shares: &[f32]) -> Vec<f32> {
        let ramp: Ramp = serde_json::from_str(ramp).unwrap();
        shares.iter().map(|&share| ramp.at(share, &at(0.0, 0.0, 0.0)).x).collect()
    }

    #[test]
    fn a_ramp_passes_through_its_stops_and_ends_with_them() {
        let ramp = "[[0.2, [1, 0, 0]], [0.4, [3, 0, 0]], [0.8, [0, 0, 0]]]";
        assert_eq!(reds(ramp, &[-7.0, 0.2, 0.4, 0.8, 9.0]), [1.0, 1.0, 3.0, 0.0, 0.0]);
        let between = reds(ramp, &[0.3, 0.6]);
        assert!((between[0] - 2.0).abs() < 1e-6 && (between[1] - 1.5).abs() < 1e-6, "{between:?}");
    }

    #[test]
    fn two_stops_in_one_place_make_an_edge() {
        let ramp = "[[0, [1, 0, 0]], [0.5, [1, 0, 0]], [0.5, [0, 0, 0]], [1, [0, 0, 0]]]";
        assert_eq!(reds(ramp, &[0.49, 0.51]), [1.0, 0.0]);
    }
}
