//! Formulas: numbers written as arithmetic, such as `0.2 * sin(360 * t)`.
//!
//! A formula is parsed (`grammar.rs`), then its names are replaced by what they stand for and all that does not depend on
//! time is computed (`expr.rs`). If anything is left, it becomes a list of steps, which is evaluated for each frame
//! (`program.rs`). There are no loops, and at most [`MAX_FORMULA_STEPS`] steps, so that none takes longer than a fraction
//! of a millisecond. Values are `f32`; every function is exact or one of `real`, so that all machines compute the same
//! bits. `functions.rs` has the functions.

mod expr;
mod functions;
mod grammar;
mod program;
mod slips;

pub use expr::{Expr, resolve};
pub use functions::{FUNCTIONS, Function};
pub use grammar::{Syntax, is_name, parse};
pub use program::Formula;

use std::sync::Arc;

/// Maximum number of operations of a formula, including its names' formulas.
pub const MAX_FORMULA_STEPS: u32 = 1_000;
/// Maximum length of a formula's text.
pub(crate) const MAX_FORMULA_BYTES: usize = 1_000;
/// Maximum nesting of parentheses in a formula.
const MAX_FORMULA_DEPTH: usize = 32;

/// Names that every formula may use, with what they stand for.
pub const NAMES: [(&str, &str); 6] = [
    ("t", "time of the frame, in seconds"),
    ("frame", "number of the frame, from 0"),
    ("frames", "number of frames of the job"),
    ("i", "number of the copy, from 0, where copies are counted"),
    ("n", "number of copies, where copies are counted"),
    ("pi", "3.1415927"),
];

/// An error in a formula.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FormulaError {
    /// Byte offset in the formula's text.
    pub at: usize,
    /// The problem and its fix, worded to follow a position.
    pub message: String,
    /// Whether an operation on numbers has no finite value, which a branch that is not taken may have.
    is_not_finite: bool,
}

impl FormulaError {
    fn new(at: usize, message: impl Into<String>) -> Self {
        Self { at, message: message.into(), is_not_finite: false }
    }
}

/// The numbers that the names in a formula stand for.
pub trait Names {
    /// The number that a name stands for; `None` if it is not known here. `t`, `frame` and `pi` are not asked for.
    fn get(&mut self, name: &str) -> Option<Arc<Expr>>;

    /// Where to define a name that is not known.
    fn place(&self) -> &'static str {
        "the scene's numbers"
    }

    /// Whether what is being read is copied, by copies that are counted.
    fn is_copied(&self) -> bool {
        false
    }

    /// All known names, for suggestions.
    fn all(&self) -> Vec<String>;
}
