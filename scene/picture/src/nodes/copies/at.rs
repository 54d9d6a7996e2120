//! The forms in which placements are written: a list, columns, a grid, a ring, or along a line.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::placement::{Placement, Placements};
use crate::kinds::NodeError;
use crate::limits::{MAX_LENGTH, MAX_NODES};
use crate::materials::MaterialRef;
use crate::real::{Vec3, vec3};
use crate::seek::{FrameTime, Seek, SeekError};
use crate::values::{
    ConstantCoordinate, ConstantDegrees, ConstantLengthOrZero, ConstantScale, integer_in_range, sin_cos_degrees,
};

/// A point whose numbers are the same in all frames.
type ConstantPoint = [ConstantCoordinate; 3];

/// Placements of copies, as written. All numbers are the same in all frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum AtPlacements {
    /// Each placement.
    List(#[serde(serialize_with = "all")] Placements),
    /// On a grid.
    Grid(GridPlacements),
    /// In a ring.
    Ring(RingPlacements),
    /// Along a line.
    Along(LinePlacements),
}

fn all<S: serde::Serializer>(placements: &Placements, serializer: S) -> Result<S::Ok, S::Error> {
    placements.all().serialize(serializer)
}

/// Placements on a grid, centered on the origin.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GridPlacements {
    /// Number of copies along x, y and z.
    grid: [PlacementCount; 3],
    /// The distances between copies along x, y and z, in scene units.
    step: ConstantPoint,
}

/// Placements in a ring about the y axis. The first copy is on the z axis as the shape is; the others are rotated with
/// the ring, so that the side of the shape toward +z faces outward.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RingPlacements {
    /// Number of copies.
    ring: PlacementCount,
    /// Radius of the ring, in scene units.
    radius: ConstantLengthOrZero,
}

/// Placements at equal distances along straight lines from point to point.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LinePlacements {
    /// The points, two or more, in scene units.
    #[schemars(length(min = 2))]
    along: Vec<ConstantPoint>,
    /// Number of copies: the first is at the first point, the last of several at the last point.
    count: PlacementCount,
}

/// Placements by columns, which have the same length. Columns that are left out change nothing.
#[derive(JsonSchema)]
#[schemars(deny_unknown_fields)]
struct PlacementColumns {
    /// Offset of each copy, in scene units.
    by: Option<Vec<ConstantPoint>>,
    /// Angles of each copy in degrees about the fixed x, y and z axes, rotated in this order.
    degrees: Option<Vec<[ConstantDegrees; 3]>>,
    /// Scale factor of each copy.
    scale: Option<Vec<ConstantScale>>,
    /// Material of each copy: a name from `materials`, or one in place.
    material: Option<Vec<MaterialRef>>,
}

/// Placements by formulas of the copy's number `i`, from 0 to n − 1, and of the number of copies `n`.
#[derive(JsonSchema)]
#[schemars(deny_unknown_fields)]
#[expect(dead_code, reason = "only the schema needs it: such placements are a list before they are read")]
struct CountedPlacements {
    /// Number of copies.
    #[schemars(extend("examples" = [12]))]
    count: PlacementCount,
    /// Offset, in scene units.
    #[schemars(extend("default" = [0, 0, 0]))]
    by: Option<ConstantPoint>,
    /// Angles in degrees about the fixed x, y and z axes, rotated in this order.
    #[schemars(extend("default" = [0, 0, 0]))]
    degrees: Option<[ConstantDegrees; 3]>,
    /// Scale factor.
    #[schemars(extend("default" = 1))]
    scale: Option<ConstantScale>,
    /// Material where the shape has none of its own: a name from `materials`, or one in place.
    #[schemars(extend("examples" = [{ "diffuse": { "kd": "#d9481c" } }]))]
    material: Option<MaterialRef>,
}

/// Number of copies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema, Seek)]
pub struct PlacementCount(#[schemars(range(min = 1, max = MAX_NODES))] u32);

impl PlacementCount {
    /// The number.
    pub fn get(self) -> u32 {
        self.0
    }
}

impl<'de> Deserialize<'de> for PlacementCount {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        integer_in_range(deserializer, 1, MAX_NODES as u32, "copies").map(Self)
    }
}

/// The members of all forms but the list.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenForm {
    grid: Option<[PlacementCount; 3]>,
    step: Option<ConstantPoint>,
    ring: Option<PlacementCount>,
    radius: Option<ConstantLengthOrZero>,
    along: Option<Vec<ConstantPoint>>,
    count: Option<PlacementCount>,
    by: Option<Vec<ConstantPoint>>,
    degrees: Option<Vec<[ConstantDegrees; 3]>>,
    scale: Option<Vec<ConstantScale>>,
    material: Option<Vec<MaterialRef>>,
}

