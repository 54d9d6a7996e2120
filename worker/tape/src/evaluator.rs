//! Evaluates a tape on this CPU: as machine code, or by the interpreter.

use std::sync::Once;
use std::sync::atomic::AtomicBool;

use math::real::Table;

use crate::simd::{Simd, Unavailable};
use crate::tape::{InvalidTape, LinearTape, Tape};
use crate::x86::{AVX2, AVX512, Isa};
use crate::{portable, x86};

/// Reason why a tape cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum EvaluatorError {
    /// This machine cannot evaluate with this level.
    #[error(transparent)]
    Unavailable(#[from] Unavailable),
    /// The tape was recorded wrongly.
    #[error(transparent)]
    InvalidTape(#[from] InvalidTape),
}

/// A tape made ready for this CPU.
#[derive(Debug)]
pub struct Evaluator(Code);

#[derive(Debug)]
enum Code {
    /// Machine code.
    X86(x86::Program),
    /// The interpreter.
    Portable(portable::Program),
}

/// Values of a tape's uniforms, as its evaluator reads them.
#[derive(Debug)]
pub struct Inputs(Values);

#[derive(Debug)]
enum Values {
    /// Of machine code.
    X86(x86::Uniforms),
    /// Of the interpreter.
    Portable(Vec<u32>, Table),
}

impl Inputs {
    /// The cells of the scene, if it has any.
    pub fn table(&self) -> Option<&Table> {
        let table = match &self.0 {
            Values::X86(uniforms) => uniforms.table(),
            Values::Portable(_, table) => Some(table),
        };
        table.filter(|table| table.capacity() > 1)
    }
}

/// Memory of a thread that evaluates.
#[derive(Debug)]
pub struct Frame(Memory);

#[derive(Debug)]
enum Memory {
    /// Of machine code.
    X86(x86::Frame),
    /// Of the interpreter.
    Portable(portable::Frame),
}

impl Evaluator {
    /// Evaluator of a tape with these instructions; `scalar` has none.
    pub fn new(tape: &Tape, simd: Simd) -> Result<Self, EvaluatorError> {
        simd.check()?;
        let linear = LinearTape::new(tape)?;
        let compiled = |isa: &'static Isa| match x86::compile(&linear, isa) {
            Ok(program) => Ok(Self(Code::X86(program))),
            Err(error) => Err(Unavailable {
                simd,
                reason: format!("executable memory is refused ({error}); allow it, or use --simd portable"),
            }
            .into()),
        };
        match simd {
            Simd::Avx512 => compiled(&AVX512),
            Simd::Avx2 => compiled(&AVX2),
            Simd::Portable | Simd::Scalar => Ok(Self::interpreter(&linear)),
            Simd::Auto => Ok(Self::fastest_of(&linear)),
        }
    }

    /// Each way to evaluate a tape on this CPU, with its name: the levels, and the interpreter without vector
    /// instructions that the build does not assume.
    pub fn each(tape: &Tape) -> Result<Vec<(&'static str, Self)>, EvaluatorError> {
        let levels = [Simd::Avx512, Simd::Avx2, Simd::Portable].into_iter().filter(|simd| simd.is_available());
        let mut all = Vec::new();
        for simd in levels {
            all.push((simd.name(), Self::new(tape, simd)?));
        }
        let baseline = portable::Program::new(&LinearTape::new(tape)?).of_the_build();
        all.push(("portable, baseline", Self(Code::Portable(baseline))));
        Ok(all)
    }

    /// The fastest evaluator of a tape on this CPU.
    pub fn fastest(tape: &Tape) -> Result<Self, InvalidTape> {
        Ok(Self::fastest_of(&LinearTape::new(tape)?))
    }

    fn fastest_of(linear: &LinearTape) -> Self {
        let isa = [&AVX512, &AVX2].into_iter().find(|isa| isa.is_available());
        match isa.map(|isa| x86::compile(linear, isa)) {
            Some(Ok(program)) => return Self(Code::X86(program)),
            Some(Err(error)) => warn_of_refusal(&error),
            None => {}
        }
        Self::interpreter(linear)
    }

    fn interpreter(linear: &LinearTape) -> Self {
        Self(Code::Portable(portable::Program::new(linear)))
    }

    /// Numbers that are evaluated together.
    pub fn lanes(&self) -> usize {
        match &self.0 {
            Code::X86(program) => program.lanes(),
            Code::Portable(_) => portable::LANES,
        }
    }

    /// Size of the machine code, if it is machine code.
    pub fn code_bytes(&self) -> Option<usize> {
        match &self.0 {
            Code::X86(program) => Some(program.code_bytes()),
            Code::Portable(_) => None,
        }
    }

    /// Values of a tape's uniforms, and its table.
    pub fn inputs(&self, tape: &Tape) -> Inputs {
        let (numbers, table) = (tape.uniforms(), tape.table().cloned());
        Inputs(match &self.0 {
            Code::X86(program) => Values::X86(program.uniforms(numbers, table)),
            Code::Portable(_) => Values::Portable(numbers.to_vec(), table.unwrap_or_default()),
        })
    }

    /// Memory of a thread.
    pub fn frame(&self) -> Frame {
        Frame(match &self.0 {
            Code::X86(program) => Memory::X86(program.frame()),
            Code::Portable(program) => Memory::Portable(program.frame()),
        })
    }

    /// Evaluates an entry of the tape. Arguments and results are rows of one length, a multiple of the lanes. Once
    /// `cancel` is set, it returns early, with meaningless results.
    ///
    /// # Panics
    /// If the frame or inputs are another evaluator's, or the arguments or results are another entry's.
    pub fn run(
        &self,
        entry: &str,
        frame: &mut Frame,
        inputs: &Inputs,
        cancel: &AtomicBool,
        arguments: &[f32],
        results: &mut [f32],
    ) {
        match (&self.0, &mut frame.0, &inputs.0) {
            (Code::X86(program), Memory::X86(frame), Values::X86(uniforms)) => {
                program.run(entry, frame, uniforms, cancel, arguments, results);
            }
            (Code::Portable(program), Memory::Portable(frame), Values::Portable(uniforms, table)) => {
                program.run(entry, frame, (uniforms, table), cancel, arguments, results);
            }
            _ => panic!("the frame and the inputs are another evaluator's"),
        }
    }
}

/// Warns, once in this process, that machine code can't be run.
fn warn_of_refusal(error: &std::io::Error) {
    static WARNED: Once = Once::new();
    WARNED.call_once(|| {
        tracing::warn!(
            %error,
            "this system refuses executable memory, so pictures are computed by the interpreter: the same bytes, but \
             slower; allow it (systemd: MemoryDenyWriteExecute=no), or request this with --simd portable"
        );
    });
}
