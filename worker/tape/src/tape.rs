//! A recorded formula: the implementation of [`math::real::Real`] that evaluates nothing. Recording runs a
//! formula once on symbols; source for a compiler is generated from the tape.
//!
//! The tape is typed and in static single assignment form: each value is defined once, before its uses, in a
//! block that encloses them. `verify.rs` checks that before a back end reads the tape. Nothing here depends on GPUs.

mod allocate;
mod c_source;
mod expr;
mod fold_step;
mod linear;
mod liveness;
#[cfg(test)]
mod mutants;
mod recorder;
#[cfg(test)]
mod same_function;
#[cfg(test)]
mod scalar;
mod source;
mod verify;
mod wgsl_source;

use math::real::Table;

pub(crate) use allocate::{Allocation, Location, Registers, allocate};
pub use expr::{BoolExpr, Expr, U32Expr};
pub(crate) use fold_step::{FoldStep, ListFunctionLayout};
pub use linear::PAUSE;
pub(crate) use linear::{Class, Linear, LinearTape, Step, Var};
#[cfg(test)]
pub(crate) use recorder::record_and_compare;
pub use recorder::{Recording, record};
pub use source::SourceText;
pub use verify::{InvalidTape, VerifiedTape};

/// A value of the tape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct ValueId(u32);

/// Type of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum ValueType {
    /// An IEEE-754 binary32.
    F32,
    /// True or false.
    Bool,
    /// An unsigned integer of 32 bits.
    U32,
}

/// Operation that defines a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Operation {
    /// Constant of the formula, by its bits: part of the code.
    Constant(u32),
    /// Uniform of the scene, by its index in [`Tape::uniforms`]: data.
    Uniform(u32),
    /// Word of the row of the enclosing function, by its index in the row.
    Row(u32),
    /// Argument of the enclosing function.
    Argument,
    /// Result of a function call.
    CallResult,
    /// Variable assigned by a `when` or a `repeat`.
    Variable,
    /// Sum.
    Add,
    /// Difference.
    Sub,
    /// Product.
    Mul,
    /// Quotient.
    Div,
    /// Fused product and sum.
    Fma,
    /// Minimum.
    Min,
    /// Maximum.
    Max,
    /// Negation.
    Neg,
    /// Absolute value.
    Abs,
    /// Floor.
    Floor,
    /// Square root.
    Sqrt,
    /// Whether the first is less than the second.
    Less,
    /// And.
    And,
    /// Or.
    Or,
    /// Not.
    Not,
    /// Select: the second operand if the first is true, otherwise the third.
    Select,
    /// The bits of a number.
    ToBits,
    /// The number with these bits.
    FromBits,
    /// Sum of integers.
    AddU32,
    /// Product of integers.
    MulU32,
    /// Bits in one but not both.
    Xor,
    /// Bits in both.
    AndU32,
    /// Bits in any.
    OrU32,
    /// Bits shifted left.
    ShiftLeft,
    /// Bits shifted right.
    ShiftRight,
    /// Word of the tape's table at an index, or at the table's last if that is less.
    Word,
    /// Word in place of one that says that its contents do not exist; the index of the table's last word.
    Made,
}

impl Operation {
    /// Whether it needs no statement: it is written where it is used.
    fn is_constant(self) -> bool {
        matches!(self, Self::Constant(_) | Self::Uniform(_) | Self::Row(_))
    }

    /// Types of its operands and of its result; `None` for values that have any type.
    fn signature(self) -> (&'static [ValueType], Option<ValueType>) {
        use ValueType::{Bool, F32, U32};
        match self {
            Self::Constant(_)
            | Self::Uniform(_)
            | Self::Row(_)
            | Self::Argument
            | Self::CallResult
            | Self::Variable => (&[], None),
            Self::Neg | Self::Abs | Self::Floor | Self::Sqrt => (&[F32], Some(F32)),
            Self::Add | Self::Sub | Self::Mul | Self::Div | Self::Min | Self::Max => (&[F32, F32], Some(F32)),
            Self::Fma => (&[F32, F32, F32], Some(F32)),
            Self::Less => (&[F32, F32], Some(Bool)),
            Self::And | Self::Or => (&[Bool, Bool], Some(Bool)),
            Self::Not => (&[Bool], Some(Bool)),
            Self::Select => (&[Bool, F32, F32], Some(F32)),
            Self::ToBits => (&[F32], Some(U32)),
            Self::FromBits => (&[U32], Some(F32)),
            Self::AddU32
            | Self::MulU32
            | Self::Xor
            | Self::AndU32
            | Self::OrU32
            | Self::ShiftLeft
            | Self::ShiftRight
            | Self::Word
            | Self::Made => (&[U32, U32], Some(U32)),
        }
    }

    /// Number of its operands.
    pub(crate) fn operand_count(self) -> usize {
        self.signature().0.len()
    }

    /// See [`Tape::flops_per_call`].
    fn cost(self) -> u64 {
        match self {
            Self::Add | Self::Sub | Self::Mul | Self::Min | Self::Max | Self::Floor => 1,
            Self::Fma => 2,
            Self::Sqrt => 7,
            Self::Div => 10,
            Self::Constant(_)
            | Self::Uniform(_)
            | Self::Row(_)
            | Self::Argument
            | Self::CallResult
            | Self::Variable
            | Self::Neg
            | Self::Abs
            | Self::Less
            | Self::And
            | Self::Or
            | Self::Not
            | Self::Select
            | Self::ToBits
            | Self::FromBits
            | Self::AddU32
            | Self::MulU32
            | Self::Xor
            | Self::AndU32
            | Self::OrU32
            | Self::ShiftLeft
            | Self::ShiftRight
            | Self::Word
            | Self::Made => 0,
        }
    }

