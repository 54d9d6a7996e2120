//! Which tiles of a picture an edit of its scene can change, from the record of what their rays asked for
//! ([`crate::visits`]).
//!
//! A tile's pixels are the same, bit for bit, if the frames differ in nothing but surfaces and the numbers of materials, no
//! ray of the tile asked for a point where the surfaces that can matter differ, and none asked for a changed material. What can
//! matter in a box is found as for cells ([`crate::cells`]): if the lists of two scenes are equal there, so are their values.

use std::collections::HashSet;

use crate::animation::JobAtFrame;
use crate::cells::{ContentIds, Contents, Program, SLAB_CELLS};
use crate::integrator::Integrator;
use crate::visits::{GRIDS, OUTSIDE, VisitGrid, Visited, cell_index, edge};

/// Difference between two frames, as far as pixels can depend on it.
#[derive(Clone, Debug)]
pub enum Change {
    /// Any pixel can differ, for this reason.
    Anywhere(&'static str),
    /// Only pixels whose rays asked for certain places and materials.
    Within(ChangedParts),
}

/// Places and materials that differ between two frames.
#[derive(Clone, Debug)]
pub struct ChangedParts {
    grid: VisitGrid,
    cells: HashSet<u32>,
    materials: HashSet<u32>,
}

impl Change {
    /// Whether the pixels of a tile can differ; the record must be of the first of the two frames.
    pub fn can_reach(&self, tile: &Visited) -> bool {
        match self {
            Self::Anywhere(_) => true,
            Self::Within(ChangedParts { grid, cells, materials }) => {
                *grid != tile.grid
                    || tile.cells.iter().any(|cell| cells.contains(cell))
                    || tile.materials.iter().any(|slot| materials.contains(slot))
            }
        }
    }
}

/// Difference between two frames, for tiles that were recorded with these cells.
pub fn change(before: &JobAtFrame<'_>, after: &JobAtFrame<'_>, grid: &VisitGrid) -> Change {
    if before.key_without_surfaces() != after.key_without_surfaces() {
        return Change::Anywhere("something other than surfaces and their materials has changed");
    }
    let (old, new) = (Integrator::new(before), Integrator::new(after));
    let (Some(old_program), Some(new_program)) = (old.recordable(before), new.recordable(after)) else {
        return Change::Anywhere("the scene is not one whose rays are recorded");
    };
    if !old.has_same_frame(&new) {
        return Change::Anywhere("the scene's bounds or kinds of materials have changed");
    }
    let materials = before.scene().used_materials();
    let others = after.scene().used_materials();
    if materials.len() != others.len() {
        return Change::Anywhere("the scene has other materials");
    }
    let differ = materials.iter().zip(others).enumerate().filter(|(_, (one, other))| one != other);
    Change::Within(ChangedParts {
        grid: *grid,
        cells: changed_cells(&old_program, before, &new_program, after, grid),
        materials: differ.map(|(slot, _)| slot as u32).collect(),
    })
}

/// Cubes of cells in which the contents are compared first, and the edge of each.
const COARSE: u32 = 16;

fn changed_cells(
    old: &Program<'_>,
    before: &JobAtFrame<'_>,
    new: &Program<'_>,
    after: &JobAtFrame<'_>,
    grid: &VisitGrid,
) -> HashSet<u32> {
    let mut ids = ContentIds::default();
    let old = Contents::new(old, before.scene(), &mut ids);
    let new = Contents::new(new, after.scene(), &mut ids);
    if old.all() == new.all() {
        return HashSet::new();
    }
    let mut changed = HashSet::from([OUTSIDE]);
    for number in 0..GRIDS {
        let mut cubes = cubes_in([0; 3], edge(), COARSE);
        let mut size = COARSE;
        loop {
            cubes = differing(&old, &new, grid, number, &cubes, size);
            if size == 1 {
                break;
            }
            size /= 2;
            cubes = cubes.iter().flat_map(|&first| cubes_in(first, 2 * size, size)).collect();
        }
        changed.extend(cubes.into_iter().map(|cell| cell_index(number, cell)));
    }
    changed
}

/// First cells of the cubes of an edge of `size` cells in a cube of `within` cells.
fn cubes_in(first: [u32; 3], within: u32, size: u32) -> Vec<[u32; 3]> {
    let along = |axis: usize| (first[axis]..first[axis] + within).step_by(size as usize);
    let mut cubes = Vec::new();
    for z in along(2) {
        for y in along(1) {
            cubes.extend(along(0).map(|x| [x, y, z]));
        }
    }
    cubes
}

/// The cubes in which what can matter differs.
fn differing(
    old: &Contents<'_, '_>,
    new: &Contents<'_, '_>,
    grid: &VisitGrid,
    number: u32,
    cubes: &[[u32; 3]],
    size: u32,
) -> Vec<[u32; 3]> {
    let mut differing = Vec::new();
    for some in cubes.chunks(SLAB_CELLS) {
        let boxes = std::array::from_fn(|index| grid.bounds(number, *some.get(index).unwrap_or(&some[0]), size));
        let lists = old.in_boxes(&boxes).into_iter().zip(new.in_boxes(&boxes));
        let differ = some.iter().zip(lists).filter(|(_, (one, other))| one != other);
        differing.extend(differ.map(|(cube, _)| *cube));
    }
    differing
}
