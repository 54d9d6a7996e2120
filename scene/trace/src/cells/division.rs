//! All that a GPU needs in order to divide cells, as numbers.

use super::program::Program;
use super::prune::{JoinRange, LEVELS, Pruner};
use super::tree::{CellFrame, MAX_STALLS, SHORT_LIST, SHORTER};
use crate::real::Division;

/// Numbers of the box of a leaf at a level: the level, and the least and the greatest corner.
pub const BOX_NUMBERS: usize = 7;
/// Number of levels at which the box of a leaf without a Lipschitz factor is known.
pub const BOX_LEVELS: u32 = LEVELS;

/// All that a GPU needs in order to divide the cells of a program.
pub(super) fn division_of(
    program: &Program<'_>,
    frame: &CellFrame,
    pruner: &Pruner,
    [root, leaf_lists]: [u32; 2],
) -> Division {
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
    Division {
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
