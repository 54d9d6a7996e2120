//! Paths: a smooth curve through points, along which a point moves.
//!
//! Centripetal Catmull–Rom splines: Edwin Catmull and Raphael Rom, "A class of local interpolating splines", 1974;
//! Cem Yuksel, Scott Schaefer and John Keyser, "Parameterization and applications of Catmull-Rom curves", 2011. Every
//! number is a result of + − × ÷ √ in `f64`, so that all hosts compute the same bits.

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer};

use super::ConstantCoordinate;
use super::track::{self, WrittenTrack};
use crate::limits::MAX_PATH_POINTS;

/// Parts of a span between two points whose lengths are stored.
const PARTS: usize = 32;

/// A path, and how far a point is on it over time.
#[derive(Deserialize)]
#[serde(rename = "PathTrack", deny_unknown_fields)]
pub(super) struct WrittenPath {
    pub(super) path: MovingAlong,
}

/// Points that a path goes through, and keyframes of the fraction of its length.
#[derive(Deserialize)]
#[serde(rename = "Path", from = "WrittenAlong")]
pub(super) struct MovingAlong {
    pub(super) path: Path,
    pub(super) progress: track::Track,
}

#[derive(Deserialize)]
#[serde(rename = "Path", deny_unknown_fields)]
struct WrittenAlong {
    through: Points,
    #[serde(default)]
    closed: bool,
    keys: track::Keyframes<Fraction>,
    #[serde(default)]
    ease: track::Ease,
    #[serde(default, rename = "loop")]
    cycle: Option<track::Loop>,
}

impl From<WrittenAlong> for MovingAlong {
    fn from(written: WrittenAlong) -> Self {
        let WrittenAlong { through, closed, keys, ease, cycle } = written;
        let progress = WrittenTrack::new(keys, ease, cycle).track(|fraction: &Fraction| fraction.0);
        Self { path: Path::new(&through.0, closed), progress }
    }
}

/// A fraction of a path's length.
struct Fraction(f32);

impl track::KeyframeValue for Fraction {
    const KEY: &'static str = "[seconds, fraction of the path]";
}

impl<'de> Deserialize<'de> for Fraction {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        super::motion::read_constant::<super::Fraction, D>(deserializer).map(|fraction| Self(fraction.in_frame()))
    }
}

/// The points of a path: two or more, each different from the one before.
struct Points(Vec<[f64; 3]>);

impl<'de> Deserialize<'de> for Points {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        use serde::de::Error;
        let points = Vec::<[ConstantCoordinate; 3]>::deserialize(deserializer)?;
        let points: Vec<[f64; 3]> = points.iter().map(|point| point.each_ref().map(|c| f64::from(c.get()))).collect();
        if points.len() < 2 || points.len() > MAX_PATH_POINTS {
            let count = points.len();
            return Err(D::Error::custom(format_args!("has {count} points: a path has 2 to {MAX_PATH_POINTS}")));
        }
        if let Some(place) = points.windows(2).position(|pair| distance(pair[0], pair[1]) < 1e-6) {
            let next = place + 1;
            return Err(D::Error::custom(format_args!("has point {next} where point {place} is: remove one of them")));
        }
        Ok(Self(points))
    }
}

/// A smooth curve through points.
#[derive(Debug, PartialEq)]
pub(super) struct Path {
    /// The points, with one more at each end of an open path, and the first three again at the end of a closed one.
    points: Vec<[f64; 3]>,
    /// Length of the path up to each part of each span, from 0.
    lengths: Vec<f64>,
}

impl Path {
    fn new(through: &[[f64; 3]], closed: bool) -> Self {
        let (first, last) = (through[0], through[through.len() - 1]);
        let mut points = Vec::with_capacity(through.len() + 3);
        // A closed path may name its first point again at its end.
        let ring = if closed && distance(first, last) < 1e-6 { &through[..through.len() - 1] } else { through };
        if closed && ring.len() > 2 {
            points.push(ring[ring.len() - 1]);
            points.extend(ring);
            points.extend(&ring[..2]);
        } else {
            // The ends are mirrored: the curve leaves them straight.
            points.push(mirrored(through[1], first));
            points.extend(through);
            points.push(mirrored(through[through.len() - 2], last));
        }
        let mut path = Self { points, lengths: vec![0.0] };
        let (mut sum, mut before) = (0.0, path.points[1]);
        for span in 0..path.spans() {
            for part in 1..=PARTS {
                let next = path.on_span(span, part as f64 / PARTS as f64);
                sum += distance(before, next);
                before = next;
                path.lengths.push(sum);
            }
        }
        path
    }

    fn spans(&self) -> usize {
        self.points.len() - 3
    }

    /// The point at a fraction of the path's length, 0 to 1.
    pub(super) fn at(&self, fraction: f64) -> [f64; 3] {
        let parts = self.lengths.len() - 1;
        let wanted = fraction.clamp(0.0, 1.0) * self.lengths[parts];
        let part = self.lengths.partition_point(|&length| length <= wanted).clamp(1, parts) - 1;
        let (from, to) = (self.lengths[part], self.lengths[part + 1]);
        let within = if to > from { (wanted - from) / (to - from) } else { 0.0 };
        let along = (part % PARTS) as f64 + within;
        self.on_span(part / PARTS, along / PARTS as f64)
    }

