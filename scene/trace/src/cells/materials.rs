//! Materials of objects that have several: their weights at a point, by the lists of cells.
//!
//! Where a list leaves a shape out, the shape's weight in every seam is exactly 0. So the weights are as of the whole
//! scene, bit for bit, as distances are.

use super::program::{JoinKind, Leaf};
use super::walk::function_names;
use super::{Cells, Program};
use crate::nodes::{DistanceWithMaterials, MaterialWeight, SdfValue, union_weight};
use crate::real::list::ListFunctions;
use crate::real::{Bundle, FunctionKey, Merge, Real, Vec3, bundle, vec3};

/// Maximum number of materials of objects that have several: each is a part of every value that a list joins.
pub(super) const MAX_MATERIALS: usize = 64;

function_names![MATERIAL_LEAVES "leaf_of_materials_", MATERIAL_JOINS "join_of_materials_"];

/// A material of an object that has several.
#[derive(Clone, Copy, Debug)]
pub(super) struct ListedMaterial {
    pub(super) slot: u32,
    /// Whether it has a texture, which needs the point in its own space.
    pub(super) is_textured: bool,
}

/// Material of a leaf.
#[derive(Clone, Copy, Debug)]
pub(super) enum LeafMaterial {
    /// The only one of its object.
    OfObject,
    /// The one in this slot, without a texture. The slot is a number of the leaf's row.
    Single(u32),
    /// Any others, where the object's own is in this slot.
    Mixed(u32),
}

/// Weight of a material, and the point in the space of its texture.
#[derive(Clone, Copy, Debug)]
struct Weighted<R> {
    weight: R,
    point: Option<Vec3<R>>,
}

bundle!(Weighted { weight, point });

/// Weights of the materials that a program lists, in its order.
#[derive(Clone, Copy, Debug)]
struct Weights<R>([Option<Weighted<R>>; MAX_MATERIALS]);

impl<R: Real> Bundle<R> for Weights<R> {
    fn merge(self, other: Self, how: &mut impl Merge<R>) -> Self {
        let mut others = other.0.into_iter();
        Self(self.0.map(|own| own.merge(others.next().flatten(), how)))
    }
}

/// A distance with the weights of materials.
#[derive(Clone, Copy, Debug)]
struct Surface<R> {
    distance: R,
    weights: Weights<R>,
}

bundle!(Surface { distance, weights });

/// Functions of a program's lists that also give the weights of materials.
#[derive(Clone, Copy, Debug)]
struct MaterialLists<'a, 'b>(&'a Program<'b>);

impl Leaf<'_> {
    /// Materials at a point of the scene, given the slot of the object's own.
    fn weights<R: Real>(&self, own: u32, p: Vec3<R>) -> Vec<MaterialWeight<R>> {
        let mut points = vec![p];
        for above in self.above() {
            points.push(above.to_child(points[points.len() - 1]));
        }
        let value: DistanceWithMaterials<R> = self.sample(points[points.len() - 1]);
        let above = self.above().iter().zip(points).rev();
        let value = above.fold(value, |value, (above, p)| match above.material() {
            Some(slot) => value.paint(slot, p),
            None => value,
        });
        value.paint(own, p).weights().to_vec()
    }

    /// Slots of its materials, given that of the object's own.
    pub(super) fn slots(&self, own: u32) -> Vec<u32> {
        // They are the same at every point.
        self.weights(own, vec3(0.0_f32, 0.0, 0.0)).iter().map(|weight| weight.slot.unwrap_or(own)).collect()
    }

    /// Its materials at a point, if its object has several, each with its slot as a number.
    pub(super) fn weights_by_slot<R: Real>(&self, p: Vec3<R>) -> Vec<(R, MaterialWeight<R>)> {
        let by_slot = |weight: MaterialWeight<R>, own: u32| (p.x.uniform(weight.slot.unwrap_or(own) as f32), weight);
        match self.material {
            LeafMaterial::OfObject => Vec::new(),
            LeafMaterial::Single(slot) => {
                vec![by_slot(MaterialWeight { slot: Some(slot), weight: p.x.constant(1.0), point: p }, slot)]
            }
            LeafMaterial::Mixed(own) => self.weights(own, p).into_iter().map(|weight| by_slot(weight, own)).collect(),
        }
    }
}

