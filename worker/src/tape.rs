//! A recorded formula: the implementation of [`scene::real::Real`] that evaluates nothing. Recording runs a
//! formula once on symbols; source for a compiler is generated from the tape.
//!
//! The tape is typed and in static single assignment form: each value is defined once, before its uses, in a
//! block that encloses them. Nothing here knows of GPUs.

mod c_source;
mod expr;
mod liveness;
mod recorder;

pub use c_source::Text;
pub use expr::{Condition, Expr, Word};
pub use recorder::{Recording, record};

/// A value of the tape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Id(u32);

/// Type of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// An IEEE-754 binary32.
    Number,
    /// True or false.
    Condition,
    /// An unsigned integer of 32 bits.
    Word,
}

/// Operation that defines a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Operation {
    /// A number of the formula, by its bits: code.
    Literal(u32),
    /// A number of the scene, by its place in [`Tape::parameters`]: data.
    Parameter(u32),
    /// Argument of the enclosing function.
    Argument,
    /// Result of a function call.
    Returned,
    /// Variable assigned by a `when` or a `repeat`.
    Variable,
    /// Sum.
    Add,
    /// Difference.
    Subtract,
    /// Product.
    Multiply,
    /// Quotient.
    Divide,
    /// Fused product and sum.
    MultiplyAdd,
    /// The lesser.
    Least,
    /// The greater.
    Greatest,
    /// The opposite.
    Negate,
    /// Size without sign.
    Absolute,
    /// Whole part, downwards.
    Floor,
    /// Square root.
    Root,
    /// Whether the first is less than the second.
    Less,
    /// Both.
    And,
    /// One or both.
    Or,
    /// The other one.
    Not,
    /// The second where the first holds, else the third.
    Select,
    /// The bits of a number.
    ToBits,
    /// The number with these bits.
    FromBits,
    /// Sum of integers.
    AddWords,
    /// Product of integers.
    MultiplyWords,
    /// Bits in one but not both.
    Xor,
    /// Bits in both.
    AndWords,
    /// Bits in any.
    OrWords,
    /// Bits moved up.
    ShiftUp,
    /// Bits moved down.
    ShiftDown,
}

impl Operation {
    /// Whether it needs no code: it is written where it is used.
    fn is_constant(self) -> bool {
        matches!(self, Self::Literal(_) | Self::Parameter(_))
    }

    /// See [`Tape::operations`].
    fn cost(self) -> u64 {
        match self {
            Self::Add | Self::Subtract | Self::Multiply | Self::Least | Self::Greatest | Self::Floor => 1,
            Self::MultiplyAdd => 2,
            Self::Root => 7,
            Self::Divide => 10,
            Self::Literal(_)
            | Self::Parameter(_)
            | Self::Argument
            | Self::Returned
            | Self::Variable
            | Self::Negate
            | Self::Absolute
            | Self::Less
            | Self::And
            | Self::Or
            | Self::Not
            | Self::Select
            | Self::ToBits
            | Self::FromBits
            | Self::AddWords
            | Self::MultiplyWords
            | Self::Xor
            | Self::AndWords
            | Self::OrWords
            | Self::ShiftUp
            | Self::ShiftDown => 0,
        }
    }

    /// Whether its two operands are interchangeable.
    fn is_symmetric(self) -> bool {
        matches!(
            self,
            Self::Add
                | Self::Multiply
                | Self::And
                | Self::Or
                | Self::AddWords
                | Self::MultiplyWords
                | Self::Xor
                | Self::AndWords
                | Self::OrWords
        )
    }
}

/// A value's definition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Definition {
    kind: Kind,
    operation: Operation,
    operands: [Option<Id>; 3],
}

/// One step of a block.
#[derive(Clone, Debug)]
enum Statement {
    /// Computes a value.
    Define(Id),
    /// The following statements belong to a node of this name.
    Note(&'static str),
    /// Calls a function.
    Call { function: usize, arguments: Vec<Id>, returned: Vec<Id> },
    /// Assigns `then` to the variables where the condition holds, else `otherwise`.
    When { condition: Id, variables: Vec<Id>, otherwise: Vec<Id>, body: Vec<Statement>, then: Vec<Id> },
    /// Assigns `start` to the variables, then runs the body and assigns `next`, while `again` holds.
    Repeat { limit: u32, variables: Vec<Id>, start: Vec<Id>, body: Vec<Statement>, next: Vec<Id>, again: Id },
}

/// A step of the formula that is called by name.
#[derive(Clone, Debug)]
struct Function {
    name: &'static str,
    arguments: Vec<Id>,
    body: Vec<Statement>,
    results: Vec<Id>,
    /// Whether others than this tape call it: then all its arguments and results stay.
    is_entry: bool,
}

/// A recorded formula.
#[derive(Clone, Debug, Default)]
pub struct Tape {
    definitions: Vec<Definition>,
    /// Callees before their callers.
    functions: Vec<Function>,
    parameters: Vec<u32>,
}

impl Tape {
    /// The numbers of the scene, by their bits, in the order of their use.
    pub fn parameters(&self) -> &[u32] {
        &self.parameters
    }

    /// Arithmetic operations in one call of a step: a fused one counts twice, a root as 7 and a quotient
    /// as 10 (their cost on a GPU); `None` if it has loops or branches.
    pub fn operations(&self, step: &str) -> Option<u64> {
        let function = self.functions.iter().find(|function| function.name == step)?;
        let of_statement = |statement: &Statement| match statement {
            Statement::Define(id) => Some(self.definition(*id).operation.cost()),
            Statement::Note(_) => Some(0),
            Statement::Call { function, .. } => self.operations(self.functions[*function].name),
            Statement::When { .. } | Statement::Repeat { .. } => None,
        };
        function.body.iter().map(of_statement).sum()
    }

    fn definition(&self, id: Id) -> Definition {
        self.definitions[id.0 as usize]
    }
}
