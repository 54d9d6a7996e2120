//! Words that formulas read by computed indices, and that are made when a formula first asks for them.

use std::fmt;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use super::Vec3;

/// A table, shared by all that read it.
pub type Table = Arc<Words>;

/// Bits of a missing word that are an index in the table, which no other missing word has.
pub const INDEX_BITS: u32 = 30;
/// The word that is read in place of a missing one where it can't be made, such as on a GPU. What was computed with it is
/// not the formula's value: the missing word is to be made, and the formula computed again.
pub const STAND_IN: u32 = 1;

/// Place of the index of a list among the words that a missing one refers to: the list of the cell that is to be divided.
pub const LIST_PLACE: u32 = 5;

/// Place of the length of a list among the words that a missing one refers to. A GPU divides lists of about one length
/// together, and needs memory for the longest.
pub const LENGTH_PLACE: u32 = 6;

/// Makes the words of a table that do not exist yet.
pub trait MakeWords: Send + Sync {
    /// The word in place of one that says that its contents do not exist: after the contents have been made. Called by
    /// several threads.
    fn make(&self, words: &Words, missing: u32) -> u32;

    /// Makes words that formulas could ask for, the outermost first, until all exist or `is_enough` is true.
    fn make_until(&self, words: &Words, is_enough: &dyn Fn() -> bool);

    /// Missing words whose contents take long to make: of the outermost cell, or once that exists, of those right inside
    /// it. Each can be passed to [`MakeWords::make`].
    fn outermost(&self, words: &Words) -> Vec<u32>;

    /// How a GPU makes missing words, if it can.
    fn division(&self) -> Option<&Division>;
}

/// The rules by which cells are divided, and the scene's numbers for them. A division has the same cells and lists
/// wherever it is computed.
#[derive(Clone, Debug, PartialEq)]
pub struct Division {
    /// Center of the outermost cell.
    pub center: Vec3<f32>,
    /// Edge of the smallest cells.
    pub unit: f32,
    /// Depth of the tree.
    pub levels: u32,
    /// Level up to which a cell may have all shapes, and is divided nonetheless.
    pub coarse_levels: u32,
    /// Index of the word of the outermost cell.
    pub root: u32,
    /// Index of the list that is the first leaf alone; the other leaves' follow.
    pub leaf_lists: u32,
    /// Number of leaves in a list up to which a cell is not divided.
    pub short_list: u32,
    /// Part of its parent's leaves up to which a cell is smaller in what matters.
    pub shorter: f32,
    /// Number of cells, each inside the one before, that may be hardly smaller.
    pub max_stalls: u32,
    /// Maximum number of values that wait for a join.
    pub depth: u32,
    /// Lipschitz factor of each leaf; infinite for those that have boxes.
    pub factors: Vec<f32>,
    /// Of each leaf, the index of its first box; none if no leaf has boxes.
    pub first_boxes: Vec<u32>,
    /// Boxes of the leaves without a Lipschitz factor, 7 numbers each: the level, and the least and the greatest corner, the greatest level first.
    pub boxes: Vec<f32>,
    /// Of each join, the seam's width, or the factor.
    pub joins: Vec<f32>,
}

/// Words of a scene: at least one. They are appended, and never move. Memory that no word was appended to is not used.
pub struct Words {
    all: Box<[AtomicU32]>,
    used: AtomicUsize,
    maker: OnceLock<Box<dyn MakeWords>>,
}

impl Words {
    /// A table for at most this many words, or for fewer if the machine has not as much memory.
    pub fn with_capacity(capacity: usize) -> Self {
        /// Capacity below which memory is not asked for twice.
        const SMALL: usize = 1 << 20;
        let mut capacity = capacity.max(1);
        let all = loop {
            match bytemuck::try_zeroed_slice_box(capacity) {
                Ok(all) => break all,
                Err(()) if capacity > SMALL => capacity /= 2,
                Err(()) => break bytemuck::zeroed_slice_box(capacity),
            }
        };
        Self { all, used: AtomicUsize::new(0), maker: OnceLock::new() }
    }

    /// Number of words that may be read: those that do not exist yet are 0.
    pub fn capacity(&self) -> usize {
        self.all.len()
    }

    /// Number of words that exist.
    pub fn used(&self) -> usize {
        self.used.load(Ordering::Acquire).min(self.all.len())
    }

    /// Says that words could not be made.
    pub fn fail(&self) {
        self.used.fetch_add(self.all.len() + 1, Ordering::AcqRel);
    }

    /// Whether words could not be made.
    pub fn is_full(&self) -> bool {
        self.used.load(Ordering::Acquire) > self.all.len()
    }

    /// Word at an index.
    ///
    /// # Panics
    /// If the index is beyond the capacity.
    pub fn get(&self, index: u32) -> u32 {
        self.all[index as usize].load(Ordering::Acquire)
    }

    /// Changes a word, after all words that it refers to.
    ///
    /// # Panics
    /// If the index is beyond the capacity.
    pub fn set(&self, index: u32, word: u32) {
        self.all[index as usize].store(word, Ordering::Release);
    }

    /// Appends words; returns the index of the first. `None` if there is no room for them.
    pub fn append(&self, words: &[u32]) -> Option<u32> {
        let start = self.used.fetch_add(words.len(), Ordering::AcqRel);
        let places = self.all.get(start..start + words.len())?;
        for (place, &word) in places.iter().zip(words) {
            place.store(word, Ordering::Relaxed);
        }
        u32::try_from(start).ok()
    }

    /// Makes all words that formulas could ask for.
    pub fn make_all(&self) {
        self.make_until(&|| false);
    }

    /// Makes words that formulas could ask for, the outermost first, until all exist or `is_enough` is true.
    pub fn make_until(&self, is_enough: &dyn Fn() -> bool) {
        if let Some(maker) = self.maker.get() {
            maker.make_until(self, is_enough);
        }
    }

    /// All words that exist from this index on.
    pub fn after(&self, index: usize) -> Vec<u32> {
        self.all[index..self.used()].iter().map(|word| word.load(Ordering::Acquire)).collect()
    }

    /// Address of the first word, for compiled code.
    pub fn as_ptr(&self) -> *const u32 {
        self.all.as_ptr().cast()
    }

    /// Sets what makes missing words. The first call counts.
    pub fn set_maker(&self, maker: Box<dyn MakeWords>) {
        let _ = self.maker.set(maker);
    }

    /// The word in place of one that says that its contents do not exist.
    pub fn make(&self, missing: u32) -> u32 {
        self.maker.get().map_or(missing, |maker| maker.make(self, missing))
    }

    /// See [`MakeWords::outermost`].
    pub fn outermost(&self) -> Vec<u32> {
        self.maker.get().map(|maker| maker.outermost(self)).unwrap_or_default()
    }

    /// How a GPU makes missing words, if they can be made.
    pub fn division(&self) -> Option<&Division> {
        self.maker.get().and_then(|maker| maker.division())
    }
}

impl Default for Words {
    fn default() -> Self {
        Self::with_capacity(1)
    }
}

impl From<Vec<u32>> for Words {
    fn from(all: Vec<u32>) -> Self {
        let words = Self::with_capacity(all.len());
        words.append(&all);
        words
    }
}

impl fmt::Debug for Words {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} of {} words", self.used(), self.capacity())
    }
}
