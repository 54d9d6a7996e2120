//! Folds of lists: the lanes of one list together.

use std::sync::atomic::Ordering;

use math::real::list::{IS_LAST, IS_UNARY, NO_LEAF, OPERATION_WORDS, ROW_MASK, function_of};

use super::arithmetic::{Batch, LANES};
use super::{Operand, Places, Run};
use crate::tape::FoldStep;

/// A fold on slots.
#[derive(Debug)]
pub(super) struct Fold {
    live: Operand,
    list: Operand,
    arguments: Vec<(usize, Operand)>,
    leaves: Vec<usize>,
    joins: Vec<usize>,
    row_words: u32,
    depth: usize,
    width: usize,
    /// Mask of the active lanes of its functions.
    lanes: usize,
    /// The value that waits last, and the new one.
    below: usize,
    value: usize,
    /// Its results, and the values that wait.
    results: usize,
    waiting: usize,
    /// Slots of the results, and of the variables that they become.
    returned: Vec<(usize, usize)>,
}

/// Parts of a function in the frame, as indices of slots.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Layout {
    pub(super) live: usize,
    pub(super) arguments: usize,
    pub(super) results: usize,
    pub(super) slots: usize,
    /// Memory of its folds.
    pub(super) folds: usize,
    pub(super) end: usize,
    pub(super) counters: usize,
}

/// Gives the functions of a fold their parts of the frame, not before `end`.
pub(super) fn lay_out(fold: &FoldStep, end: usize, layouts: &mut [Layout]) {
    let live = fold.functions().map(|function| layouts[function].live).fold(end, usize::max);
    let functions = fold.leaves.iter().map(|leaf| (leaf, fold.leaf_layout()));
    for (&function, part) in functions.chain(fold.joins.iter().map(|join| (join, fold.join_layout()))) {
        let [arguments, results, slots] = [part.arguments, part.results, part.own].map(|place| live + place as usize);
        layouts[function] = Layout { live, arguments, results, slots, ..Layout::default() };
    }
}

impl Places<'_> {
    pub(super) fn fold(&self, fold: &FoldStep, layouts: &[Layout]) -> Fold {
        let (lanes, own) = (layouts[fold.leaves[0]].live, self.layout.folds);
        let below = lanes + fold.join_layout().arguments as usize;
        let results = own + FoldStep::RESULTS as usize;
        let arguments = fold.arguments.iter().enumerate();
        let returned = fold.results.iter().enumerate();
        Fold {
            live: self.source(fold.live),
            list: self.source(fold.list),
            arguments: arguments.map(|(place, &var)| (lanes + 1 + place, self.source(var))).collect(),
            leaves: fold.leaves.clone(),
            joins: fold.joins.clone(),
            row_words: fold.row_words,
            depth: fold.depth as usize,
            width: fold.width() as usize,
            lanes,
            below,
            value: below + fold.width() as usize,
            results,
            waiting: own + fold.waiting() as usize,
            returned: returned.filter_map(|(place, &var)| Some((results + place, self.target(var)?))).collect(),
        }
    }
}

impl Run<'_> {
    fn lanes_of(&self, source: Operand) -> Box<Batch> {
        Box::new(match source {
            Operand::Slot(slot) => *self.frame.slots[slot],
            Operand::Input(index) => Batch([self.frame.inputs[index]; LANES]),
        })
    }

    /// Words in place of missing ones, in the active lanes.
    pub(super) fn make(&mut self, live: Operand, to: usize, missing: Operand) {
        let (live, missing) = (self.lanes_of(live), self.lanes_of(missing));
        for lane in 0..LANES {
            if live.0[lane] != 0 {
                self.frame.slots[to].0[lane] = self.table.make(missing.0[lane]);
            }
        }
    }

    pub(super) fn fold(&mut self, fold: &Fold) {
        let (mut remaining, lists) = (self.lanes_of(fold.live), self.lanes_of(fold.list));
        for &(to, from) in &fold.arguments {
            self.copy(to, from);
        }
        while let Some(first) = remaining.0.iter().position(|lane| *lane != 0) {
            let list = lists.0[first];
            for lane in 0..LANES {
                let is_in = if lists.0[lane] == list { remaining.0[lane] } else { 0 };
                self.frame.slots[fold.lanes].0[lane] = is_in;
                remaining.0[lane] &= !is_in;
            }
            self.fold_list(fold, list);
            for place in 0..fold.width {
                for lane in 0..LANES {
                    if self.frame.slots[fold.lanes].0[lane] != 0 {
                        self.frame.slots[fold.results + place].0[lane] = self.frame.slots[fold.below + place].0[lane];
                    }
                }
            }
            if self.cancel.load(Ordering::Relaxed) {
                break;
            }
        }
        for &(from, to) in &fold.returned {
            self.copy(to, Operand::Slot(from));
        }
    }

    /// Folds one list; its value is where joins leave theirs.
    fn fold_list(&mut self, fold: &Fold, list: u32) {
        let last = self.table.capacity() as u32 - 1;
        let (mut at, mut waiting) = (list, 0_usize);
        loop {
            at = at.min(last - 1);
            let (leaf, join) = (self.table.get(at), self.table.get(at + 1));
            let takes_leaf = function_of(leaf) != NO_LEAF;
            let joins = function_of(join) != 0;
            if takes_leaf {
                if !joins {
                    self.copy_value(fold, fold.waiting + fold.width * waiting, fold.below);
                    waiting = (waiting + 1).min(fold.depth);
                }
                self.call_with_row(fold, &fold.leaves, function_of(leaf) as usize, leaf);
            } else {
                self.copy_value(fold, fold.value, fold.below);
                if join & IS_UNARY == 0 {
                    waiting = waiting.saturating_sub(1);
                    self.copy_value(fold, fold.below, fold.waiting + fold.width * waiting);
                }
            }
            if joins {
                self.call_with_row(fold, &fold.joins, function_of(join) as usize - 1, join);
            } else {
                self.copy_value(fold, fold.below, fold.value);
            }
            at += OPERATION_WORDS;
            if leaf & IS_LAST != 0 || at >= last {
                return;
            }
        }
    }

    fn call_with_row(&mut self, fold: &Fold, functions: &[usize], index: usize, word: u32) {
        let Some(&function) = functions.get(index) else { return };
        let row = (word & ROW_MASK).min(self.table.capacity() as u32 - 1 - fold.row_words);
        let callee = self.program.functions[function].as_ref().expect("a fold that is used uses its functions");
        for &(place, input) in &callee.row {
            self.frame.inputs[input] = self.table.get(row + place);
        }
        self.call(function);
    }

    fn copy_value(&mut self, fold: &Fold, to: usize, from: usize) {
        for place in 0..fold.width {
            self.copy(to + place, Operand::Slot(from + place));
        }
    }
}
