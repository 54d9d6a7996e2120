//! Evaluates a tape on this CPU: as machine code, or by the interpreter.

use std::sync::atomic::AtomicBool;

use crate::tape::{LinearTape, Tape};
use crate::x86::{AVX2, AVX512, Isa};
use crate::{RenderError, Simd, portable, x86};

/// A tape made ready for this CPU.
#[derive(Debug)]
pub(crate) enum Evaluator {
    /// Machine code.
    X86(x86::Program),
    /// The interpreter.
    Portable(portable::Program),
}

/// Values of a tape's uniforms, as its evaluator reads them.
#[derive(Debug)]
pub(crate) enum Inputs {
    /// Of machine code.
    X86(x86::Uniforms),
    /// Of the interpreter.
    Portable(Vec<u32>),
}

/// Memory of a thread that evaluates.
#[derive(Debug)]
pub(crate) enum Frame {
    /// Of machine code.
    X86(x86::Frame),
    /// Of the interpreter.
    Portable(portable::Frame),
}

impl Evaluator {
    /// Evaluator of a tape with these instructions; `scalar` has none.
    pub(crate) fn new(tape: &Tape, simd: Simd) -> Result<Self, RenderError> {
        let compiled = |isa: &'static Isa| match x86::compile(&LinearTape::new(tape), isa) {
            Ok(program) => Ok(Self::X86(program)),
            Err(error) => Err(RenderError::Unavailable {
                requested: format!("--simd {simd}"),
                reason: format!("machine code can't be run ({error}); use --simd portable"),
            }),
        };
        match simd {
            Simd::Avx512 => compiled(&AVX512),
            Simd::Avx2 => compiled(&AVX2),
            Simd::Portable | Simd::Scalar => Ok(Self::Portable(portable::Program::new(&LinearTape::new(tape)))),
            Simd::Auto => Ok(Self::fastest(tape)),
        }
    }

    /// The fastest evaluator of a tape on this CPU.
    pub(crate) fn fastest(tape: &Tape) -> Self {
        let linear = LinearTape::new(tape);
        let isa = [&AVX512, &AVX2].into_iter().find(|isa| isa.is_available());
        match isa.map(|isa| x86::compile(&linear, isa)) {
            Some(Ok(program)) => return Self::X86(program),
            Some(Err(error)) => tracing::warn!(%error, "executable memory is refused: rendering by interpreter"),
            None => {}
        }
        Self::Portable(portable::Program::new(&linear))
    }

    /// Numbers that are evaluated together.
    pub(crate) fn lanes(&self) -> usize {
        match self {
            Self::X86(program) => program.lanes(),
            Self::Portable(_) => portable::LANES,
        }
    }

    /// Size of the machine code, if it is machine code.
    pub(crate) fn code_bytes(&self) -> Option<usize> {
        match self {
            Self::X86(program) => Some(program.code_bytes()),
            Self::Portable(_) => None,
        }
    }

    /// Values of the tape's uniforms.
    pub(crate) fn inputs(&self, uniforms: &[u32]) -> Inputs {
        match self {
            Self::X86(program) => Inputs::X86(program.uniforms(uniforms)),
            Self::Portable(_) => Inputs::Portable(uniforms.to_vec()),
        }
    }

    /// Memory of a thread.
    pub(crate) fn frame(&self) -> Frame {
        match self {
            Self::X86(program) => Frame::X86(program.frame()),
            Self::Portable(program) => Frame::Portable(program.frame()),
        }
    }

    /// Evaluates an entry of the tape. Arguments and results are rows of one length, a multiple of the lanes. Once
    /// `cancel` is set, it returns early, with meaningless results.
    ///
    /// # Panics
    /// If the frame or inputs are another evaluator's, or the arguments or results are another entry's.
    pub(crate) fn run(
        &self,
        entry: &str,
        frame: &mut Frame,
        inputs: &Inputs,
        cancel: &AtomicBool,
        arguments: &[f32],
        results: &mut [f32],
    ) {
        match (self, frame, inputs) {
            (Self::X86(program), Frame::X86(frame), Inputs::X86(uniforms)) => {
                program.run(entry, frame, uniforms, cancel, arguments, results);
            }
            (Self::Portable(program), Frame::Portable(frame), Inputs::Portable(uniforms)) => {
                program.run(entry, frame, uniforms, cancel, arguments, results);
            }
            _ => panic!("the frame and the inputs are another evaluator's"),
        }
    }
}

#[cfg(test)]
mod tests {
    use scene::real::Real;

    use super::*;
    use crate::tape::{Expr, record};

    const ENTRY: &str = "entry";