    /// The point of a span, where `u` is 0 to 1, by the pyramid of Barry and Goldman.
    fn on_span(&self, span: usize, u: f64) -> [f64; 3] {
        let p: [[f64; 3]; 4] = std::array::from_fn(|index| self.points[span + index]);
        let mut knots = [0.0; 4];
        for index in 0..3 {
            knots[index + 1] = knots[index] + distance(p[index], p[index + 1]).sqrt().max(1e-3);
        }
        let t = knots[1] + (knots[2] - knots[1]) * u;
        let between = |a: [f64; 3], b: [f64; 3], from: f64, to: f64| mix(a, b, (t - from) / (to - from));
        let a = [0, 1, 2].map(|index| between(p[index], p[index + 1], knots[index], knots[index + 1]));
        let b = [0, 1].map(|index| between(a[index], a[index + 1], knots[index], knots[index + 2]));
        between(b[0], b[1], knots[1], knots[2])
    }
}

fn mix(a: [f64; 3], b: [f64; 3], share: f64) -> [f64; 3] {
    std::array::from_fn(|axis| a[axis] + (b[axis] - a[axis]) * share)
}

/// The point as far behind `end` as `p` is before it.
fn mirrored(p: [f64; 3], end: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| 2.0 * end[axis] - p[axis])
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| a[axis] - b[axis]);
    (x * x + y * y + z * z).sqrt()
}

/// Schema of a point that moves along a path.
pub(super) struct PathSchema;

impl JsonSchema for PathSchema {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "PointOnPath".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let fraction = json_schema!({ "type": "number", "minimum": 0, "maximum": 1 });
        let mut along = track::schema(
            "A smooth path through points, and how far the point is on it over time: 0 at its start, 1 at its end.",
            &fraction,
            [0.into(), 1.into()],
            generator,
        );
        let point = json_schema!({ "type": "array", "items": { "type": "number" }, "minItems": 3, "maxItems": 3 });
        along.insert(
            "examples".to_owned(),
            serde_json::json!([{ "through": [[0, 1, 5], [3, 1, 0], [0, 1, -5]], "keys": [[0, 0], [4, 1]] }]),
        );
        if let Some(properties) = along.get_mut("properties").and_then(serde_json::Value::as_object_mut) {
            properties.insert(
                "through".to_owned(),
                serde_json::json!({ "description": "Points that the path goes through, one after another.",
                    "type": "array", "items": point, "minItems": 2, "maxItems": MAX_PATH_POINTS }),
            );
            properties.insert(
                "closed".to_owned(),
                serde_json::json!({ "description": "Whether the path goes on from the last point to the first.",
                    "type": "boolean", "default": false }),
            );
        }
        along.insert("required".to_owned(), serde_json::json!(["through", "keys"]));
        json_schema!({ "description": "A point that moves along a path.", "type": "object",
            "properties": { "path": along }, "required": ["path"], "additionalProperties": false })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_near(a: [f64; 3], b: [f64; 3]) -> bool {
        distance(a, b) < 1e-3
    }

    #[test]
    fn a_path_goes_through_its_points_at_even_speed() {
        let points = [[0.0, 0.0, 0.0], [1.0, 2.0, 0.0], [3.0, 2.0, 1.0], [4.0, 0.0, 0.0]];
        let path = Path::new(&points, false);
        for point in points {
            assert!((0..=4096).any(|step| distance(path.at(f64::from(step) / 4096.0), point) < 2e-3), "{point:?}");
        }
        let steps: Vec<f64> = (0..200)
            .map(|step| distance(path.at(f64::from(step) / 200.0), path.at(f64::from(step + 1) / 200.0)))
            .collect();
        let mean = steps.iter().sum::<f64>() / 200.0;
        assert!(steps.iter().all(|step| (step / mean - 1.0).abs() < 0.02), "{steps:?}");
    }

    #[test]
    fn two_points_make_a_straight_line() {
        let path = Path::new(&[[1.0, 0.0, 0.0], [1.0, 4.0, 0.0]], false);
        assert!(is_near(path.at(0.25), [1.0, 1.0, 0.0]));
        assert_eq!((path.at(-1.0), path.at(2.0)), ([1.0, 0.0, 0.0], [1.0, 4.0, 0.0]));
    }

    #[test]
    fn a_closed_path_ends_where_it_starts_without_a_corner() {
        let ring = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]];
        for given in [&ring[..], &[ring[0], ring[1], ring[2], ring[3], ring[0]]] {
            let path = Path::new(given, true);
            assert!(is_near(path.at(0.0), path.at(1.0)) && is_near(path.at(0.5), ring[2]));
            let (before, after) = (path.at(0.999), path.at(0.001));
            assert!((before[0] - after[0]).abs() < 1e-4, "{before:?} {after:?}");
        }
    }
}