const FORMS: &str = "write a list of placements, \"grid\" with \"step\", \"ring\" with \"radius\", \"along\" with \"count\", or columns of \"by\", \"degrees\", \"scale\" and \"material\"";

impl WrittenForm {
    fn read(self) -> Result<AtPlacements, String> {
        let Self { grid, step, ring, radius, along, count, by, degrees, scale, material } = self;
        let has_columns = by.is_some() || degrees.is_some() || scale.is_some() || material.is_some();
        let form = match (grid, step, ring, radius, along, count, has_columns) {
            (Some(grid), Some(step), None, None, None, None, false) => {
                AtPlacements::Grid(GridPlacements { grid, step })
            }
            (None, None, Some(ring), Some(radius), None, None, false) => {
                AtPlacements::Ring(RingPlacements { ring, radius })
            }
            (None, None, None, None, Some(along), Some(count), false) => {
                AtPlacements::Along(LinePlacements { along, count })
            }
            (None, None, None, None, None, None, true) => {
                return PlacementColumns { by, degrees, scale, material }.read();
            }
            _ => return Err(format!("is not one of the forms of placements: {FORMS}")),
        };
        match form.count() {
            count if count > MAX_NODES as u64 => Err(format!("makes {count} copies: make at most {MAX_NODES}")),
            _ => Ok(form),
        }
    }
}

impl PlacementColumns {
    fn read(self) -> Result<AtPlacements, String> {
        let Self { by, degrees, scale, material } = self;
        let lengths = [
            ("by", by.as_ref().map(Vec::len)),
            ("degrees", degrees.as_ref().map(Vec::len)),
            ("scale", scale.as_ref().map(Vec::len)),
            ("material", material.as_ref().map(Vec::len)),
        ];
        let mut given = lengths.into_iter().filter_map(|(name, length)| Some((name, length?)));
        let (first, length) = given.next().unwrap_or(("by", 0));
        if let Some((name, other)) = given.find(|(_, other)| *other != length) {
            return Err(format!(
                "has {length} entries in \"{first}\" and {other} in \"{name}\": give every column one entry for each copy"
            ));
        }
        let mut materials = material.unwrap_or_default().into_iter();
        let copies = (0..length).map(|index| {
            let by = by.as_ref().map_or(vec3(0.0, 0.0, 0.0), |by| point(&by[index]));
            let degrees = degrees.as_ref().map(|degrees| degrees[index].each_ref().map(ConstantDegrees::get));
            let scale = scale.as_ref().map_or(1.0, |scale| scale[index].get());
            Placement::new(by, degrees.unwrap_or_default(), scale).with_material(materials.next())
        });
        listed(copies.collect())
    }
}

fn point([x, y, z]: &ConstantPoint) -> Vec3<f32> {
    vec3(x.get(), y.get(), z.get())
}

fn listed(copies: Vec<Placement>) -> Result<AtPlacements, String> {
    if copies.is_empty() {
        return Err("is empty: write a placement or more".to_owned());
    }
    if copies.len() > MAX_NODES {
        return Err(format!("has {} placements: use at most {MAX_NODES}", copies.len()));
    }
    Ok(AtPlacements::List(Placements::new(copies)))
}

impl AtPlacements {
    /// Number of copies, computed without making them.
    pub fn count(&self) -> u64 {
        match self {
            Self::List(list) => list.all().len() as u64,
            Self::Grid(GridPlacements { grid, .. }) => {
                grid.iter().fold(1, |count: u64, along| count.saturating_mul(along.get().into()))
            }
            Self::Ring(RingPlacements { ring, .. }) => ring.get().into(),
            Self::Along(LinePlacements { count, .. }) => count.get().into(),
        }
    }

    /// Error in its numbers taken together.
    pub fn validate(&self) -> Option<NodeError> {
        match self {
            Self::List(_) | Self::Ring(_) => None,
            Self::Grid(GridPlacements { grid, step }) => {
                let reach = |(count, step): (&PlacementCount, &ConstantCoordinate)| {
                    0.5 * (count.get() - 1) as f32 * step.get().abs()
                };
                let far = grid.iter().zip(step).position(|along| reach(along) > MAX_LENGTH)?;
                let message = format!(
                    "puts copies further than {MAX_LENGTH:e} from the origin: use a smaller step, or fewer copies"
                );
                Some(NodeError::new(format!("step/{far}"), message))
            }
            Self::Along(LinePlacements { along, .. }) => {
                let message = if along.len() < 2 {
                    "needs two points or more: write [[x, y, z], [x, y, z]]"
                } else if along.iter().all(|point| *point == along[0]) {
                    "has no length: give it two points in different places"
                } else {
                    return None;
                };
                Some(NodeError::new("along", message))
            }
        }
    }