    /// Each way to evaluate a tape on this CPU.
    fn evaluators(tape: &Tape) -> Vec<(&'static str, Evaluator)> {
        let levels = [Simd::Avx512, Simd::Avx2, Simd::Portable].into_iter().filter(|simd| simd.is_available());
        let level = |simd: Simd| (simd.name(), Evaluator::new(tape, simd).expect("it is available"));
        let of_the_build = portable::Program::new(&LinearTape::new(tape)).of_the_build();
        levels.map(level).chain([("portable, baseline", Evaluator::Portable(of_the_build))]).collect()
    }

    /// Evaluates a formula of three numbers everywhere, and compares it with the reference.
    fn compare(name: &str, formula: impl Fn([Expr; 3]) -> Expr, reference: impl Fn([f32; 3]) -> f32) {
        let tape = record(|recording| recording.entry(ENTRY, |all: [Expr; 3]| vec![formula(all)]));
        let mut random = Generator(1);
        let mut number = || random.word() as f32 / (1 << 30) as f32 - 2.0;
        for (simd, evaluator) in evaluators(&tape) {
            let (inputs, mut frame) = (evaluator.inputs(tape.uniforms()), evaluator.frame());
            let (lanes, cancel) = (evaluator.lanes(), AtomicBool::new(false));
            for _ in 0..20 {
                let arguments: Vec<f32> = (0..3 * lanes).map(|_| number()).collect();
                let mut results = vec![0.0; lanes];
                evaluator.run(ENTRY, &mut frame, &inputs, &cancel, &arguments, &mut results);
                for (lane, result) in results.iter().enumerate() {
                    let given = [0, 1, 2].map(|place| arguments[place * lanes + lane]);
                    let want = reference(given);
                    assert_eq!(
                        (result + 0.0).to_bits(),
                        (want + 0.0).to_bits(),
                        "{name} by {simd} of {given:?}: {result} for {want}"
                    );
                }
            }
        }
    }

    /// Pseudo-random numbers (a linear congruential generator).
    #[derive(Clone)]
    struct Generator(u64);

