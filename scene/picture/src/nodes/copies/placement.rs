//! Placements: position, rotation, size and material of each copy of a shape.
//!
//! A copy's distance is bit-identical to that of the shape in a `scale`, a `rotate` and a `translate`.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::bounds::Bounds;
use crate::materials::MaterialRef;
use crate::nodes::SdfValue;
use crate::nodes::rotations::{rotated, transposed};
use crate::real::{Real, Vec3, vec3};
use crate::seek::{FrameTime, Seek, SeekError};
use crate::values::{ConstantCoordinate, ConstantDegrees, ConstantScale, inverse_rows_of};

/// Placement of one copy, the same in all frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Placement {
    by: Vec3<f32>,
    degrees: [f32; 3],
    scale: f32,
    /// Rows of the inverse rotation's matrix.
    inverse_rows: [Vec3<f32>; 3],
    material: Option<MaterialRef>,
}

/// Placement of one copy, the same in all frames: the shape is scaled, then rotated, then moved.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(rename = "Placement", deny_unknown_fields)]
struct WrittenPlacement {
    /// Offset, in scene units.
    #[serde(default = "no_offset", skip_serializing_if = "is_no_offset")]
    #[schemars(extend("default" = [0, 0, 0]))]
    by: [ConstantCoordinate; 3],
    /// Angles in degrees about the fixed x, y and z axes, rotated in this order.
    #[serde(default = "no_rotation", skip_serializing_if = "is_no_rotation")]
    #[schemars(extend("default" = [0, 0, 0]))]
    degrees: [ConstantDegrees; 3],
    /// Scale factor.
    #[serde(default = "no_scale", skip_serializing_if = "is_no_scale")]
    #[schemars(extend("default" = 1))]
    scale: ConstantScale,
    /// Material of this copy where the shape has none of its own: a name from `materials`, or one in place. A texture
    /// is fixed in the space around the copies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    material: Option<MaterialRef>,
}

fn no_offset() -> [ConstantCoordinate; 3] {
    [0.0; 3].map(|c| ConstantCoordinate::new(c).expect("0 is in range"))
}

fn is_no_offset(by: &[ConstantCoordinate; 3]) -> bool {
    by.iter().all(ConstantCoordinate::is_zero)
}

fn no_rotation() -> [ConstantDegrees; 3] {
    [0.0; 3].map(|angle| ConstantDegrees::new(angle).expect("0 is in range"))
}

fn is_no_rotation(degrees: &[ConstantDegrees; 3]) -> bool {
    degrees.iter().all(ConstantDegrees::is_zero)
}

fn no_scale() -> ConstantScale {
    ConstantScale::new(1.0).expect("1 is in range")
}

#[expect(clippy::float_cmp, reason = "only exactly 1 changes nothing")]
fn is_no_scale(scale: &ConstantScale) -> bool {
    scale.get() == 1.0
}

impl Placement {
    /// A placement at an offset, with angles in degrees about the x, y and z axes, and a scale, all in range.
    pub fn new(by: Vec3<f32>, degrees: [f32; 3], scale: f32) -> Self {
        // No key depends on the sign of a zero.
        let (by, degrees) = (by.map(|c| c + 0.0), degrees.map(|angle| angle + 0.0));
        Self { by, degrees, scale, inverse_rows: inverse_rows_of(degrees), material: None }
    }

    /// Its height above the origin.
    pub fn height(&self) -> f32 {
        self.by.y
    }

    /// The same placement with a material.
    pub(super) fn with_material(self, material: Option<MaterialRef>) -> Self {
        Self { material, ..self }
    }

    /// The material of the copy, if it has one of its own.
    pub fn material(&self) -> Option<&MaterialRef> {
        self.material.as_ref()
    }

    pub(super) fn material_mut(&mut self) -> Option<&mut MaterialRef> {
        self.material.as_mut()
    }
}

impl From<WrittenPlacement> for Placement {
    fn from(written: WrittenPlacement) -> Self {
        let WrittenPlacement { by: [x, y, z], degrees, scale, material } = written;
        let degrees = degrees.map(|angle| angle.get());
        Self::new(vec3(x.get(), y.get(), z.get()), degrees, scale.get()).with_material(material)
    }
}

impl<'de> Deserialize<'de> for Placement {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        WrittenPlacement::deserialize(deserializer).map(Self::from)
    }
}

