//! Which tiles of a picture an edit of its scene can change, from the record of what their rays asked for
//! ([`crate::visits`]).
//!
//! A tile's pixels are the same, bit for bit, if the frames differ in nothing but surfaces and the numbers of materials, no
//! ray of the tile asked for a point where the surfaces that can matter differ, and none asked for a changed material. What can
//! matter in a box is found as for cells ([`crate::cells`]): if the lists of two scenes are equal there, so are their values.

use std::collections::{HashMap, HashSet};

use crate::animation::JobAtFrame;
use crate::cells::{ContentIds, Contents, SLAB_CELLS};
use crate::integrator::Integrator;
use crate::job::Layer;
use crate::visits::{OUTSIDE, VisitGrid, Visited, cell_place};

/// For each tile that was recorded in the first of two frames, whether its pixels can differ in the second; or the reason
/// why any pixel can.
pub fn reached(before: &JobAtFrame<'_>, after: &JobAtFrame<'_>, tiles: &[&Visited]) -> Result<Vec<bool>, &'static str> {
    if before.key_without_surfaces() != after.key_without_surfaces() {
        return Err("something other than surfaces and their materials has changed");
    }
    let (old, new) = (Integrator::new(before), Integrator::new(after));
    let (Some(old_program), Some(new_program)) = (old.recordable(before), new.recordable(after)) else {
        return Err("the scene is not one whose rays are recorded");
    };
    if !old.has_same_frame(&new) {
        return Err("the scene's bounds or kinds of materials have changed");
    }
    let (materials, others) = (before.scene().used_materials(), after.scene().used_materials());
    if materials.len() != others.len() {
        return Err("the scene has other materials");
    }
    let differs = |slot: &u32| materials[*slot as usize] != others[*slot as usize];
    let has_material = |tile: &&Visited| tile.materials.iter().any(differs);
    let mut are_reached: Vec<bool> = tiles.iter().map(has_material).collect();
    // Light groups are found by the index of the object, as the layer of objects is.
    let image = before.image();
    let mut ids = ContentIds::new(image.layers.contains(&Layer::Object) || !image.light_groups.is_empty());
    let old = Contents::new(&old_program, before.scene(), &mut ids);
    let new = Contents::new(&new_program, after.scene(), &mut ids);
    if old.all() == new.all() {
        return Ok(are_reached);
    }
    let mut by_grid: Vec<(VisitGrid, Vec<usize>)> = Vec::new();
    for (index, tile) in tiles.iter().enumerate().filter(|(index, _)| !are_reached[*index]) {
        match by_grid.iter_mut().find(|(grid, _)| *grid == tile.grid) {
            Some((_, indices)) => indices.push(index),
            None => by_grid.push((tile.grid, vec![index])),
        }
    }
    for (grid, indices) in by_grid {
        let cubes = CubePairs { old: &old, new: &new, grid };
        let some: Vec<&[u32]> = indices.iter().map(|index| &tiles[*index].cells[..]).collect();
        for (index, is_reached) in indices.iter().zip(reached_cells(&cubes, &some)) {
            are_reached[*index] = is_reached;
        }
    }
    Ok(are_reached)
}

/// Edges of the cubes of cells that are compared, the largest first: what is equal in one is equal in its cells.
const EDGES: [u32; 2] = [16, 4];
/// Number of a tile's cells that are compared at once; the first that differs decides.
const AT_ONCE: usize = SLAB_CELLS;

/// Whether some cell of each tile differs.
fn reached_cells(cubes: &CubePairs<'_, '_>, tiles: &[&[u32]]) -> Vec<bool> {
    let mut are_reached: Vec<bool> = tiles.iter().map(|cells| cells.last() == Some(&OUTSIDE)).collect();
    // The cells of each tile that may differ.
    let mut open: Vec<Vec<u32>> = tiles.iter().map(|cells| cells.to_vec()).collect();
    for edge in EDGES {
        let of_open = open.iter().zip(&are_reached).filter(|(_, is_reached)| !**is_reached);
        let visited: HashSet<Cube> =
            of_open.flat_map(|(cells, _)| cells).map(|cell| Cube::around(*cell, edge)).collect();
        let differing = cubes.differing(&visited.into_iter().collect::<Vec<_>>());
        for cells in &mut open {
            cells.retain(|cell| differing.contains(&Cube::around(*cell, edge)));
        }
    }
    let mut known: HashMap<u32, bool> = HashMap::new();
    loop {
        let mut wanted: HashSet<u32> = HashSet::new();
        for (cells, is_reached) in open.iter_mut().zip(&mut are_reached).filter(|(_, is_reached)| !**is_reached) {
            *is_reached = cells.iter().any(|cell| known.get(cell) == Some(&true));
            cells.retain(|cell| !known.contains_key(cell));
            if !*is_reached {
                // Cells that are far from each other tell more.
                let step = cells.len().div_ceil(AT_ONCE).max(1);
                wanted.extend(cells.iter().step_by(step));
            }
        }
        if wanted.is_empty() {
            return are_reached;
        }
        let all: Vec<Cube> = wanted.iter().map(|cell| Cube::around(*cell, 1)).collect();
        let differing = cubes.differing(&all);
        known.extend(wanted.into_iter().map(|cell| (cell, differing.contains(&Cube::around(cell, 1)))));
    }
}

/// A cube of cells.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct Cube {
    grid: u32,
    first: [u32; 3],
    edge: u32,
}

impl Cube {
    /// The cube of an edge that a cell is in.
    fn around(cell: u32, edge: u32) -> Self {
        let (grid, place) = cell_place(cell);
        Self { grid, first: place.map(|along| along - along % edge), edge }
    }
}

/// Two scenes in a grid.
struct CubePairs<'a, 'b> {
    old: &'a Contents<'a, 'b>,
    new: &'a Contents<'a, 'b>,
    grid: VisitGrid,
}

impl CubePairs<'_, '_> {
    /// Those of some cubes in which what can matter differs.
    fn differing(&self, cubes: &[Cube]) -> HashSet<Cube> {
        let mut differing = HashSet::new();
        for some in cubes.chunks(SLAB_CELLS) {
            let boxes = std::array::from_fn(|index| {
                let Cube { grid, first, edge } = *some.get(index).unwrap_or(&some[0]);
                self.grid.bounds(grid, first, edge)
            });
            let lists = self.old.in_boxes(&boxes).into_iter().zip(self.new.in_boxes(&boxes));
            differing.extend(some.iter().zip(lists).filter(|(_, (one, other))| one != other).map(|(cube, _)| *cube));
        }
        differing
    }
}
