//! Cuts objects at their joins, and finds the families of the leaves.

use std::collections::{BTreeSet, HashMap};

use super::{Above, Join, JoinKind, Leaf, NextLeaf, Operation};
use crate::bounds::Bounds;
use crate::cells::materials::{LeafMaterial, ListedMaterial};
use crate::cells::trace::{Symbol, Trace, trace};
use crate::kinds::Exactness;
use crate::materials::Material;
use crate::nodes::{Cut, FoldStep, Node, Part, for_each_step};
use crate::real::vec3;
use crate::scene::Scene;

/// Whether a shape is a union of several, moved or not.
fn is_union(shape: &Node) -> bool {
    match shape.cut() {
        Cut::Leaf => false,
        Cut::Child(child) => is_union(child),
        Cut::Union(_, parts) => parts.len() > 1,
    }
}

/// Cuts the objects of a scene.
#[derive(Default)]
pub(super) struct Cutter<'a> {
    /// Materials of the scene.
    materials: &'a [Material],
    /// Whether some object has several materials.
    has_painted: bool,
    /// Index of the object that is cut.
    object: usize,
    /// Its id, if that is wanted.
    id: Option<u32>,
    /// Slot of its own material, if it has others, too.
    painted: Option<u32>,
    /// Slots of the materials of objects that have several.
    pub(super) slots: BTreeSet<u32>,
    above: Vec<Above<'a>>,
    /// The leaves in the next frame, if motion is wanted.
    next_leaves: Option<Vec<NextLeaf<'a>>>,
    /// Whether some leaf is moved.
    pub(super) is_moved: bool,
    pub(super) leaves: Vec<Leaf<'a>>,
    pub(super) joins: Vec<Join>,
    pub(super) operations: Vec<Operation>,
    pub(super) texts: HashMap<Vec<u32>, usize>,
    pub(super) family_leaves: Vec<usize>,
    pub(super) join_texts: HashMap<Vec<u32>, usize>,
    join_rows: HashMap<(usize, Vec<u32>), u32>,
    pub(super) family_joins: Vec<usize>,
}

impl<'a> Cutter<'a> {
    /// Cuts objects, each given by its index and the factor of its distance.
    pub(super) fn new(
        scene: &'a Scene,
        next: Option<&'a Scene>,
        ids: Option<&[u32]>,
        objects: &[(usize, Option<f32>)],
    ) -> Self {
        let is_painted = |index: usize| scene.objects[index].shape.has_own_materials();
        let as_next = |Leaf { above, shape, .. }: Leaf<'a>| NextLeaf { above, shape };
        let mut cutter = Self {
            materials: scene.used_materials(),
            has_painted: objects.iter().any(|&(index, _)| is_painted(index)),
            // The same nodes are cut in the same order.
            next_leaves: next
                .map(|next| Self::new(next, None, None, objects).leaves.into_iter().map(as_next).collect()),
            ..Self::default()
        };
        for (index, &(number, scale)) in objects.iter().enumerate() {
            let object = &scene.objects[number];
            cutter.object = number;
            cutter.id = ids.map(|ids| ids[number]);
            cutter.painted = is_painted(number).then_some(object.material.slot());
            let join = (index > 0).then_some(&JoinKind::Objects);
            match scale {
                Some(scale) => {
                    cutter.cut(&object.shape, None);
                    cutter.join(&JoinKind::Scale(scale));
                    if let Some(join) = join {
                        cutter.join(join);
                    }
                }
                None => cutter.cut(&object.shape, join),
            }
        }
        cutter
    }

    /// The materials of objects that have several.
    pub(super) fn listed_materials(&self) -> Vec<ListedMaterial> {
        let is_textured = |slot: u32| self.materials[slot as usize].is_textured();
        self.slots.iter().map(|&slot| ListedMaterial { slot, is_textured: is_textured(slot) }).collect()
    }

