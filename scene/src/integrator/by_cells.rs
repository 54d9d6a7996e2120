//! Which scenes are rendered by cells. It follows from the scene alone, so that all devices render the same bits.

use super::{Integrator, shrink, surfaces_of};
use crate::animation::JobAtFrame;
use crate::cells::{CellBuilder, Cells, Program};
use crate::real::Table;

/// Minimum number of leaves: below, straight code costs less than finding the cell of each point (measured on CPUs with
/// the shipped scenes, the largest of which has 88).
const MIN_LEAVES: usize = 96;

/// The program of a scene that is rendered by cells: of many leaves, in few families, which all rays see.
fn program<'a>(still: &'a JobAtFrame<'_>) -> Option<Program<'a>> {
    let (scene, moves) = (still.scene(), still.is_animated());
    if (scene.nodes() as usize) < MIN_LEAVES || scene.objects.iter().any(|object| !object.visible.is_full()) {
        return None;
    }
    let objects: Vec<_> =
        surfaces_of(scene).map(|index| (index, shrink(scene.objects[index].shape.stretch(), moves))).collect();
    Program::new(scene, &objects).filter(|program| program.leaf_count() >= MIN_LEAVES)
}

impl<'a> Integrator<'a> {
    /// Prepares the integrator of a picture of one frame: with cells, if the scene has many shapes.
    pub fn of_picture(still: &'a JobAtFrame<'_>, how: &dyn CellBuilder) -> Self {
        let own = Self::new(still);
        let cells = program(still).map(|program| {
            let reach = super::reach(own.bounds, own.view.origin(), own.scene.march.max_distance.get());
            Cells::new(program, reach, how)
        });
        Self { cells, ..own }
    }

    /// The table of the scene's cells, if it has any.
    pub fn table(&self) -> Option<&Table> {
        self.cells.as_ref().map(|cells| cells.tree().words())
    }
}

impl JobAtFrame<'_> {
    /// Number of nodes whose formulas are compiled: all of them, or those of one leaf of each family if the scene is
    /// rendered by cells.
    pub fn compiled_nodes(&self) -> u32 {
        program(self).map_or_else(|| self.scene().nodes(), |program| program.family_nodes())
    }
}
