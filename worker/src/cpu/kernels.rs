//! Kernels compute packets of pixels, by the reference or by a tape's evaluator. Evaluators are cached by their tapes,
//! and with their inputs by the pixels that they compute.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use scene::real::Table;
use scene::visits::Visits;
use scene::{Exposure, ImageSpec, Integrator, JobAtFrame};
use tape::{Evaluator, Frame, Inputs, Tape};

use crate::cells::{FastBuilder, KnownCells};
use crate::picture_tape::{ACCUMULATE, LAYERS, MEAN, layer_channels, record_entries, record_picture};
use crate::recent::{self, Recent};
use crate::{RenderError, Simd};

/// Maximum number of cached evaluators.
const MAX_EVALUATORS: usize = 16;
/// Maximum number of values in the tapes of all cached evaluators. Each takes about 64 bytes, with its machine code.
const MAX_CACHED_VALUES: usize = 4 << 20;
/// Maximum number of cached frames.
const MAX_FRAMES: usize = 4;

/// An evaluator with its inputs.
#[derive(Debug)]
pub(super) struct Prepared {
    pub(super) evaluator: Arc<Evaluator>,
    pub(super) inputs: Inputs,
}

/// A frame whose rays are recorded: its tape, with an empty record.
#[derive(Debug)]
pub(super) struct Recordable {
    evaluator: Arc<Evaluator>,
    tape: Tape,
    visits: Visits,
}

impl Recordable {
    /// A kernel of one instant that writes a new record, and that.
    pub(super) fn kernel(&self) -> (Arc<Vec<Prepared>>, Visits) {
        let visits = self.visits.another();
        let inputs = self.evaluator.inputs(&self.tape.clone().with_table(visits.table().clone()));
        (Arc::new(vec![Prepared { evaluator: self.evaluator.clone(), inputs }]), visits)
    }
}

/// Evaluators in use, those used last first.
#[derive(Debug, Default)]
pub(super) struct KernelCache {
    by_tape: Recent<Tape, Evaluator>,
    recordable: Recent<blake3::Hash, Recordable>,
    by_pixels: Recent<blake3::Hash, Vec<Prepared>>,
    cells: KnownCells,
}

impl KernelCache {
    /// Evaluators and inputs of a frame, one for each of its instants.
    pub(super) fn prepare(
        &self,
        exposure: &Exposure<'_>,
        simd: Simd,
        cells: FastBuilder,
    ) -> Result<Arc<Vec<Prepared>>, RenderError> {
        let key = exposure.pixels_cache_key();
        if let Some(known) = recent::find(&self.by_pixels, |other| *other == key) {
            return Ok(known);
        }
        let instants = exposure.instants.iter().map(|instant| self.prepare_instant(instant, simd, cells));
        let instants = instants.collect::<Result<Vec<Prepared>, _>>()?;
        Ok(recent::insert(&self.by_pixels, key, Arc::new(instants), MAX_FRAMES))
    }

    fn prepare_instant(
        &self,
        at_frame: &JobAtFrame<'_>,
        simd: Simd,
        cells: FastBuilder,
    ) -> Result<Prepared, RenderError> {
        let tape = record_picture(at_frame, &cells);
        let table = tape.table().map(|table| self.cells.share(at_frame, table));
        let tape = match table {
            Some(table) => tape.with_table(table),
            None => tape,
        };
        let evaluator = self.evaluator(&tape, simd)?;
        let inputs = evaluator.inputs(&tape);
        Ok(Prepared { evaluator, inputs })
    }

    /// A frame whose rays are recorded by this integrator.
    pub(super) fn recordable(
        &self,
        at_frame: &JobAtFrame<'_>,
        program: &Integrator<'_>,
        visits: &Visits,
        simd: Simd,
    ) -> Result<Arc<Recordable>, RenderError> {
        let key = at_frame.pixels_cache_key();
        if let Some(known) = recent::find(&self.recordable, |other| *other == key) {
            return Ok(known);
        }
        let tape = record_entries(program, at_frame);
        let evaluator = self.evaluator(&tape, simd)?;
        let recordable = Recordable { evaluator, tape: tape.without_table(), visits: visits.another() };
        Ok(recent::insert(&self.recordable, key, Arc::new(recordable), MAX_FRAMES))
    }

