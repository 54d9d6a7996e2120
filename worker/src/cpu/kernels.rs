//! Kernels compute packets of pixels, by the reference or by a tape's evaluator. Evaluators are cached by their tapes,
//! and with their inputs by the pixels that they compute.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use scene::integrator::Radiance;
use scene::real::{Real, Table, vec3};
use scene::visits::Visits;
use scene::{Image, Integrator, JobAtFrame};

use super::evaluator::{Evaluator, Frame, Inputs};
use crate::cells::{FastBuilder, KnownCells};
use crate::picture_tape::{ACCUMULATE, LAYERS, MEAN, channels, layer_channels, record_entries, record_picture};
use crate::recent::{self, Recent};
use crate::tape::Tape;
use crate::{RenderError, Simd};

/// Maximum number of cached evaluators.
const MAX_EVALUATORS: usize = 16;
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
    /// A kernel that writes a new record, and that.
    pub(super) fn kernel(&self) -> (Arc<Prepared>, Visits) {
        let visits = self.visits.another();
        let inputs = self.evaluator.inputs(&self.tape.clone().with_table(visits.table().clone()));
        (Arc::new(Prepared { evaluator: self.evaluator.clone(), inputs }), visits)
    }
}

/// Evaluators in use, those used last first.
#[derive(Debug, Default)]
pub(super) struct KernelCache {
    by_tape: Recent<Tape, Evaluator>,
    recordable: Recent<blake3::Hash, Recordable>,
    by_pixels: Recent<blake3::Hash, Prepared>,
    cells: KnownCells,
}

impl KernelCache {
    /// Evaluator and inputs of a frame.
    pub(super) fn prepare(
        &self,
        still: &JobAtFrame<'_>,
        simd: Simd,
        cells: FastBuilder,
    ) -> Result<Arc<Prepared>, RenderError> {
        let key = still.pixels_cache_key();
        if let Some(known) = recent::find(&self.by_pixels, |other| *other == key) {
            return Ok(known);
        }
        let tape = record_picture(still, cells);
        let table = tape.table().map(|table| self.cells.share(still, table));
        let tape = match table {
            Some(table) => tape.with_table(table),
            None => tape,
        };
        let evaluator = self.evaluator(&tape, simd)?;
        let inputs = evaluator.inputs(&tape);
        Ok(recent::insert(&self.by_pixels, key, Arc::new(Prepared { evaluator, inputs }), MAX_FRAMES))
    }

    /// A frame whose rays are recorded by this integrator.
    pub(super) fn recordable(
        &self,
        still: &JobAtFrame<'_>,
        program: &Integrator<'_>,
        visits: &Visits,
        simd: Simd,
    ) -> Result<Arc<Recordable>, RenderError> {
        let key = still.pixels_cache_key();
        if let Some(known) = recent::find(&self.recordable, |other| *other == key) {
            return Ok(known);
        }
        let tape = record_entries(program, still);
        let evaluator = self.evaluator(&tape, simd)?;
        let recordable = Recordable { evaluator, tape: tape.without_table(), visits: visits.another() };
        Ok(recent::insert(&self.recordable, key, Arc::new(recordable), MAX_FRAMES))
    }

    fn evaluator(&self, tape: &Tape, simd: Simd) -> Result<Arc<Evaluator>, RenderError> {
        let known = recent::find(&self.by_tape, |other| other.has_same_code(tape));
        Ok(match known {
            Some(known) => known,
            None => recent::insert(
                &self.by_tape,
                tape.without_table(),
                Arc::new(Evaluator::new(tape, simd)?),
                MAX_EVALUATORS,
            ),
        })
    }

    /// Forgets a table of cells: the next [`KernelCache::prepare`] of its frames begins with none.
    pub(super) fn forget_cells(&self, table: &Table) {
        let has_it = |other: &Arc<Prepared>| other.inputs.table().is_some_and(|other| Arc::ptr_eq(other, table));
        recent::forget(&self.by_pixels, has_it);
        self.cells.forget(table);
    }
}

/// Computes packets of pixels of one frame.
#[derive(Debug)]
pub(super) enum Kernel<'a> {
    /// The scalar reference, a pixel at a time.
    Reference(Box<Integrator<'a>>, &'a Image),
    /// A tape's evaluator.
    Prepared(Arc<Prepared>),
}

/// A thread's use of a [`Kernel`].
pub(super) enum Thread<'a> {
    Reference(&'a Integrator<'a>, &'a Image),
    Prepared(&'a Prepared, Frame),
}

impl Kernel<'_> {
    /// Pixels of a packet.
    pub(super) fn lanes(&self) -> usize {
        match self {
            Self::Reference(..) => 1,
            Self::Prepared(prepared) => prepared.evaluator.lanes(),
        }
    }

    /// The cells of the scene, if it has any.
    pub(super) fn table(&self) -> Option<&Table> {
        match self {
            Self::Reference(program, _) => program.table(),
            Self::Prepared(prepared) => prepared.inputs.table(),
        }
    }

    /// Memory for a thread.
    pub(super) fn thread(&self) -> Thread<'_> {
        match self {
            Self::Reference(program, image) => Thread::Reference(program, image),
            Self::Prepared(prepared) => Thread::Prepared(prepared, prepared.evaluator.frame()),
        }
    }
}

impl Thread<'_> {
    /// Evaluates an entry of [`record_picture`], see [`Evaluator::run`].
    pub(super) fn run(&mut self, entry: &str, cancel: &AtomicBool, arguments: &[f32], results: &mut [f32]) {
        match self {
            Self::Reference(program, image) => results.copy_from_slice(&reference(program, image, entry, arguments)),
            Self::Prepared(prepared, frame) => {
                prepared.evaluator.run(entry, frame, &prepared.inputs, cancel, arguments, results);
            }
        }
    }
}

/// The same entries without a tape.
fn reference(program: &Integrator<'_>, image: &Image, entry: &str, arguments: &[f32]) -> Vec<f32> {
    let sum = |parts: &[f32]| Radiance {
        color: vec3(parts[0], parts[1], parts[2]),
        alpha: parts[3],
        evaluations: parts[3].constant(0.0),
    };
    match (entry, arguments) {
        (ACCUMULATE, &[x, y, first, end, ..]) => {
            channels(program.accumulate(x, y, first, end, sum(&arguments[4..]))).to_vec()
        }
        (MEAN, all) => channels(program.mean(sum(all))).to_vec(),
        (LAYERS, &[x, y]) => layer_channels(&program.aovs(x, y), &image.layers),
        _ => panic!("{entry} has other arguments"),
    }
}
