//! The step that folds a list, and where its functions have their values.

use super::linear::Var;

/// A step that folds a list, see [`math::real::list`].
#[derive(Clone, Debug)]
pub(crate) struct FoldStep {
    pub(crate) live: Var,
    /// Index of the list's first word.
    pub(crate) list: Var,
    /// The uniform that is the index of the table's last word.
    pub(crate) last: u32,
    pub(crate) arguments: Vec<Var>,
    /// Functions of its leaves and joins.
    pub(crate) leaves: Vec<usize>,
    pub(crate) joins: Vec<usize>,
    /// Words of the longest row.
    pub(crate) row_words: u32,
    /// Maximum number of values that wait.
    pub(crate) depth: u32,
    pub(crate) results: Vec<Var>,
}

/// Where a function of lists has its arguments, its results and its own values, in packets after the mask of its active
/// lanes. A leaf's value lies where a join has its second argument, and a join's value where it has its first.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ListFunctionLayout {
    pub(crate) arguments: u32,
    pub(crate) results: u32,
    pub(crate) own: u32,
}

impl FoldStep {
    /// Functions of its leaves and joins.
    pub(crate) fn functions(&self) -> impl Iterator<Item = usize> + '_ {
        self.leaves.iter().chain(&self.joins).copied()
    }

    /// Number of numbers of a value.
    pub(crate) fn width(&self) -> u32 {
        self.results.len() as u32
    }

    pub(crate) fn leaf_layout(&self) -> ListFunctionLayout {
        let ListFunctionLayout { arguments: below, own, .. } = self.join_layout();
        ListFunctionLayout { arguments: 1, results: below + self.width(), own }
    }

    pub(crate) fn join_layout(&self) -> ListFunctionLayout {
        let below = 1 + self.arguments.len() as u32;
        ListFunctionLayout { arguments: below, results: below, own: below + 2 * self.width() }
    }

    /// Packets of memory of the fold itself: the lists, the lanes that remain, the results, and values that wait, with
    /// room for one too many.
    pub(crate) fn packets(&self) -> u32 {
        Self::RESULTS + self.width() * (self.depth + 2)
    }

    /// Where these begin.
    pub(crate) const LISTS: u32 = 0;
    pub(crate) const REMAINING: u32 = 1;
    pub(crate) const RESULTS: u32 = 2;

    pub(crate) fn waiting(&self) -> u32 {
        Self::RESULTS + self.width()
    }
}