    fn evaluator(&self, tape: &Tape, simd: Simd) -> Result<Arc<Evaluator>, RenderError> {
        let known = recent::find(&self.by_tape, |other| other.has_same_code(tape));
        if let Some(known) = known {
            return Ok(known);
        }
        let evaluator = Arc::new(Evaluator::new(tape, simd)?);
        let evaluator = recent::insert(&self.by_tape, tape.without_table(), evaluator, MAX_EVALUATORS);
        recent::trim(&self.by_tape, MAX_CACHED_VALUES, Tape::values);
        Ok(evaluator)
    }

    /// Forgets a table of cells: the next [`KernelCache::prepare`] of its frames begins with none.
    pub(super) fn forget_cells(&self, table: &Table) {
        let is_it = |other: &Prepared| other.inputs.table().is_some_and(|other| Arc::ptr_eq(other, table));
        recent::forget(&self.by_pixels, |other: &Arc<Vec<Prepared>>| other.iter().any(is_it));
        self.cells.forget(table);
    }
}

/// Computes packets of pixels of one frame, at each of its instants.
#[derive(Debug)]
pub(super) enum Kernel<'a> {
    /// The scalar reference, a pixel at a time.
    Reference(Vec<Integrator<'a>>, &'a ImageSpec),
    /// A tape's evaluator.
    Prepared(Arc<Vec<Prepared>>),
}

/// A thread's use of a [`Kernel`].
pub(super) enum Thread<'a> {
    Reference(&'a [Integrator<'a>], &'a ImageSpec),
    /// With the memory for the evaluator that was used last: in general, all instants have the same one.
    Prepared(&'a [Prepared], Option<(&'a Arc<Evaluator>, Frame)>),
}

impl Kernel<'_> {
    /// Pixels of a packet.
    pub(super) fn lanes(&self) -> usize {
        match self {
            Self::Reference(..) => 1,
            Self::Prepared(prepared) => prepared[0].evaluator.lanes(),
        }
    }

    /// The cells of the scene at each instant, if it has any.
    pub(super) fn tables(&self) -> Vec<&Table> {
        match self {
            Self::Reference(programs, _) => programs.iter().filter_map(Integrator::table).collect(),
            Self::Prepared(prepared) => prepared.iter().filter_map(|one| one.inputs.table()).collect(),
        }
    }

    /// Memory for a thread.
    pub(super) fn thread(&self) -> Thread<'_> {
        match self {
            Self::Reference(programs, image) => Thread::Reference(programs, image),
            Self::Prepared(prepared) => Thread::Prepared(prepared, None),
        }
    }
}

impl Thread<'_> {
    /// Evaluates an entry of [`record_picture`] at an instant, see [`Evaluator::run`].
    pub(super) fn run(
        &mut self,
        instant: usize,
        entry: &str,
        cancel: &AtomicBool,
        arguments: &[f32],
        results: &mut [f32],
    ) {
        match self {
            Self::Reference(programs, image) => {
                results.copy_from_slice(&reference(&programs[instant], image, entry, arguments));
            }
            Self::Prepared(prepared, memory) => {
                let Prepared { evaluator, inputs } = &prepared[instant];
                let (_, frame) = match memory {
                    Some(memory) if Arc::ptr_eq(memory.0, evaluator) => memory,
                    _ => memory.insert((evaluator, evaluator.frame())),
                };
                evaluator.run(entry, frame, inputs, cancel, arguments, results);
            }
        }
    }
}

/// The same entries without a tape.
fn reference(program: &Integrator<'_>, image: &ImageSpec, entry: &str, arguments: &[f32]) -> Vec<f32> {
    match (entry, arguments) {
        (ACCUMULATE, &[x, y, first, end, ref sum @ ..]) => {
            program.accumulate(x, y, first, end, program.sum_of_channels(sum)).channels()
        }
        (MEAN, sum) => program.mean(program.sum_of_channels(sum)).channels(),
        (LAYERS, &[x, y]) => layer_channels(program, image, x, y),
        _ => panic!("{entry} has other arguments"),
    }
}
