//! Compiling a scene: recording its formulas, and preparing them for each back end of this CPU.

use std::time::Instant;

use scene::Job;
use serde::Serialize;
use tape::Evaluator;

use super::Spread;
use crate::cells::FastBuilder;
use crate::picture_tape::record_picture;
use crate::{RenderError, Simd};

/// Times of compiling a scene.
#[derive(Clone, Debug, Serialize)]
pub struct CompileReport {
    /// The job's name.
    pub job: String,
    /// Recording the formulas of the picture, in milliseconds.
    pub record_ms: Spread,
    /// Each back end of this CPU.
    pub back_ends: Vec<BackEndReport>,
}

/// Times of preparing recorded formulas for one back end.
#[derive(Clone, Debug, Serialize)]
pub struct BackEndReport {
    /// Its name, as `--simd` spells it.
    pub simd: &'static str,
    /// Preparing, in milliseconds.
    pub prepare_ms: Spread,
    /// Size of the machine code; `None` if there is none, because the back end interprets.
    pub code_bytes: Option<usize>,
}

/// Back ends that prepare a scene.
const BACK_ENDS: [Simd; 3] = [Simd::Avx512, Simd::Avx2, Simd::Portable];

/// Compiles a scene several times for each back end that this CPU has.
pub fn compile(job: &Job, runs: usize) -> Result<CompileReport, RenderError> {
    let at_frame = job.at(0)?;
    let tape = record_picture(&at_frame, &FastBuilder::UNLIMITED);
    let record_ms = repeated(runs, || drop(record_picture(&at_frame, &FastBuilder::UNLIMITED)));
    let mut back_ends = Vec::new();
    for simd in BACK_ENDS.into_iter().filter(|simd| simd.is_available()) {
        let code_bytes = Evaluator::new(&tape, simd)?.code_bytes();
        let prepare_ms = repeated(runs, || drop(Evaluator::new(&tape, simd)));
        back_ends.push(BackEndReport { simd: simd.name(), prepare_ms, code_bytes });
    }
    Ok(CompileReport { job: job.name.clone(), record_ms, back_ends })
}

/// Milliseconds of several runs.
fn repeated(runs: usize, mut work: impl FnMut()) -> Spread {
    let run = |_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64() * 1e3
    };
    Spread::new((0..runs.max(1)).map(run).collect())
}
