//! Evaluates a tape on this CPU: as machine code, or by the interpreter.

use std::sync::Once;
use std::sync::atomic::AtomicBool;

use scene::real::Table;

use crate::tape::{InvalidTape, LinearTape, Tape};
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
    Portable(Vec<u32>, Table),
}

impl Inputs {
    /// The cells of the scene, if it has any.
    pub(crate) fn table(&self) -> Option<&Table> {
        let table = match self {
            Self::X86(uniforms) => uniforms.table(),
            Self::Portable(_, table) => Some(table),
        };
        table.filter(|table| table.capacity() > 1)
    }
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
        simd.check()?;
        let linear = LinearTape::new(tape)?;
        let compiled = |isa: &'static Isa| match x86::compile(&linear, isa) {
            Ok(program) => Ok(Self::X86(program)),
            Err(error) => Err(RenderError::Unavailable {
                requested: format!("--simd {simd}"),
                reason: format!("executable memory is refused ({error}); allow it, or use --simd portable"),
            }),
        };
        match simd {
            Simd::Avx512 => compiled(&AVX512),
            Simd::Avx2 => compiled(&AVX2),
            Simd::Portable | Simd::Scalar => Ok(Self::Portable(portable::Program::new(&linear))),
            Simd::Auto => Ok(Self::fastest_of(&linear)),
        }
    }

    /// The fastest evaluator of a tape on this CPU.
    pub(crate) fn fastest(tape: &Tape) -> Result<Self, InvalidTape> {
        Ok(Self::fastest_of(&LinearTape::new(tape)?))
    }

    fn fastest_of(linear: &LinearTape) -> Self {
        let isa = [&AVX512, &AVX2].into_iter().find(|isa| isa.is_available());
        match isa.map(|isa| x86::compile(linear, isa)) {
            Some(Ok(program)) => return Self::X86(program),
            Some(Err(error)) => warn_of_refusal(&error),
            None => {}
        }
        Self::Portable(portable::Program::new(linear))
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

    /// Values of a tape's uniforms, and its table.
    pub(crate) fn inputs(&self, tape: &Tape) -> Inputs {
        match self {
            Self::X86(program) => Inputs::X86(program.uniforms(tape.uniforms(), tape.table().cloned())),
            Self::Portable(_) => Inputs::Portable(tape.uniforms().to_vec(), tape.table().cloned().unwrap_or_default()),
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
            (Self::Portable(program), Frame::Portable(frame), Inputs::Portable(uniforms, table)) => {
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

#[cfg(test)]
pub(super) mod tests;
