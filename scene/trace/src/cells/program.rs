//! A scene cut into leaves, and the operations above them in the order in which they are computed.

pub(super) mod contents;
mod cutter;

use std::collections::HashMap;

use self::cutter::Cutter;
use super::materials::{LeafMaterial, ListedMaterial, MAX_MATERIALS};
use crate::bounds::Bounds;
use crate::materials::MaterialRef;
use crate::nodes::{Distance, Node, Part, Placements, SdfValue, smooth_min};
use crate::real::list::{IS_LAST, IS_UNARY, NO_LEAF, ROW_BITS, ROW_MASK};
use crate::real::{Real, Vec3};
use crate::scene::Scene;
use crate::values::LengthOrZero;

/// Maximum number of families: each is a function of the compiled text.
pub(super) const MAX_FAMILIES: usize = 48;
/// Maximum number of values that wait for a join.
pub(super) const MAX_STACK: usize = 10;

/// A scene's leaves, their families and rows, and the operations above them.
#[derive(Clone, Debug)]
pub struct Program<'a> {
    leaves: Vec<Leaf<'a>>,
    /// A leaf of each family.
    families: Vec<usize>,
    /// The formula of each family.
    texts: Vec<Vec<u32>>,
    joins: Vec<Join>,
    /// A join of each kind that occurs.
    join_families: Vec<usize>,
    /// The formula of each kind of join.
    join_texts: Vec<Vec<u32>>,
    depth: usize,
    /// First word of each leaf's row.
    leaf_rows: Vec<u32>,
    /// First words of a scene's table: rows, each after the index of its leaf or join. A leaf's begins with the index of
    /// its object.
    rows: Vec<u32>,
    /// The list of all operations.
    list: Vec<u32>,
    /// Materials of the objects that have several.
    materials: Vec<ListedMaterial>,
    /// Whether some leaf is moved.
    is_moved: bool,
}

/// A shape below the outermost joins.
#[derive(Clone, Debug)]
pub(super) struct Leaf<'a> {
    /// Transforms and placements of the shape, the outermost first.
    above: Vec<Above<'a>>,
    shape: Part<'a>,
    /// The same one frame later, if its motion is wanted.
    next: Option<NextLeaf<'a>>,
    bounds: Bounds,
    /// Its Lipschitz factor, if one holds everywhere.
    lipschitz: Option<f32>,
    /// Index of its object.
    pub(super) object: usize,
    /// Its material.
    pub(super) material: LeafMaterial,
    /// Index of its family.
    pub(super) family: usize,
    /// Id of its object, if that is wanted.
    pub(super) id: Option<u32>,
    /// Its numbers, the id the last.
    pub(super) numbers: Vec<u32>,
}

/// A leaf in the next frame.
#[derive(Clone, Debug)]
pub(super) struct NextLeaf<'a> {
    pub(super) above: Vec<Above<'a>>,
    pub(super) shape: Part<'a>,
}

/// Transform between a leaf and the scene.
#[derive(Clone, Copy, Debug)]
pub(super) enum Above<'a> {
    /// A transform.
    Node(&'a Node),
    /// A placement of a copy, by its index, which scales no distance.
    Copy(&'a Placements, usize),
}

impl Above<'_> {
    pub(super) fn to_child<R: Real>(self, p: Vec3<R>) -> Vec3<R> {
        match self {
            Self::Node(node) => node.to_child(p),
            Self::Copy(placements, index) => placements.to_shape(index, p),
        }
    }

    fn bounds_from_child(self, bounds: Bounds) -> Bounds {
        match self {
            Self::Node(node) => node.bounds_from_child(bounds),
            Self::Copy(placements, index) => placements.to_copy(index, bounds),
        }
    }

    /// Slot of the material that it gives to what has none.
    pub(super) fn material(self) -> Option<u32> {
        let material = match self {
            Self::Node(node) => node.material(),
            Self::Copy(placements, index) => placements.all()[index].material(),
        };
        material.map(MaterialRef::slot)
    }

    /// Lipschitz factor of the placement: by how much it makes motions longer in the shape's space.
    fn lipschitz(self) -> f32 {
        match self {
            Self::Node(_) => 1.0,
            Self::Copy(placements, index) => 1.0 / placements.scale(index).unwrap_or(1.0),
        }
    }
}

/// An operation on the values of leaves.
#[derive(Clone, Debug)]
struct Join {
    kind: JoinKind,
    family: usize,
    numbers: Vec<u32>,
}