    impl Generator {
        fn word(&mut self) -> u32 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 32) as u32
        }

        fn below(&mut self, count: usize) -> usize {
            self.word() as usize % count
        }
    }

    /// A random formula: equal generators give equal formulas for every arithmetic. `depth` bounds its branches and loops.
    fn random_formula<R: Real>(random: &mut Generator, given: &[R], depth: usize) -> R {
        let mut known = given.to_vec();
        for _ in 0..4 + random.below(12) {
            let [a, b, c] = std::array::from_fn(|_| known[random.below(known.len())]);
            let [d, e] = std::array::from_fn(|_| known[random.below(known.len())]);
            let number = random.below(100) as f32 / 32.0 - 1.5;
            let mask = match random.below(4) {
                0 => d.lt(e),
                1 => d.lt(e) & a.lt(b),
                2 => !d.below(number) | e.lt(a),
                // No lane, or all of them.
                _ => d.abs().below(if number < 0.0 { -1.0 } else { f32::MAX }),
            };
            let next = match random.below(if depth > 0 { 18 } else { 14 }) {
                0 => a + b,
                1 => a - b,
                2 => a * b,
                3 => a.mul_add(b, c),
                4 => a.mul_add(b.constant(number), c),
                5 => a.uniform(number).mul_add(b, c),
                6 => a.min(b),
                7 => a.max(b),
                8 => (a * number).floor(),
                9 => a.abs().sqrt(),
                10 => -a / (b.abs() + 0.5),
                11 => R::select(mask, a, b),
                // The sign of a zero is not defined.
                12 => {
                    let mixed = ((a + 0.0).to_bits() ^ (b + 0.0).to_bits()) * 0x9e37_79b9;
                    R::from_bits(((mixed >> 9) | 0x3f80_0000) & 0x3fff_ffff)
                }
                13 => a * a.constant(number),
                14 | 15 => {
                    let mut inner = random.clone();
                    random.word();
                    R::when(mask, a, || random_formula(&mut inner, &known, depth - 1))
                }
                16 => {
                    let inner = random.clone();
                    random.word();
                    let step = |(x, y): (R, R)| {
                        let known: Vec<R> = known.iter().copied().chain([x, y]).collect();
                        let next = random_formula(&mut inner.clone(), &known, depth - 1);
                        // Lanes leave at different times, with exchanged state.
                        (next.lt(c) | mask, (y, next))
                    };
                    R::repeat(1 + (number.abs() * 4.0) as u32, (a, b), step).1
                }
                _ => {
                    let (name, inner) =
                        (["step of 0", "step of 1", "step of 2", "step of 3"][depth], Generator(depth as u64));
                    let step = |(x, y): (R, R)| random_formula(&mut inner.clone(), &[x, y], depth - 1);
                    a.call(name, (a, b), step) + b.call(name, (b, c), step)
                }
            };
            // Small and no NaN, as in pictures.
            known.push(next.max(next.constant(-3.0)).min(next.constant(3.0)));
        }
        known[known.len() - 1]
    }

    #[test]
    fn random_formulas_give_the_reference_bits() {
        for seed in 0..300 {
            let depth = (seed % 4) as usize;
            compare(
                &format!("formula {seed}"),
                |all| random_formula(&mut Generator(seed), &all, depth),
                |all| random_formula(&mut Generator(seed), &all, depth),
            );
        }
    }

    macro_rules! compare {
        ($($name:literal: |$a:ident, $b:ident, $c:ident| $formula:expr;)*) => { $(
            {
                fn formula<R: Real>([$a, $b, $c]: [R; 3]) -> R {
                    let _ = ($a, $b, $c);
                    $formula
                }
                compare($name, formula::<Expr>, formula::<f32>);
            }
        )* };
    }

    #[test]
    fn the_machine_code_of_every_shipped_scene_is_small() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes");
        println!("| Scene | Recorded, ms | Compiled, ms | Size, KiB |\n|---|---|---|---|");
        for entry in std::fs::read_dir(folder).expect("the scenes are there") {
            let path = entry.expect("a folder can be read").path();
            if path.extension().is_none_or(|extension| extension != "json") {
                continue;
            }
            let job = scene::parse(&std::fs::read(&path).expect("a job file")).expect("a valid job");
            let start = std::time::Instant::now();
            let tape = crate::picture_tape::record_picture(&job.at(0).expect("a valid frame"));
            let recorded = start.elapsed();
            for isa in [&AVX512, &AVX2].into_iter().filter(|isa| isa.is_available()) {
                let start = std::time::Instant::now();
                let program = x86::compile(&LinearTape::new(&tape), isa).expect("it is available");
                let compiled = start.elapsed();
                let (name, size) = (path.file_stem().unwrap_or_default().display(), program.code_bytes());
                let ms = |time: std::time::Duration| time.as_secs_f64() * 1e3;
                println!(
                    "| {name}, {} lanes | {:.1} | {:.1} | {} |",
                    isa.lanes,
                    ms(recorded),
                    ms(compiled),
                    size >> 10
                );
                assert!(size <= 8 << 20, "{name} has {size} bytes of machine code");
            }
        }
    }

    #[test]
    fn every_operation_gives_the_reference_bits() {
        compare! {
            "add": |a, b, c| a + b;
            "add a constant": |a, b, c| a + 0.3;
            "sub": |a, b, c| a - b;
            "mul": |a, b, c| a * b;
            "div": |a, b, c| a / b;
            "fma": |a, b, c| a.mul_add(b, c);
            "fma, constant term": |a, b, c| a.mul_add(b, c.constant(0.7));
            "fma, constant factor": |a, b, c| a.mul_add(b.constant(0.7), c);
            "fma of two constants": |a, b, c| a.mul_add(b.constant(0.7), c.constant(-0.2));
            "fma of a square": |a, b, c| a.mul_add(a, a);
            "min": |a, b, c| a.min(b);
            "max": |a, b, c| a.max(b);
            "neg": |a, b, c| -a;
            "abs": |a, b, c| a.abs();
            "floor": |a, b, c| (a * 7.0).floor();
            "sqrt": |a, b, c| a.sqrt();
            "select": |a, b, c| R::select(a.lt(b), b, c);
            "and": |a, b, c| R::select(a.lt(b) & b.lt(c), b, c);
            "or": |a, b, c| R::select(a.lt(b) | b.lt(c), b, c);
            "not": |a, b, c| R::select(!a.lt(b), b, c);
            "bits": |a, b, c| {
                let mixed = ((a.to_bits() & 0x7f_ffff) + b.to_bits() * 3) ^ (c.to_bits() << 3);
                R::from_bits(((mixed >> 9) | 0x3f80_0000) & 0x3fff_ffff)
            };
            "uniform": |a, b, c| a * a.uniform(3.5) + b.uniform(0.25);
            "when": |a, b, c| R::when(a.lt(b), c, || a.sqrt() + b);
            "repeat": |a, b, c| R::repeat(9, a, |x| { let next = x * 0.7 + b; (next.abs().lt(c.abs()), next) });
            "call": |a, b, c| a.call("step", (a, b), |(a, b): (R, R)| a * b + 1.0) + c.call("step", (c, a), |(a, b): (R, R)| a * b + 1.0);
            "loop in a branch in a loop": |a, b, c| R::repeat(5, (a, c), |(x, y)| {
                let inner = R::when(x.lt(b), y, || R::repeat(4, y, |z| { let z = z.mul_add(a, b); (z.lt(c), z) }));
                (inner.abs().below(1.5), (inner * 0.6 + x * 0.3, x))
            }).0;
        }
    }
}
