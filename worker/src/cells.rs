//! Distances of a scene's leaves by machine code, with which its cells are built.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};

use scene::JobAtFrame;
use scene::cells::{
    BLOCK_CELLS, CellBuilder, DistanceLists, Distances, LeafDistances, Program, Pruned, SLAB_CELLS, SLABS, Unpruned,
};
use scene::real::{Real, Table, Vec3, Words, vec3};
use tape::{Evaluator, Expr, Frame, Inputs, Instructions, record};

use crate::recent::{self, Recent};

/// Entry of the tape: the value of a list at a point, from the point and the bits of the list's index.
const LIST: &str = "value_of_list";

/// Builds cells with the fastest evaluator of this CPU.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FastBuilder {
    /// Maximum number of words of the cells.
    max_words: usize,
}

impl FastBuilder {
    /// Builds as many cells as a scene may have.
    pub(crate) const UNLIMITED: Self = Self { max_words: usize::MAX };

    /// Builds cells of at most this many bytes.
    pub(crate) fn with_memory(bytes: usize) -> Self {
        Self { max_words: bytes / size_of::<u32>() }
    }
}

/// Cells of frames that were rendered last, which frames with the same shapes share.
#[derive(Debug, Default)]
pub(crate) struct KnownCells(Recent<blake3::Hash, Words>);

impl KnownCells {
    /// Maximum number of tables.
    const MOST: usize = 4;

    /// A table with the cells of a frame: a known one, or else this one, which is new.
    pub(crate) fn share(&self, at_frame: &JobAtFrame<'_>, table: &Table) -> Table {
        // A job without animation has no other frame, so its shapes need no key.
        let Some(division) = table.division().filter(|_| at_frame.is_animated()) else { return table.clone() };
        let key = at_frame.shapes_cache_key();
        let known = recent::find(&self.0, |other| *other == key);
        // Where the cells are depends on the camera, too.
        let is_same = |known: &Table| known.division() == Some(division) && known.capacity() == table.capacity();
        match known.filter(|known| is_same(known) && !known.is_full()) {
            Some(known) => known,
            None => recent::insert(&self.0, key, table.clone(), Self::MOST),
        }
    }

    /// Forgets a table, if it is known.
    pub(crate) fn forget(&self, table: &Table) {
        recent::forget(&self.0, |known| Arc::ptr_eq(known, table));
    }
}

/// An evaluator of lists of one leaf each.
struct Leaves {
    evaluator: Evaluator,
    inputs: Inputs,
    /// Index of the list of the first leaf.
    first: u32,
    /// Memory of threads that evaluate no leaves now.
    frames: Mutex<Vec<Frame>>,
    instructions: Instructions,
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,fma")]
fn prune_with_avx512(list: &Unpruned<'_>) -> Pruned {
    list.prune()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn prune_with_avx2(list: &Unpruned<'_>) -> Pruned {
    list.prune()
}

impl CellBuilder for FastBuilder {
    fn distances<'a>(&self, program: &'a Program<'_>) -> Distances<'a> {
        let first = program.rows().len() as u32;
        let lists = (0..program.leaf_count() as u32).flat_map(|leaf| program.list_of(leaf));
        // The tape's table has a row's room after the last list.
        let room = program.rows().len().min(1 << 17);
        let words: Vec<u32> = program.rows().iter().copied().chain(lists).chain(std::iter::repeat_n(0, room)).collect();
        let table: Table = Arc::new(Words::from(words));
        let tape = record(|recording| {
            recording.entry(LIST, |[x, y, z, list]: [Expr; 4]| {
                vec![Real::fold(&table, list.to_bits(), vec3(x, y, z), &DistanceLists(program))]
            });
        });
        let evaluator = Evaluator::fastest(&tape).expect("a recorded tape is valid");
        let (inputs, frames, instructions) = (evaluator.inputs(&tape), Mutex::default(), Instructions::available());
        Distances::Kept(Arc::new(Leaves { evaluator, inputs, first, frames, instructions }))
    }

    fn max_words(&self) -> usize {
        self.max_words
    }
}

impl LeafDistances for Leaves {
    fn append(&self, leaves: &[u32], points: &[Vec3<f32>; BLOCK_CELLS as usize], distances: &mut [Vec<f32>; SLABS]) {
        /// Leaves that are evaluated together.
        const LEAVES: usize = 64;
        let frame = self.frames.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut frame = frame.unwrap_or_else(|| self.evaluator.frame());
        let cancel = AtomicBool::new(false);
        // Each leaf has packets of its own.
        let of_leaf = points.len().next_multiple_of(self.evaluator.lanes());
        let together = LEAVES.min(leaves.len());
        let (length, places) = (together * of_leaf, 3 * together * of_leaf);
        // The points of each leaf are the same.
        let mut arguments = Vec::with_capacity(4 * length);
        let coordinates: [fn(&Vec3<f32>) -> f32; 3] = [|p| p.x, |p| p.y, |p| p.z];
        for coordinate in coordinates {
            let start = arguments.len();
            arguments.extend(points.iter().map(coordinate));
            arguments.resize(start + of_leaf, points.last().map_or(0.0, coordinate));
            for _ in 1..together {
                arguments.extend_from_within(start..start + of_leaf);
            }
        }
        arguments.resize(4 * length, 0.0);
        let mut results = vec![0.0; length];
        for some in leaves.chunks(LEAVES) {
            // The last ones may be fewer: the others are evaluated again.
            for (leaf, lists) in some.iter().zip(arguments[places..].chunks_exact_mut(of_leaf)) {
                lists.fill(f32::from_bits(self.first + 2 * leaf));
            }
            self.evaluator.run(LIST, &mut frame, &self.inputs, &cancel, &arguments, &mut results);
            for values in results.chunks_exact(of_leaf).take(some.len()) {
                for (distances, values) in distances.iter_mut().zip(values.chunks_exact(SLAB_CELLS)) {
                    distances.extend_from_slice(values);
                }
            }
        }
        self.frames.lock().unwrap_or_else(PoisonError::into_inner).push(frame);
    }

    fn prune(&self, list: &Unpruned<'_>) -> Pruned {
        #[cfg(target_arch = "x86_64")]
        #[expect(unsafe_code, reason = "functions with more instructions than the build assumes")]
        match self.instructions {
            // SAFETY: this CPU has the instructions, as `available` found.
            Instructions::Avx512 => return unsafe { prune_with_avx512(list) },
            // SAFETY: as above.
            Instructions::Avx2 => return unsafe { prune_with_avx2(list) },
            Instructions::OfTheBuild => {}
        }
        list.prune()
    }
}