/// Kind of a join.
#[derive(Clone, Debug)]
pub(super) enum JoinKind {
    /// The smooth or sharp minimum of two values.
    Union(LengthOrZero),
    /// The lesser of two objects' values.
    Objects,
    /// A value by a factor.
    Scale(f32),
}

/// A step of a program: takes the value of a leaf, or the last value that waits, and joins it with the value that waits
/// before it.
#[derive(Clone, Copy, Debug)]
struct Operation {
    leaf: Option<u32>,
    join: Option<u32>,
}

impl<'a> Program<'a> {
    /// Cuts objects of a scene, each given by its index and the factor of its distance, at their outermost joins. `None`
    /// if they have too many families or materials, or joins nested too deeply.
    pub fn new(scene: &'a Scene, objects: &[(usize, Option<f32>)]) -> Option<Self> {
        Self::with_layers(scene, None, None, objects)
    }

    /// The same, also with the motion of the surfaces if the scene is given as it is one frame later, and with the ids of
    /// the objects if they are given by index.
    pub(crate) fn with_layers(
        scene: &'a Scene,
        next: Option<&'a Scene>,
        ids: Option<&[u32]>,
        objects: &[(usize, Option<f32>)],
    ) -> Option<Self> {
        let cutter = Cutter::new(scene, next, ids, objects);
        let depth = depth(&cutter.operations, &cutter.joins);
        let is_small =
            cutter.family_leaves.len() <= MAX_FAMILIES && cutter.slots.len() <= MAX_MATERIALS && depth <= MAX_STACK;
        // So that scenes of many and of more shapes have one text.
        let depth = if depth > 2 { MAX_STACK } else { depth };
        let mut rows = Vec::new();
        let mut row = |index: usize, object: Option<usize>, numbers: &[u32]| {
            rows.push(index as u32);
            let start = rows.len() as u32;
            rows.extend(object.map(|object| (object as f32).to_bits()));
            rows.extend(numbers);
            start
        };
        let leaves = cutter.leaves.iter().enumerate();
        let leaf_rows: Vec<u32> = leaves.map(|(index, leaf)| row(index, Some(leaf.object), &leaf.numbers)).collect();
        let joins = cutter.joins.iter().enumerate();
        let join_rows: Vec<u32> = joins.map(|(index, join)| row(index, None, &join.numbers)).collect();
        if !is_small || cutter.operations.is_empty() || rows.len() > ROW_MASK as usize {
            return None;
        }
        let mut list: Vec<u32> = Vec::with_capacity(2 * cutter.operations.len());
        for operation in &cutter.operations {
            let leaf = operation.leaf.map_or(NO_LEAF << ROW_BITS, |leaf| {
                (cutter.leaves[leaf as usize].family as u32) << ROW_BITS | leaf_rows[leaf as usize]
            });
            let join = operation.join.map_or(0, |join| {
                let Join { family, kind, .. } = &cutter.joins[join as usize];
                let unary = if kind.is_unary() { IS_UNARY } else { 0 };
                unary | (*family as u32 + 1) << ROW_BITS | join_rows[join as usize]
            });
            list.extend([leaf, join]);
        }
        let last = list.len() - 2;
        list[last] |= IS_LAST;
        Some(Self {
            materials: cutter.listed_materials(),
            is_moved: cutter.is_moved,
            leaf_rows,
            rows,
            list,
            leaves: cutter.leaves,
            texts: by_index(cutter.texts),
            families: cutter.family_leaves,
            joins: cutter.joins,
            join_texts: by_index(cutter.join_texts),
            join_families: cutter.family_joins,
            depth,
        })
    }

    /// Materials of the objects that have several.
    pub(super) fn materials(&self) -> &[ListedMaterial] {
        &self.materials
    }

    /// Whether an object has several materials.
    pub(crate) fn has_materials(&self) -> bool {
        !self.materials.is_empty()
    }

    /// Whether some leaf is moved.
    pub(super) fn is_moved(&self) -> bool {
        self.is_moved
    }

    /// Number of leaves.
    pub fn leaf_count(&self) -> usize {
        self.leaves.len()
    }

    /// Number of families.
    pub fn family_count(&self) -> usize {
        self.families.len()
    }