impl Serialize for Placement {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let coordinate = |c| ConstantCoordinate::new(c).expect("an offset is in range");
        WrittenPlacement {
            by: <[f32; 3]>::from(self.by).map(coordinate),
            degrees: self.degrees.map(|angle| ConstantDegrees::new(angle).expect("an angle is in range")),
            scale: ConstantScale::new(self.scale).expect("a scale is in range"),
            material: self.material.clone(),
        }
        .serialize(serializer)
    }
}

impl JsonSchema for Placement {
    fn schema_name() -> Cow<'static, str> {
        "Placement".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        WrittenPlacement::json_schema(generator)
    }
}

/// The same in all frames; its material is evaluated in its slot.
impl Seek for Placement {
    fn seek(&mut self, _: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        Ok(false)
    }
}

/// Placements of copies, one or more.
#[derive(Clone, Debug, PartialEq)]
pub struct Placements {
    all: Vec<Placement>,
    /// Whether any copy is rotated. If none is, the formula leaves the rotation out of all of them.
    has_rotation: bool,
    /// Whether any copy is scaled.
    has_scale: bool,
}

impl Placements {
    /// A list of placements.
    #[expect(clippy::float_cmp, reason = "only exactly 1 changes nothing")]
    pub fn new(all: Vec<Placement>) -> Self {
        let has_rotation = all.iter().any(|copy| copy.degrees != [0.0; 3]);
        let has_scale = all.iter().any(|copy| copy.scale != 1.0);
        Self { all, has_rotation, has_scale }
    }

    /// The placements.
    pub fn all(&self) -> &[Placement] {
        &self.all
    }

    /// Mutable access to their materials.
    pub(super) fn materials_mut(&mut self) -> Vec<(Option<usize>, &mut MaterialRef)> {
        let all = self.all.iter_mut().enumerate();
        all.filter_map(|(index, copy)| Some((Some(index), copy.material_mut()?))).collect()
    }

    /// Scale of a copy, if any copy is scaled.
    pub fn scale(&self, index: usize) -> Option<f32> {
        self.has_scale.then_some(self.all[index].scale)
    }

    /// Point of the shape that a copy has at `p`.
    pub fn to_shape<R: Real>(&self, index: usize, p: Vec3<R>) -> Vec3<R> {
        let Placement { by, scale, inverse_rows, .. } = &self.all[index];
        let mut q = p - Vec3::uniform(p.x, *by);
        if self.has_rotation {
            q = rotated(q, *inverse_rows);
        }
        if self.has_scale { q * p.x.uniform(1.0 / scale) } else { q }
    }

    /// Direction around a copy of one in its shape's space.
    fn direction_from_shape<R: Real>(&self, index: usize, v: Vec3<R>) -> Vec3<R> {
        let Placement { scale, inverse_rows, .. } = &self.all[index];
        let mapped_outward = if self.has_rotation { rotated(v, transposed(*inverse_rows)) } else { v };
        if self.has_scale { mapped_outward * v.x.uniform(*scale) } else { mapped_outward }
    }

    /// Value at `p` of a copy of a shape, given the shape's value at a point.
    pub fn sample<R: Real, V: SdfValue<R>>(&self, index: usize, shape: impl FnOnce(Vec3<R>) -> V, p: Vec3<R>) -> V {
        let mut value = shape(self.to_shape(index, p)).mapped_outward(|way| self.direction_from_shape(index, way));
        if let Some(scale) = self.scale(index) {
            let distance = value.distance() * p.x.uniform(scale);
            value = value.with_distance(distance);
        }
        let material = &self.all[index].material;
        match material {
            Some(material) => value.paint(material.slot(), p),
            None => value,
        }
    }

    /// Bounds of a copy, given the shape's bounds for an isolevel.
    pub fn bounds_of(&self, index: usize, isolevel: f32, shape: impl Fn(f32) -> Bounds) -> Bounds {
        self.to_copy(index, shape(isolevel / self.all[index].scale))
    }

    /// Bounds of a copy, given the shape's bounds.
    pub fn to_copy(&self, index: usize, shape: Bounds) -> Bounds {
        let Placement { by, scale, inverse_rows, .. } = &self.all[index];
        shape.scaled(*scale).rotated(*inverse_rows).translated(*by)
    }

    /// Bounds of each copy, given the shape's bounds for an isolevel.
    pub fn bounds(&self, isolevel: f32, shape: impl Fn(usize, f32) -> Bounds) -> impl Iterator<Item = Bounds> {
        (0..self.all.len()).map(move |index| self.bounds_of(index, isolevel, |own| shape(index, own)))
    }
}
