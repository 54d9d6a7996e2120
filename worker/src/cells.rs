//! Builds the cells of a scene by machine code, on the threads of the current pool.

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;
use scene::cells::{CellBuilder, FAMILY_NAMES, LeafDistances, Program};
use scene::real::{Real, Vec3, vec3};

use crate::cpu::{Evaluator, Inputs};
use crate::tape::{Expr, record};

/// Builds cells with the fastest evaluator of this CPU.
#[derive(Clone, Copy, Debug)]
pub struct FastBuilder;

/// Functions of a program's families.
struct Families<'a> {
    program: &'a Program<'a>,
    evaluator: Evaluator,
    inputs: Inputs,
}

impl CellBuilder for FastBuilder {
    fn evaluator<'a>(&self, program: &'a Program<'_>) -> Box<dyn LeafDistances + 'a> {
        let tape = record(|recording| {
            for (family, name) in FAMILY_NAMES.iter().enumerate().take(program.family_count()) {
                recording.entry(name, |[x, y, z, row]: [Expr; 4]| {
                    vec![program.family_distance(program.rows(), family, row.to_bits(), vec3(x, y, z))]
                });
            }
        });
        let evaluator = Evaluator::fastest(&tape).expect("a recorded tape is valid");
        Box::new(Families { program, inputs: evaluator.inputs(&tape), evaluator })
    }

    fn for_each(&self, count: usize, task: &(dyn Fn(usize) + Sync)) {
        (0..count).into_par_iter().with_max_len(1).for_each(task);
    }
}

impl LeafDistances for Families<'_> {
    fn append(&self, leaves: &[u32], points: &[Vec3<f32>], distances: &mut Vec<f32>) {
        /// Leaves that are evaluated together.
        const LEAVES: usize = 64;
        let first = distances.len();
        distances.resize(first + leaves.len() * points.len(), 0.0);
        let mut of_families = vec![Vec::new(); self.program.family_count()];
        for (place, &leaf) in leaves.iter().enumerate() {
            let (family, row) = self.program.family_and_row(leaf);
            of_families[family].push((place, row));
        }
        let (mut frame, cancel) = (self.evaluator.frame(), AtomicBool::new(false));
        let (mut arguments, mut results) = (Vec::new(), Vec::new());
        for (family, rows) in of_families.iter().enumerate() {
            for some in rows.chunks(LEAVES) {
                let count = some.len() * points.len();
                let length = count.next_multiple_of(self.evaluator.lanes());
                arguments.clear();
                let coordinates: [fn(&Vec3<f32>) -> f32; 3] = [|p| p.x, |p| p.y, |p| p.z];
                for coordinate in coordinates {
                    arguments.extend(points.iter().map(coordinate).cycle().take(length));
                }
                let rows = some.iter().flat_map(|(_, row)| std::iter::repeat_n(*row, points.len()));
                let last = some.last().map_or(0, |(_, row)| *row);
                arguments.extend(rows.chain(std::iter::repeat(last)).take(length).map(f32::from_bits));
                results.resize(length, 0.0);
                self.evaluator.run(FAMILY_NAMES[family], &mut frame, &self.inputs, &cancel, &arguments, &mut results);
                for ((place, _), values) in some.iter().zip(results.chunks_exact(points.len())) {
                    let to = first + place * points.len();
                    distances[to..to + points.len()].copy_from_slice(values);
                }
            }
        }
    }
}