impl Program<'_> {
    /// No material at a point.
    fn no_weights<R: Real>(&self, p: Vec3<R>) -> Weights<R> {
        let mut none = [None; MAX_MATERIALS];
        for (weight, material) in none.iter_mut().zip(self.materials()) {
            *weight = Some(Weighted { weight: p.x.constant(0.0), point: material.is_textured.then_some(p) });
        }
        Weights(none)
    }
}

impl<R: Real> ListFunctions<R> for MaterialLists<'_, '_> {
    type Value = Surface<R>;

    fn leaf_names(&self) -> &[&'static str] {
        &MATERIAL_LEAVES[..self.0.family_count()]
    }

    fn join_names(&self) -> &[&'static str] {
        &MATERIAL_JOINS[..self.0.join_family_count()]
    }

    fn depth(&self) -> usize {
        self.0.depth()
    }

    fn leaf(&self, family: usize, row: Option<u32>, p: Vec3<R>) -> Surface<R> {
        let leaf = self.0.leaf_at(family, row);
        p.x.uniform(leaf.object as f32);
        let distance = leaf.distance(p);
        let mut weights = self.0.no_weights(p);
        for (slot, of_leaf) in leaf.weights_by_slot(p) {
            for (weight, material) in weights.0.iter_mut().flatten().zip(self.0.materials()) {
                let is_it = (slot - material.slot as f32).abs().below(0.5);
                weight.weight = R::select(is_it, of_leaf.weight, weight.weight);
                weight.point = weight.point.map(|point| Vec3::select(is_it, of_leaf.point, point));
            }
        }
        Surface { distance, weights }
    }

    fn join(&self, family: usize, row: Option<u32>, below: Surface<R>, value: Surface<R>) -> Surface<R> {
        let kind = self.0.join_at(family, row);
        let distance = kind.apply(below.distance, value.distance);
        let second = kind.second_weight(below.distance, value.distance);
        let first = second.constant(1.0) - second;
        let mut weights = below.weights;
        for (weight, value) in weights.0.iter_mut().flatten().zip(value.weights.0.iter().flatten()) {
            let (of_first, of_second) = (weight.weight * first, value.weight * second);
            let points = weight.point.zip(value.point);
            let point = points.map(|(first, second)| Vec3::select(of_first.lt(of_second), second, first));
            *weight = Weighted { weight: of_first + of_second, point };
        }
        Surface { distance, weights }
    }
}

impl JoinKind {
    /// Weight of the second of two values, 0 to 1.
    pub(super) fn second_weight<R: Real>(&self, below: R, value: R) -> R {
        match self {
            Self::Union(smooth) => union_weight(below, value, smooth),
            Self::Objects => R::select(value.lt(below), value.constant(1.0), value.constant(0.0)),
            Self::Scale(_) => value.constant(1.0),
        }
    }
}

impl Cells<'_> {
    /// Weights at a point of the materials of objects that have several; 0 where the nearest object has one.
    pub fn material_weights<R: Real>(&self, p: Vec3<R>) -> Vec<MaterialWeight<R>> {
        let weights =
            p.x.call(FunctionKey::new("materials"), p, |p| self.listed_weights(self.list(&self.locate(p)), p));
        let of_material = |(weighted, material): (Weighted<R>, &ListedMaterial)| MaterialWeight {
            slot: Some(material.slot),
            weight: weighted.weight,
            point: weighted.point.unwrap_or(p),
        };
        weights.0.into_iter().flatten().zip(self.program().materials()).map(of_material).collect()
    }

    fn listed_weights<R: Real>(&self, list: R, p: Vec3<R>) -> Weights<R> {
        R::fold(self.tree().words(), list.to_bits(), p, &MaterialLists(self.program())).weights
    }

    /// The same weights and points by the list of all operations. For tests.
    pub fn whole_material_weights(&self, p: Vec3<f32>) -> Vec<(f32, Option<Vec3<f32>>)> {
        let weights = self.listed_weights(f32::from_bits(self.tree().whole), p);
        weights.0.into_iter().flatten().map(|Weighted { weight, point }| (weight, point)).collect()
    }
}
