//! Which scenes are rendered by cells. It follows from the scene alone, so that all devices render the same bits.

use super::coverage::MatteIds;
use super::ray_boxes::RayBoxes;
use super::{Integrator, shrink, surfaces_of};
use crate::animation::JobAtFrame;
use crate::bounds::Bounds;
use crate::cells::{CellBuilder, Cells, ContentIds, Contents, Program};
use crate::job::Job;
use crate::materials::{Material, Texture};
use crate::real::Table;
use crate::visits::{VisitGrid, Visits};

/// Minimum number of leaves: below, straight code costs less than finding the cell of each point (measured on CPUs with
/// the shipped scenes: the largest has 88).
const MIN_LEAVES: usize = 96;

/// Number of nodes that a texture counts for in a kernel. All textures of a material are one function, and the time of a GPU's
/// compiler grows with its square: 34 textures took 4 s, 67 took 11 s and 133 took 36 s, 400 balls in a twist 2 s.
const NODES_OF_A_TEXTURE: u32 = 8;

/// The program of a scene that is rendered by cells: of many leaves, in few families, which all rays see.
fn program<'a>(at_frame: &'a JobAtFrame<'_>) -> Option<Program<'a>> {
    let (scene, moves) = (at_frame.scene(), at_frame.is_animated());
    if (scene.nodes() as usize) < MIN_LEAVES || scene.objects.iter().any(|object| !object.visible.is_full()) {
        return None;
    }
    let objects: Vec<_> =
        surfaces_of(scene).map(|index| (index, shrink(scene.objects[index].shape.lipschitz(), moves))).collect();
    let ids = MatteIds::of(at_frame);
    let program = Program::with_layers(scene, at_frame.next_scene(), ids.objects(), &objects);
    program.filter(|program| program.leaf_count() >= MIN_LEAVES)
}

impl<'a> Integrator<'a> {
    /// Prepares the integrator of a picture of one frame: with cells, if the scene has many shapes.
    pub fn of_picture(at_frame: &'a JobAtFrame<'_>, how: &dyn CellBuilder) -> Self {
        let own = Self::new(at_frame);
        let cells = program(at_frame).map(|program| {
            let reach = super::reach(own.bounds, &own.view, own.scene.march.max_distance.in_frame());
            Cells::new(program, reach, how)
        });
        // Cells have other parts of rays.
        let ray_boxes = own.ray_boxes.filter(|_| cells.is_none());
        Self { ray_boxes, cells, ..own }
    }

    /// The table of the scene's cells, if it has any.
    pub fn table(&self) -> Option<&Table> {
        self.cells.as_ref().map(|cells| cells.tree().words())
    }
}

impl<'a> Integrator<'a> {
    /// Prepares the integrator of a picture of one frame that records what its rays ask for; `None` if that is not known:
    /// of a frame with motion blur, of a scene of cells, or one whose surfaces can't be cut into leaves.
    pub fn recording(at_frame: &'a JobAtFrame<'_>) -> Option<Self> {
        let own = Self::new(at_frame);
        let program = own.recordable(at_frame)?;
        let bounds = Contents::new(program, own.scene, &mut ContentIds::new(false)).bounds();
        let grid = VisitGrid::around(bounds.unwrap_or(Bounds::symmetric(1.0, 1.0, 1.0)));
        let visits = Visits::new(grid, own.scene.used_materials().len());
        Some(Self { visits: Some(visits), ..own })
    }

    /// The record that its formulas write.
    pub fn visits(&self) -> Option<&Visits> {
        self.visits.as_ref()
    }

