//! Where the camera looks: at a point, or ahead along its own way.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::real::{Real, Vec3};
use crate::seek::{FrameTime, Seek, SeekError};
use crate::values::{LookAheadSeconds, PeekedMap, Point, RollFactor};

/// The most that a camera leans into a turn, in degrees.
const MAX_ROLL: f32 = 80.0;

/// Where the camera looks.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum LookAt {
    /// At a point.
    Point(Point),
    /// Ahead along the way of its position.
    Ahead(Box<Ahead>),
}

/// Ahead along the way of the camera: toward the position that it has some seconds later.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Ahead {
    /// How many seconds ahead the camera looks; its `position` must change.
    #[schemars(extend("examples" = [0.5]))]
    pub ahead: LookAheadSeconds,
    /// How far the camera leans into a turn: degrees for each degree per second that its view turns.
    #[serde(default = "default_bank")]
    pub bank: RollFactor,
    /// The positions `ahead` seconds later and before.
    #[serde(skip_deserializing)]
    #[schemars(skip)]
    later: Option<[Point; 2]>,
}

impl LookAt {
    /// The point at the center of the picture of a camera at a position.
    pub(super) fn point(&self, position: Vec3<f32>) -> Vec3<f32> {
        match self {
            Self::Point(point) => point.in_frame(),
            Self::Ahead(ahead) => ahead.point(position),
        }
    }

    /// The camera's roll in degrees, to the right: it leans into a turn.
    pub(super) fn roll(&self, position: Vec3<f32>, up: Vec3<f32>) -> f32 {
        match self {
            Self::Point(_) => 0.0,
            Self::Ahead(ahead) => ahead.roll(position, up),
        }
    }

    /// Tells it the position of the camera in all frames.
    pub(super) fn follow(&mut self, position: &Point) {
        if let Self::Ahead(ahead) = self {
            ahead.later = Some([position.clone(), position.clone()]);
            // An error here is one of `position` itself.
            drop(self.seek(&mut FrameTime::at(0, 0.0)));
        }
    }

    /// Whether the camera looks ahead.
    pub(super) fn is_ahead(&self) -> bool {
        matches!(self, Self::Ahead(_))
    }
}

impl Ahead {
    fn point(&self, position: Vec3<f32>) -> Vec3<f32> {
        let Some([later, before]) = &self.later else { return position };
        let later = later.in_frame();
        if (later - position).length() > 1e-4 {
            return later;
        }
        // At the end of its way, it looks on in the same direction.
        position + (position - before.in_frame())
    }

    fn roll(&self, position: Vec3<f32>, up: Vec3<f32>) -> f32 {
        let Some([later, before]) = self.later.as_ref().map(|points| points.each_ref().map(Point::in_frame)) else {
            return 0.0;
        };
        let (from, to) = (position - before, later - position);
        let turn = up.dot(from.cross(to));
        let onward = from.dot(to) - up.dot(from) * up.dot(to);
        let degrees = Real::atan2(turn, onward) * (180.0 / std::f32::consts::PI);
        (-degrees / self.ahead.in_frame() * self.bank.in_frame()).clamp(-MAX_ROLL, MAX_ROLL)
    }
}

impl Seek for LookAt {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        match self {
            Self::Point(point) => point.seek(clock),
            Self::Ahead(ahead) => {
                let Ahead { ahead: seconds, bank, later } = &mut **ahead;
                let moves = seconds.seek(clock).map_err(|error| error.inside("ahead"))?
                    | bank.seek(clock).map_err(|error| error.inside("bank"))?;
                let Some([later, before]) = later else { return Ok(moves) };
                let away = f64::from(seconds.in_frame());
                let follows = later.seek(&mut FrameTime::at(clock.frame, clock.seconds + away))?
                    | before.seek(&mut FrameTime::at(clock.frame, clock.seconds - away))?;
                Ok(moves | follows)
            }
        }
    }
}

impl<'de> Deserialize<'de> for LookAt {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(LookAtVisitor)
    }
}

struct LookAtVisitor;

impl<'de> Visitor<'de> for LookAtVisitor {
    type Value = LookAt;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of 3 numbers, or {\"ahead\": seconds}")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<LookAt, A::Error> {
        Point::deserialize(SeqAccessDeserializer::new(list)).map(LookAt::Point)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<LookAt, A::Error> {
        let first = map.next_key::<String>()?;
        let is_ahead = matches!(first.as_deref(), Some("ahead" | "bank"));
        let map = MapAccessDeserializer::new(PeekedMap::new(first, map));
        if is_ahead {
            return Ahead::deserialize(map).map(|ahead| LookAt::Ahead(Box::new(ahead)));
        }
        Point::deserialize(map).map(LookAt::Point).map_err(A::Error::custom)
    }
}

impl JsonSchema for LookAt {
    fn schema_name() -> Cow<'static, str> {
        "LookAt".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let (point, ahead) = (generator.subschema_for::<Point>(), generator.subschema_for::<Ahead>());
        json_schema!({
            "description": "Where the camera looks: at a point different from `position`, or ahead along its own way.",
            "anyOf": [point, ahead]
        })
    }
}

fn default_bank() -> RollFactor {
    RollFactor::new(0.0).expect("0 is in range")
}
