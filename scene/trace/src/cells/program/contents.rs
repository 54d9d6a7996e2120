//! Contents of a box: the operations that can matter there, with their numbers.

use std::collections::HashMap;

use super::{Join, Leaf, LeafMaterial, Program};
use crate::bounds::Bounds;
use crate::cells::prune::{Pruner, Regions, SLAB_CELLS, Unpruned};
use crate::real::list::{NO_LEAF, ROW_MASK, function_of};
use crate::real::vec3;
use crate::scene::Scene;

/// Numbers of contents: equal ones have one, in all programs that share these.
pub(crate) struct ContentIds {
    known: HashMap<Content, u32>,
    /// Whether pictures show the indices of objects.
    has_indices: bool,
}

/// A formula, its numbers, the slot of its object's material if that is its own, and the object's index if pictures show that.
type Content = (Vec<u32>, Vec<u32>, Option<u32>, Option<usize>);

impl ContentIds {
    /// Numbers for pictures that show the indices of objects, or do not.
    pub(crate) fn new(has_indices: bool) -> Self {
        Self { known: HashMap::new(), has_indices }
    }

    fn of(&mut self, text: &[u32], numbers: &[u32], material: Option<u32>, object: Option<usize>) -> u32 {
        let next = self.known.len() as u32;
        let object = object.filter(|_| self.has_indices);
        *self.known.entry((text.to_vec(), numbers.to_vec(), material, object)).or_insert(next)
    }
}

/// Leaves and joins by their contents, in the order in which they are computed: whether it is a leaf, and its number.
pub(crate) type List = Vec<(bool, u32)>;

impl Program<'_> {
    /// Everything that decides the values and materials of a leaf, given the slot of its object's own material.
    fn leaf_content(&self, leaf: usize, own: u32) -> (&[u32], &[u32], Option<u32>) {
        let Leaf { family, numbers, material, above: _, shape: _, next: _, id: _, bounds: _, lipschitz: _, object: _ } =
            &self.leaves[leaf];
        let own = match material {
            LeafMaterial::OfObject => Some(own),
            // They are among the numbers.
            LeafMaterial::Single(_) | LeafMaterial::Mixed(_) => None,
        };
        (&self.texts[*family], numbers, own)
    }

    /// Everything that decides the values of a join.
    fn join_content(&self, join: usize) -> (&[u32], &[u32]) {
        let Join { family, numbers, kind: _ } = &self.joins[join];
        (&self.join_texts[*family], numbers)
    }
}

/// A program whose contents can be compared with another's.
pub(crate) struct Contents<'a> {
    program: Program<'a>,
    pruner: Pruner,
    /// Indices of all leaves.
    leaves: Vec<u32>,
    /// Numbers of the contents of the leaves and joins.
    leaf_ids: Vec<u32>,
    join_ids: Vec<u32>,
}

impl<'a> Contents<'a> {
    /// Contents of a program of this scene.
    pub(crate) fn new(program: Program<'a>, scene: &Scene, ids: &mut ContentIds) -> Self {
        let mut of_leaf = |leaf: usize| {
            let own = scene.objects[program.leaves()[leaf].object].material.slot();
            let (text, numbers, material) = program.leaf_content(leaf, own);
            ids.of(text, numbers, material, Some(program.leaves()[leaf].object))
        };
        let leaf_ids = (0..program.leaf_count()).map(&mut of_leaf).collect();
        let mut of_join = |join: usize| {
            let (text, numbers) = program.join_content(join);
            ids.of(text, numbers, None, None)
        };
        let join_ids = (0..program.joins().count()).map(&mut of_join).collect();
        let leaves = (0..program.leaf_count() as u32).collect();
        Self { pruner: Pruner::new(&program), program, leaves, leaf_ids, join_ids }
    }

    /// Box of all leaves that are finite.
    pub(crate) fn bounds(&self) -> Option<Bounds> {
        let finite = self.program.leaves().iter().map(Leaf::bounds).filter(|bounds| bounds.is_finite());
        finite.reduce(Bounds::union)
    }

    /// Everything.
    pub(crate) fn all(&self) -> List {
        let operations = self.program.list().chunks_exact(2);
        let leaf = |word: u32| (function_of(word) != NO_LEAF).then_some((true, word));
        let join = |word: u32| (word != 0).then_some((false, word));
        let words = operations.flat_map(|operation| [leaf(operation[0]), join(operation[1])]);
        words.flatten().map(|word| self.id(word)).collect()
    }

    /// Contents of boxes: the scene's values and materials are the same, bit for bit, where it is equal.
    pub(crate) fn in_boxes(&self, boxes: &[Bounds; SLAB_CELLS]) -> [List; SLAB_CELLS] {
        let middle = |low: f32, high: f32| 0.5 * (low + high);
        let centers =
            boxes.map(|Bounds { min, max }| vec3(middle(min.x, max.x), middle(min.y, max.y), middle(min.z, max.z)));
        let at_centers = |&leaf: &u32| centers.map(|p| self.program.leaves()[leaf as usize].distance(p));
        let distances: Vec<f32> = self.leaves.iter().flat_map(at_centers).collect();
        let regions = Regions::new(boxes);
        let (list, pruner, leaves) = (self.program.list(), &self.pruner, &self.leaves[..]);
        let pruned = Unpruned { pruner, list, leaves, regions: &regions, distances: &distances }.prune();
        std::array::from_fn(|cell| pruned.words(cell).map(|word| self.id(word)).collect())
    }

    fn id(&self, (is_leaf, word): (bool, u32)) -> (bool, u32) {
        let index = self.program.rows()[(word & ROW_MASK) as usize - 1] as usize;
        (is_leaf, if is_leaf { self.leaf_ids[index] } else { self.join_ids[index] })
    }
}
