//! Focus of a lens: at a distance ahead of the camera, or on a point.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::one_or_three::{OneOrThree, Tracked, read_track};
use super::{Coordinate, FocusDistance, PeekedMap, Point, motion};
use crate::real::Vec3;
use crate::seek::{FrameTime, Seek, SeekError};

/// Focus of a lens.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Focus {
    /// The plane at a distance along the view.
    Distance(FocusDistance),
    /// The plane through a point.
    Point(Point),
}

impl Focus {
    /// Distance of the plane of focus from a camera at `position` that looks along `forward`, of length 1; 0 or less if a
    /// point is not ahead of it.
    pub fn distance(&self, position: Vec3<f32>, forward: Vec3<f32>) -> f32 {
        match self {
            Self::Distance(distance) => distance.in_frame(),
            Self::Point(point) => (point.in_frame() - position).dot(forward),
        }
    }
}

impl OneOrThree for Focus {
    type One = FocusDistance;
    type Three = Coordinate;
    const KEY: &'static str = "[seconds, distance] or [seconds, [x, y, z]]";
    const EXPECTED: &'static str = "a distance, or a list of 3 numbers";
    const KINDS: &'static str = "keys of a distance and keys of a point";
}

impl Seek for Focus {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        match self {
            Self::Distance(distance) => distance.seek(clock),
            Self::Point(point) => point.seek(clock),
        }
    }
}

impl<'de> Deserialize<'de> for Focus {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(FocusVisitor)
    }
}

struct FocusVisitor;

impl<'de> Visitor<'de> for FocusVisitor {
    type Value = Focus;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a distance, or a point: a list of 3 numbers")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Focus, E> {
        motion::number(value).map(Focus::Distance)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Focus, E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Focus, E> {
        self.visit_f64(value as f64)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Focus, A::Error> {
        Point::deserialize(SeqAccessDeserializer::new(list)).map(Focus::Point)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Focus, A::Error> {
        let first = map.next_key::<String>()?;
        let is_track = matches!(first.as_deref(), Some("keys" | "ease" | "loop"));
        let is_path = first.as_deref() == Some("path");
        let map = PeekedMap::new(first, map);
        if is_track {
            return Ok(match read_track::<Focus, _>(map)? {
                Tracked::One(distance) => Focus::Distance(distance),
                Tracked::Three([x, y, z]) => Focus::Point(Point(x, y, z)),
            });
        }
        let map = MapAccessDeserializer::new(map);
        if is_path {
            Point::deserialize(map).map(Focus::Point)
        } else {
            FocusDistance::deserialize(map).map(Focus::Distance)
        }
    }
}

impl JsonSchema for Focus {
    fn schema_name() -> Cow<'static, str> {
        "Focus".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let (distance, point) = (generator.subschema_for::<FocusDistance>(), generator.subschema_for::<Point>());
        json_schema!({
            "description": "The plane in focus: at a distance along the view, or through a point.",
            "anyOf": [distance, point]
        })
    }
}