    /// The program of a scene whose rays can be recorded.
    pub(crate) fn recordable(&self, at_frame: &'a JobAtFrame<'_>) -> Option<Program<'a>> {
        let scene = at_frame.scene();
        if at_frame.is_blurred()
            || at_frame.next_scene().is_some()
            || !at_frame.mattes().is_empty()
            || program(at_frame).is_some()
            || scene.objects.iter().any(|object| !object.visible.is_full())
        {
            return None;
        }
        self.program_of(surfaces_of(scene))
    }

    fn program_of(&self, objects: impl Iterator<Item = usize>) -> Option<Program<'a>> {
        let objects: Vec<_> = objects.map(|index| (index, self.step_scales[index])).collect();
        Program::new(self.scene, &objects)
    }

    /// The boxes of objects that marches evaluate only there, by their bits.
    pub(crate) fn ray_boxes(&self) -> &[Bounds] {
        self.ray_boxes.as_ref().map_or(&[], RayBoxes::boxes)
    }

    /// The program of the objects in some boxes, given the bits of these, and of the objects without boxes if those are wanted;
    /// `None` if there are no such objects.
    pub(crate) fn program_in_boxes(&self, bits: u32, with_others: bool) -> Option<Program<'a>> {
        let is_wanted = |object: &usize| match self.ray_boxes.as_ref().and_then(|boxes| boxes.bit(*object)) {
            Some(bit) => bits >> bit & 1 != 0,
            None => with_others,
        };
        let objects: Vec<usize> = surfaces_of(self.scene).filter(is_wanted).collect();
        (!objects.is_empty())
            .then(|| self.program_of(objects.into_iter()).expect("a part of a scene is cut as the scene is"))
    }

    /// Whether two frames that differ only in surfaces and materials agree in everything that their pixels have in common.
    pub(crate) fn has_same_frame(&self, other: &Self) -> bool {
        let Self {
            // Compared by the frames' keys, or follow from what is compared.
            scene: _,
            view: _,
            origin: _,
            samples: _,
            frame_key: _,
            levels: _,
            tolerance: _,
            resolution: _,
            normal_epsilon: _,
            seen: _,
            media: _,
            rays: _,
            // Compared with what is in cells.
            step_scales: _,
            ray_boxes: _,
            // They change how values are found, and not the values.
            cull_bounds: _,
            shares_nearest: _,
            // Neither frame has any.
            next_frame: _,
            matte_ids: _,
            cells: _,
            visits: _,
            of_shadows: _,
            of_reflections: _,
            surfaces,
            materials,
            emitters,
            light_groups,
            sends_on,
            lets_through,
            bounds,
            max_past,
            fine,
        } = self;
        let is_lit = |one: &Self| one.materials.slots().any(|slot| one.scene.used_materials()[slot].is_lit());
        let are_bounds_equal = bounds.min == other.bounds.min && bounds.max == other.bounds.max;
        // Where only some surfaces are fine, their objects are found by index.
        let are_fine_equal =
            (fine.is_empty() && other.fine.is_empty()) || (*fine == other.fine && *surfaces == other.surfaces);
        are_bounds_equal
            && are_fine_equal
            && *max_past == other.max_past
            && *sends_on == other.sends_on
            && *lets_through == other.lets_through
            && materials.is_alike(&other.materials)
            && emitters.is_alike(&other.emitters)
            && *light_groups == other.light_groups
            && is_lit(self) == is_lit(other)
    }
}

/// Number of nodes and textures whose formulas a kernel has, which limits the scenes of a GPU: all of them, or one
/// leaf's of each family if the scene is rendered by cells.
pub fn compiled_nodes(job: &Job) -> u32 {
    job.at(0).map_or_else(|_| job.nodes(), |at_frame| frame_compiled_nodes(&at_frame))
}

/// Number of nodes and textures whose formulas the kernel of a frame has, as [`compiled_nodes`].
pub fn frame_compiled_nodes(at_frame: &JobAtFrame<'_>) -> u32 {
    let scene = at_frame.scene();
    let nodes = program(at_frame).map_or_else(|| scene.nodes(), |program| program.family_nodes());
    let textures = scene.used_materials().iter().flat_map(Material::textures).map(Texture::count);
    textures.fold(nodes, |sum, count| sum.saturating_add(count.saturating_mul(NODES_OF_A_TEXTURE)))
}