    /// Number of nodes of one leaf of each family.
    pub(crate) fn family_nodes(&self) -> u32 {
        let nodes = |&leaf: &usize| self.leaves[leaf].above.len() as u32 + self.leaves[leaf].shape.node().node_count();
        self.families.iter().map(nodes).sum()
    }

    /// Number of kinds of joins.
    pub(super) fn join_family_count(&self) -> usize {
        self.join_families.len()
    }

    /// The first words of the scene's table: all rows.
    pub fn rows(&self) -> &[u32] {
        &self.rows
    }

    /// The list of all operations.
    pub(super) fn list(&self) -> &[u32] {
        &self.list
    }

    /// The list of a leaf alone.
    pub fn list_of(&self, leaf: u32) -> [u32; 2] {
        [IS_LAST | (self.leaves[leaf as usize].family as u32) << ROW_BITS | self.leaf_rows[leaf as usize], 0]
    }

    /// The leaf with a row; the first of a family where rows are not known.
    pub(super) fn leaf_at(&self, family: usize, row: Option<u32>) -> &Leaf<'a> {
        &self.leaves[row.map_or(self.families[family], |row| self.rows[row as usize - 1] as usize)]
    }

    /// The join with a row; the first of a family where rows are not known.
    pub(super) fn join_at(&self, family: usize, row: Option<u32>) -> &JoinKind {
        &self.joins[row.map_or(self.join_families[family], |row| self.rows[row as usize - 1] as usize)].kind
    }

    pub(super) fn leaves(&self) -> &[Leaf<'a>] {
        &self.leaves
    }

    pub(super) fn joins(&self) -> impl Iterator<Item = &JoinKind> {
        self.joins.iter().map(|join| &join.kind)
    }

    /// Maximum number of values that wait for a join.
    pub(super) fn depth(&self) -> usize {
        self.depth
    }
}

impl Leaf<'_> {
    /// Its distance at a point of the scene.
    pub(super) fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let p = self.above.iter().fold(p, |p, node| node.to_child(p));
        self.shape.distance(p)
    }

    /// Its value at a point of its shape.
    pub(super) fn sample<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>) -> V {
        self.shape.sample(p)
    }

    /// Its shape.
    pub(super) fn shape(&self) -> Part<'_> {
        self.shape
    }

    /// The same leaf one frame later, if its motion is wanted.
    pub(super) fn next(&self) -> Option<&NextLeaf<'_>> {
        self.next.as_ref()
    }

    /// Transforms and placements of its shape, the outermost first.
    pub(super) fn above(&self) -> &[Above<'_>] {
        &self.above
    }

    /// Box that contains every point of its shape.
    pub(super) fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Its Lipschitz factor, if one holds everywhere.
    pub(super) fn lipschitz(&self) -> Option<f32> {
        self.lipschitz
    }

    /// Box that contains every point whose distance is at most `isolevel`.
    pub(super) fn bounds_of(&self, isolevel: f32) -> Bounds {
        self.above.iter().rev().fold(self.shape.bounds(isolevel), |bounds, node| node.bounds_from_child(bounds))
    }
}

impl JoinKind {
    /// Joins the value that waits, and the new one. A factor applies to the new one.
    pub(super) fn apply<R: Real>(&self, below: R, value: R) -> R {
        match self {
            Self::Union(smooth) => smooth_min(Distance(below), Distance(value), smooth).0,
            Self::Objects => below.min(value),
            Self::Scale(by) => value * value.uniform(*by),
        }
    }

    /// Whether it joins objects.
    pub(super) fn is_of_objects(&self) -> bool {
        matches!(self, Self::Objects)
    }

    /// Whether it takes one value, and not one that waits.
    pub(super) fn is_unary(&self) -> bool {
        matches!(self, Self::Scale(_))
    }
}

/// The keys of a map to indices, by their index.
fn by_index(indices: HashMap<Vec<u32>, usize>) -> Vec<Vec<u32>> {
    let mut all = vec![Vec::new(); indices.len()];
    for (text, index) in indices {
        all[index] = text;
    }
    all
}

/// Number of values that wait for a join, at most.
fn depth(operations: &[Operation], joins: &[Join]) -> usize {
    let (mut waiting, mut most) = (0_usize, 0);
    for operation in operations {
        let is_binary = operation.join.is_some_and(|join| !joins[join as usize].kind.is_unary());
        waiting = waiting + usize::from(operation.leaf.is_some()) - usize::from(is_binary);
        most = most.max(waiting);
    }
    most
}
