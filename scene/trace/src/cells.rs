//! Cells: a scene of many shapes, cut so that a point costs only the shapes that can matter there.
//!
//! A scene is cut at its outermost joins into *leaves*, and the tree above them is a list of operations in the order
//! in which they are computed (`program.rs`). Leaves whose formulas differ in numbers only are one *family*, and each
//! leaf is a *row* of numbers (`trace.rs`). Space is divided into a tree of cells; each has the part of the
//! list that can matter in it, found by Lipschitz factors (`tree.rs`): **the list of a cell gives the value of the
//! whole scene, bit for bit, at every point of the cell.** A cell without a surface also has a lower bound of the
//! distance in it, so that a ray can leave it in one step (`walk.rs`).
//!
//! Leaving shapes out is exact: where a shape's least value is a seam's width above another's greatest, the depth into
//! the seam is 0 at every point, and the smooth minimum is the other's value. Least and greatest values follow from the
//! distance at a cell's center, with a margin of 2⁻¹⁶ of its size for rounding; tests compare them bit for bit.
//!
//! M. Keeter, "Massively parallel rendering of complex closed-form implicit surfaces", ACM Transactions on Graphics
//! 39(4), 2020, prunes formulas by intervals; Wilhem Barbier et al., "Lipschitz pruning: hierarchical simplification of
//! primitive-based SDFs", Computer Graphics Forum 44(2), 2025, prunes lists of smooth joins.

mod division;
mod materials;
mod motion;
mod program;
mod prune;
mod trace;
mod tree;
mod walk;

use crate::bounds::Bounds;
pub use crate::real::Division;
pub use division::{BOX_LEVELS, BOX_NUMBERS};
pub use program::Program;
pub(crate) use program::contents::{ContentIds, Contents, List};
pub use prune::{Pruned, Pruner, ROUNDING, Regions, SLAB_CELLS, SLABS, Unpruned};
pub use tree::{BLOCK_CELLS, CellBuilder, CellTree, Distances, LeafDistances, ScalarBuilder, checksum};
pub use walk::{DistanceLists, Located};

/// A scene's program and its cells.
#[derive(Clone, Debug)]
pub struct Cells<'a> {
    program: Program<'a>,
    tree: CellTree,
}

impl<'a> Cells<'a> {
    /// Builds the cells of a program. `reach` contains the points at which the scene will be evaluated; points outside
    /// are slow.
    pub fn new(program: Program<'a>, reach: Bounds, how: &dyn CellBuilder) -> Self {
        let tree = CellTree::new(&program, reach, how);
        Self { program, tree }
    }

    /// The scene's leaves and joins.
    pub fn program(&self) -> &Program<'a> {
        &self.program
    }

    /// The cells.
    pub fn tree(&self) -> &CellTree {
        &self.tree
    }
}