    /// The placements of a form that is a formula.
    pub(super) fn computed(&self) -> Placements {
        let upright = |by| Placement::new(by, [0.0; 3], 1.0);
        let all = match self {
            Self::List(list) => list.all().to_vec(),
            Self::Grid(GridPlacements { grid, step }) => {
                let [nx, ny, nz] = grid.map(PlacementCount::get);
                let at = |index: u32, count: u32, step: &ConstantCoordinate| {
                    (index as f32 - 0.5 * (count - 1) as f32) * step.get()
                };
                let copies = (0..nx).flat_map(|x| (0..ny).flat_map(move |y| (0..nz).map(move |z| (x, y, z))));
                let by = copies.map(|(x, y, z)| vec3(at(x, nx, &step[0]), at(y, ny, &step[1]), at(z, nz, &step[2])));
                by.map(upright).collect()
            }
            Self::Ring(RingPlacements { ring, radius }) => {
                let copies = (0..ring.get()).map(|index| 360.0 * index as f32 / ring.get() as f32);
                copies
                    .map(|degrees| {
                        let (s, c) = sin_cos_degrees(degrees);
                        let by = vec3(radius.get() * s, 0.0, radius.get() * c);
                        Placement::new(by, [0.0, degrees, 0.0], 1.0)
                    })
                    .collect()
            }
            Self::Along(LinePlacements { along, count }) => {
                let points: Vec<Vec3<f32>> = along.iter().map(point).collect();
                evenly_along(&points, count.get()).into_iter().map(upright).collect()
            }
        };
        Placements::new(all)
    }
}

/// `count` points at equal distances along lines from point to point.
fn evenly_along(points: &[Vec3<f32>], count: u32) -> Vec<Vec3<f32>> {
    let lengths: Vec<f64> = points.windows(2).map(|ends| f64::from((ends[1] - ends[0]).length())).collect();
    let whole: f64 = lengths.iter().sum();
    let (mut line, mut before) = (0, 0.0);
    if points.is_empty() {
        return vec![vec3(0.0, 0.0, 0.0)];
    }
    (0..count)
        .map(|index| {
            let way = whole * f64::from(index) / f64::from((count - 1).max(1));
            while line + 1 < lengths.len() && way > before + lengths[line] {
                before += lengths[line];
                line += 1;
            }
            let (start, end) = (points[line], points[(line + 1).min(points.len() - 1)]);
            let fraction =
                lengths.get(line).filter(|length| **length > 0.0).map_or(0.0, |length| (way - before) / length);
            (end - start) * (fraction.clamp(0.0, 1.0) as f32) + start
        })
        .collect()
}

/// The same in all frames.
impl Seek for AtPlacements {
    fn seek(&mut self, _: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        Ok(false)
    }
}

/// Deserializes a list of placements, or an object of another form.
struct AtVisitor;

impl<'de> Visitor<'de> for AtVisitor {
    type Value = AtPlacements;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of placements, a grid, a ring, a line or columns")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> Result<AtPlacements, A::Error> {
        let mut copies = Vec::new();
        while let Some(copy) = entries.next_element()? {
            copies.push(copy);
        }
        listed(copies).map_err(A::Error::custom)
    }

    fn visit_map<A: MapAccess<'de>>(self, form: A) -> Result<AtPlacements, A::Error> {
        WrittenForm::deserialize(MapAccessDeserializer::new(form))?.read().map_err(A::Error::custom)
    }
}

impl<'de> Deserialize<'de> for AtPlacements {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(AtVisitor)
    }
}

impl JsonSchema for AtPlacements {
    fn schema_name() -> Cow<'static, str> {
        "AtPlacements".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let placement = generator.subschema_for::<Placement>();
        json_schema!({
            "description": "Placements of copies, the same in all frames: a list, a grid, a ring, along a line, by columns, or counted.",
            "anyOf": [
                { "type": "array", "items": placement, "minItems": 1, "maxItems": MAX_NODES },
                generator.subschema_for::<GridPlacements>(),
                generator.subschema_for::<RingPlacements>(),
                generator.subschema_for::<LinePlacements>(),
                generator.subschema_for::<PlacementColumns>(),
                generator.subschema_for::<CountedPlacements>()
            ]
        })
    }
}
