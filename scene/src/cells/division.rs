//! All that a GPU needs in order to divide cells, as numbers.

use super::program::Program;
use super::prune::{JoinRange, LEVELS, Pruner};
use super::tree::{CellFrame, MAX_STALLS, SHORT_LIST, SHORTER};
use crate::real::Vec3;

/// Numbers of the box of a leaf at a level: the level, and the least and the greatest corner.
pub const BOX_NUMBERS: usize = 7;
/// Number of levels at which the box of a leaf without a Lipschitz factor is known.
pub const BOX_LEVELS: u32 = LEVELS;

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
    /// Index of the list that is the first leaf alone; those of the others follow.
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
    /// Boxes of the leaves without a Lipschitz factor, [`BOX_NUMBERS`] numbers each, the greatest level first.
    pub boxes: Vec<f32>,
    /// Of each join, the seam's width, or the factor.
    pub joins: Vec<f32>,
}

impl Division {
    pub(super) fn new(program: &Program<'_>, frame: &CellFrame, pruner: &Pruner, [root, leaf_lists]: [u32; 2]) -> Self {
        let (mut first_boxes, mut boxes) = (Vec::new(), Vec::new());
        if !pruner.levels.is_empty() {
            first_boxes = vec![0; pruner.factors.len()];
            for (&leaf, levels) in &pruner.levels {
                first_boxes[leaf as usize] = (boxes.len() / BOX_NUMBERS) as u32;
                for (level, bounds) in levels {
                    let (low, high) = (bounds.min, bounds.max);
                    boxes.extend([*level, low.x, low.y, low.z, high.x, high.y, high.z]);
                }
            }
        }
        let number_of = |join: &JoinRange| match *join {
            JoinRange::Union(width) => width,
            JoinRange::Least => 0.0,
            JoinRange::Scale(by) => by,
        };
        Self {
            center: frame.center,
            unit: frame.unit,
            levels: frame.levels,
            coarse_levels: frame.coarse_levels,
            root,
            leaf_lists,
            short_list: SHORT_LIST as u32,
            shorter: SHORTER,
            max_stalls: MAX_STALLS,
            depth: program.depth() as u32,
            factors: pruner.factors.clone(),
            first_boxes,
            boxes,
            joins: pruner.joins.iter().map(number_of).collect(),
        }
    }
}
