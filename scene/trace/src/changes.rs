//! Which tiles of a picture an edit of its scene can change, from the record of what their rays asked for
//! ([`crate::visits`]).
//!
//! A tile's pixels are the same, bit for bit, if the frames differ in nothing but surfaces and the numbers of materials, no
//! ray of the tile asked for a point where the surfaces that can matter differ, and none asked for a changed material. What can
//! matter in a box is found as for cells ([`crate::cells`]): if the lists of two scenes are equal there, so are their values.

use std::cell::RefCell;
use std::collections::{HashMap, HashSet};
use std::rc::Rc;

use crate::animation::JobAtFrame;
use crate::bounds::Bounds;
use crate::cells::{ContentIds, Contents, List, SLAB_CELLS};
use crate::film::Layer;
use crate::integrator::Integrator;
use crate::scene::Scene;
use crate::visits::{OUTSIDE, VisitGrid, Visited, cell_place};

/// For each tile that was recorded in the first of two frames, whether its pixels can differ in the second; or the reason
/// why any pixel can.
pub fn reached(before: &JobAtFrame<'_>, after: &JobAtFrame<'_>, tiles: &[&Visited]) -> Result<Vec<bool>, &'static str> {
    if before.key_without_surfaces() != after.key_without_surfaces() {
        return Err("something other than surfaces and their materials has changed");
    }
    let (old, new) = (Integrator::new(before), Integrator::new(after));
    if old.recordable(before).is_none() || new.recordable(after).is_none() {
        return Err("the scene is not one whose rays are recorded");
    }
    if !old.has_same_frame(&new) {
        return Err("the scene's bounds or kinds of materials have changed");
    }
    let (materials, others) = (before.scene().used_materials(), after.scene().used_materials());
    if materials.len() != others.len() {
        return Err("the scene has other materials");
    }
    let differs = |slot: &u32| materials[*slot as usize] != others[*slot as usize];
    let has_material = |tile: &&Visited| tile.materials.iter().any(differs);
    let moved = differences(old.ray_boxes(), new.ray_boxes());
    let has_passed = |tile: &&Visited| moved.iter().any(|bounds| tile.has_passed(*bounds));
    let mut are_reached: Vec<bool> = tiles.iter().map(|tile| has_material(tile) || has_passed(tile)).collect();
    // Light groups are found by the index of the object, as the layer of objects is.
    let image = before.image();
    let ids = ContentIds::new(image.layers.contains(&Layer::Object) || !image.light_groups.is_empty());
    let ids = RefCell::new(ids);
    let old = Evaluated::new(old, before.scene(), &ids);
    let new = Evaluated::new(new, after.scene(), &ids);
    if old.everywhere() == new.everywhere() {
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

/// Boxes that contain all points that are in a box of only one scene: a ray that passes none of these goes in the same steps.
fn differences(old: &[Bounds], new: &[Bounds]) -> Vec<Bounds> {
    if old.len() != new.len() {
        return [old, new].concat();
    }
    let pairs = old.iter().zip(new).filter(|(one, other)| one != other);
    pairs.flat_map(|(&one, &other)| one.symmetric_difference(other)).collect()
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

/// A scene, and the contents of the objects that its rays evaluate together.
struct Evaluated<'a> {
    integrator: Integrator<'a>,
    scene: &'a Scene,
    ids: &'a RefCell<ContentIds>,
    /// Contents of those objects that were asked for; `None` if there are no such objects.
    known: RefCell<HashMap<Objects, Option<Rc<Contents<'a>>>>>,
}

/// Objects of a scene: those whose boxes have these bits, and those without boxes or not.
type Objects = (u32, bool);

/// Contents that rays can evaluate in a cube.
type Evaluable = Vec<List>;

impl<'a> Evaluated<'a> {
    fn new(integrator: Integrator<'a>, scene: &'a Scene, ids: &'a RefCell<ContentIds>) -> Self {
        Self { integrator, scene, ids, known: RefCell::default() }
    }

    fn all_objects(&self) -> Objects {
        ((1 << self.integrator.ray_boxes().len()) - 1, true)
    }

    fn contents(&self, objects: Objects) -> Option<Rc<Contents<'a>>> {
        if let Some(known) = self.known.borrow().get(&objects) {
            return known.clone();
        }
        let program = self.integrator.program_in_boxes(objects.0, objects.1);
        let contents = program.map(|program| Rc::new(Contents::new(program, self.scene, &mut self.ids.borrow_mut())));
        self.known.borrow_mut().insert(objects, contents.clone());
        contents
    }

    /// Contents of everything.
    fn everywhere(&self) -> Evaluable {
        let alone = (0..self.integrator.ray_boxes().len()).map(|bit| (1 << bit, false));
        let contents = std::iter::once(self.all_objects()).chain(alone).filter_map(|objects| self.contents(objects));
        contents.map(|contents| contents.all()).collect()
    }

    /// Contents that rays can evaluate in some cubes of cells, given the edges of the cells.
    fn in_cubes(&self, cubes: &[Bounds; SLAB_CELLS], edges: [f32; SLAB_CELLS]) -> [Evaluable; SLAB_CELLS] {
        let boxes = self.integrator.ray_boxes();
        let mut known: HashMap<Objects, Option<[List; SLAB_CELLS]>> = HashMap::new();
        std::array::from_fn(|index| {
            let (cube, edge) = (cubes[index], edges[index]);
            let around = cube.expanded(ON_BORDER * edge);
            let with_bits = |is_it: &dyn Fn(Bounds) -> bool| {
                let some = boxes.iter().enumerate().filter(|(_, bounds)| is_it(**bounds));
                some.fold(0, |bits, (bit, _)| bits | 1 << bit)
            };
            let inside: u32 = with_bits(&|bounds| bounds.contains(around.min) && bounds.contains(around.max));
            let on_border = with_bits(&|bounds| bounds.gap(around) <= 0.0) & !inside;
            // Normals are of all objects; marches, of those in the boxes. On a border, these may be there or not.
            let alone = (0..boxes.len()).map(|bit| (on_border & 1 << bit, false)).filter(|(bits, _)| *bits != 0);
            let lists = [self.all_objects(), (inside, true)].into_iter().chain(alone).filter_map(|objects| {
                let of_all = known.entry(objects).or_insert_with(|| Some(self.contents(objects)?.in_boxes(cubes)));
                of_all.as_ref().map(|lists| lists[index].clone())
            });
            lists.collect()
        })
    }
}

/// Distance from a box's border within which a point may count as inside, in edges of a cell.
const ON_BORDER: f32 = 0.05;

/// Two scenes in a grid.
struct CubePairs<'a, 'b> {
    old: &'a Evaluated<'b>,
    new: &'a Evaluated<'b>,
    grid: VisitGrid,
}

impl CubePairs<'_, '_> {
    /// Cubes whose relevant shapes differ, among some cubes.
    fn differing(&self, cubes: &[Cube]) -> HashSet<Cube> {
        let mut differing = HashSet::new();
        for some in cubes.chunks(SLAB_CELLS) {
            let cube = |index: usize| some.get(index).unwrap_or(&some[0]);
            let boxes = std::array::from_fn(|index| {
                let Cube { grid, first, edge } = *cube(index);
                self.grid.bounds(grid, first, edge)
            });
            let edges = std::array::from_fn(|index| self.grid.edge(cube(index).grid));
            let pairs = self.old.in_cubes(&boxes, edges).into_iter().zip(self.new.in_cubes(&boxes, edges));
            differing.extend(some.iter().zip(pairs).filter(|(_, (one, other))| one != other).map(|(cube, _)| *cube));
        }
        differing
    }
}