    /// Adds the operations of a node, whose value is then joined with the one before.
    fn cut(&mut self, node: &'a Node, join: Option<&JoinKind>) {
        match node.cut() {
            Cut::Leaf => self.leaf(Part::Shape(node), join),
            Cut::Child(child) => {
                self.above.push(Above::Node(node));
                self.cut(child, join);
                self.above.pop();
            }
            Cut::Union(smooth, parts) => {
                let seam = &JoinKind::Union(smooth.clone());
                if let [only] = parts[..] {
                    return self.part(only, join);
                }
                for_each_step(&parts, smooth, |step| match step {
                    FoldStep::First(part) => self.part(part, None),
                    FoldStep::Next(part) => self.part(part, Some(seam)),
                    FoldStep::Join => self.join(seam),
                });
                if let Some(join) = join {
                    self.join(join);
                }
            }
        }
    }

    fn part(&mut self, part: Part<'a>, join: Option<&JoinKind>) {
        match part {
            Part::Shape(shape) => self.cut(shape, join),
            Part::Copy(placements, index, shape) if is_union(shape) => {
                self.above.push(Above::Copy(placements, index));
                let scale = placements.scale(index).map(JoinKind::Scale);
                self.cut(shape, join.filter(|_| scale.is_none()));
                self.above.pop();
                if let Some(scale) = scale {
                    self.join(&scale);
                    if let Some(join) = join {
                        self.join(join);
                    }
                }
            }
            Part::Copy(..) => self.leaf(part, join),
        }
    }

    fn leaf(&mut self, shape: Part<'a>, join: Option<&JoinKind>) {
        let (above, bounds) = (self.above.clone(), Bounds::INFINITE);
        let placed: f32 = above.iter().map(|above| above.lipschitz()).product();
        let lipschitz = (shape.node().exactness() != Exactness::Estimate).then(|| shape.node().lipschitz() * placed);
        let (material, object) = (LeafMaterial::OfObject, self.object);
        let next = self.next_leaves.as_ref().map(|leaves| leaves[self.leaves.len()].clone());
        let mut leaf = Leaf {
            above,
            shape,
            next,
            bounds,
            lipschitz,
            object,
            id: self.id,
            material,
            family: 0,
            numbers: Vec::new(),
        };
        leaf.bounds = leaf.bounds_of(0.0);
        if let Some(own) = self.painted {
            let slots = leaf.slots(own);
            leaf.material = match slots[..] {
                [only] if !self.materials[only as usize].is_textured() => LeafMaterial::Single(only),
                _ => LeafMaterial::Mixed(own),
            };
            self.slots.extend(slots);
        }
        let Trace { text, numbers, .. } = trace(|[x, y, z]: [Symbol; 3]| {
            let p = vec3(x, y, z);
            leaf.distance(p);
            leaf.weights_by_slot(p);
            self.is_moved |= leaf.way(p).is_some();
        });
        let next = self.family_leaves.len();
        leaf.family = *self.texts.entry(text).or_insert(next);
        leaf.numbers = numbers;
        leaf.numbers.extend(leaf.id);
        if leaf.family == next {
            self.family_leaves.push(self.leaves.len());
        }
        self.leaves.push(leaf);
        let join = join.map(|kind| self.joined(kind));
        self.operations.push(Operation { leaf: Some(self.leaves.len() as u32 - 1), join });
    }

    fn join(&mut self, kind: &JoinKind) {
        let join = self.joined(kind);
        self.operations.push(Operation { leaf: None, join: Some(join) });
    }

    /// Index of a join; equal joins are one.
    fn joined(&mut self, kind: &JoinKind) -> u32 {
        let Trace { mut text, numbers, .. } = trace(|[below, value]: [Symbol; 2]| {
            kind.apply(below, value);
            if self.has_painted || self.next_leaves.is_some() {
                kind.second_weight(below, value);
            }
        });
        // A sharp union has the same text, but not the same nearest object.
        text.push(u32::from(kind.is_of_objects()));
        let next = self.family_joins.len();
        let family = *self.join_texts.entry(text).or_insert(next);
        if family == next {
            self.family_joins.push(self.joins.len());
        }
        let joins = &mut self.joins;
        *self.join_rows.entry((family, numbers)).or_insert_with_key(|(_, numbers)| {
            joins.push(Join { kind: kind.clone(), family, numbers: numbers.clone() });
            joins.len() as u32 - 1
        })
    }
}
