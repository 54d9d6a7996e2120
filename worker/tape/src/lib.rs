//! Formulas recorded once, and evaluated as machine code, by an interpreter, or as source text for a compiler.
//!
//! ```
//! use std::sync::atomic::AtomicBool;
//!
//! use math::real::Real;
//! use tape::{Evaluator, Expr, record};
//!
//! fn length<R: Real>(x: R, y: R) -> R {
//!     (x * x + y * y).sqrt()
//! }
//!
//! let tape = record(|recording| recording.entry("length", |[x, y]: [Expr; 2]| vec![length(x, y)]));
//! let evaluator = Evaluator::fastest(&tape).expect("a recorded tape is valid");
//! let (inputs, mut frame, lanes) = (evaluator.inputs(&tape), evaluator.frame(), evaluator.lanes());
//! let arguments = [vec![3.0; lanes], vec![4.0; lanes]].concat();
//! let mut lengths = vec![0.0; lanes];
//! evaluator.run("length", &mut frame, &inputs, &AtomicBool::new(false), &arguments, &mut lengths);
//! assert_eq!(lengths, vec![length(3.0_f32, 4.0); lanes]);
//! ```

#[cfg(test)]
mod c_program;
mod evaluator;
pub mod interrupt;
#[cfg(test)]
#[expect(dead_code, unreachable_pub, reason = "the tests need pictures, and not everything that is recorded of them")]
#[path = "../../src/picture_tape.rs"]
mod picture_tape;
mod portable;
#[cfg(test)]
mod random_formula;
mod simd;
#[cfg(test)]
#[path = "../../../tests/skip.rs"]
mod skip;
mod tape;
mod x86;

pub use evaluator::{Evaluator, EvaluatorError, Frame, Inputs};
pub use portable::Instructions;
pub use simd::{Simd, Unavailable, UnknownSimd};
pub use tape::{BoolExpr, Expr, InvalidTape, PAUSE, Recording, SourceText, Tape, U32Expr, VerifiedTape, record};