    /// Whether its two operands are interchangeable.
    pub(crate) fn is_commutative(self) -> bool {
        matches!(
            self,
            Self::Add
                | Self::Mul
                | Self::And
                | Self::Or
                | Self::AddU32
                | Self::MulU32
                | Self::Xor
                | Self::AndU32
                | Self::OrU32
        )
    }
}

/// A value's definition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Instruction {
    kind: ValueType,
    operation: Operation,
    operands: [Option<ValueId>; 3],
}

/// Statement of a block.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Statement {
    /// Computes a value.
    Emit(ValueId),
    /// The following statements belong to a node of this name.
    Comment(&'static str),
    /// Calls a function.
    Call { function: usize, arguments: Vec<ValueId>, returned: Vec<ValueId> },
    /// Assigns `value` to the variables if the condition is true, otherwise `otherwise`.
    When {
        condition: ValueId,
        variables: Vec<ValueId>,
        otherwise: Vec<ValueId>,
        body: Vec<Statement>,
        value: Vec<ValueId>,
    },
    /// Assigns `start` to the variables, then runs the body and assigns `next`, while `again` holds. If it `pauses`, it may
    /// also stop where `again` holds in few lanes.
    Repeat {
        limit: u32,
        pauses: bool,
        variables: Vec<ValueId>,
        start: Vec<ValueId>,
        body: Vec<Statement>,
        next: Vec<ValueId>,
        again: ValueId,
    },
    /// Folds the list that begins at a word of the table, see [`math::real::list`].
    Fold(Fold),
}

/// A statement that folds a list.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Fold {
    /// Index of the list's first word.
    list: ValueId,
    /// Index of the table's last word.
    last: ValueId,
    /// Coordinates of the point.
    arguments: Vec<ValueId>,
    /// Functions of rows: of the point, and of two values one after another.
    leaves: Vec<usize>,
    joins: Vec<usize>,
    /// Maximum number of values that wait.
    depth: u32,
    returned: Vec<ValueId>,
}

impl Fold {
    /// Functions of its leaves and joins.
    fn functions(&self) -> impl Iterator<Item = usize> + '_ {
        self.leaves.iter().chain(&self.joins).copied()
    }
}

/// A step of the formula, called by name.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Function {
    name: &'static str,
    arguments: Vec<ValueId>,
    body: Vec<Statement>,
    results: Vec<ValueId>,
    /// Whether code outside the tape calls it: then all its arguments and results stay.
    is_entry: bool,
    /// Number of words of its row, if it is a function of lists: then all its arguments and results stay.
    row_words: Option<u32>,
}

impl Function {
    /// Whether it has all its arguments and results, used or not.
    fn keeps_all(&self) -> bool {
        self.is_entry || self.row_words.is_some()
    }
}

/// A recorded formula.
#[derive(Clone, Debug, Default)]
pub struct Tape {
    instructions: Vec<Instruction>,
    /// Callees before their callers.
    functions: Vec<Function>,
    uniforms: Vec<u32>,
    /// Words read by computed indices.
    table: Option<Table>,
}

impl Tape {
    /// Uniforms of the scene, by their bits, in the order of their use.
    pub fn uniforms(&self) -> &[u32] {
        &self.uniforms
    }

    /// Number of its values.
    pub fn values(&self) -> usize {
        self.instructions.len()
    }

    /// Words that the formula reads by computed indices, if there are any.
    pub fn table(&self) -> Option<&Table> {
        self.table.as_ref()
    }

    /// Arithmetic operations in one call of a step. A fused operation counts as 2, a root as 7 and a quotient
    /// as 10 (their cost on a GPU); `None` if the step has loops or branches.
    pub fn flops_per_call(&self, step: &str) -> Option<u64> {
        let function = self.functions.iter().find(|function| function.name == step)?;
        let of_statement = |statement: &Statement| match statement {
            Statement::Emit(id) => Some(self.definition(*id).operation.cost()),
            Statement::Comment(_) => Some(0),
            Statement::Call { function, .. } => self.flops_per_call(self.functions[*function].name),
            Statement::When { .. } | Statement::Repeat { .. } | Statement::Fold(_) => None,
        };
        function.body.iter().map(of_statement).sum()
    }

    /// Whether the tapes differ at most in the values of their uniforms and in their tables, so that one evaluator serves both.
    pub fn has_same_code(&self, other: &Self) -> bool {
        let Self { instructions, functions, uniforms, table } = self;
        *instructions == other.instructions
            && *functions == other.functions
            && uniforms.len() == other.uniforms.len()
            && table.is_some() == other.table.is_some()
    }

    /// The same code, with this table.
    pub fn with_table(self, table: Table) -> Self {
        Self { table: Some(table), ..self }
    }

    /// The same code, with an empty table.
    pub fn without_table(&self) -> Self {
        Self { table: self.table.as_ref().map(|_| Table::default()), ..self.clone() }
    }

    fn definition(&self, id: ValueId) -> Instruction {
        self.instructions[id.0 as usize]
    }
}
