//! Verifies a tape: each rule that a back end relies on is checked here, and only here. No back end is given a tape
//! that breaks one.

use std::collections::HashSet;
use std::ops::Deref;

use math::real::list::{NO_LEAF, OPERATION_WORDS};

use super::{Fold, Function, Instruction, Operation, Statement, Tape, ValueId, ValueType};

/// Maximum number of values of a tape, and of variables after inlining: frames then have 32-bit offsets.
pub(super) const MAX_VALUES: usize = 1 << 24;
/// Maximum number of functions.
const MAX_FUNCTIONS: usize = 1 << 10;
/// Maximum length of a list of arguments, results or variables.
const MAX_LIST: usize = 1 << 14;
/// Maximum depth of blocks, from an entry through all calls: back ends recurse into them.
const MAX_DEPTH: usize = 512;
/// Maximum number of words of a row.
const MAX_ROW_WORDS: u32 = 1 << 16;
/// Maximum number of values that wait in a fold, and of those that it returns.
const MAX_WAITING: u32 = 64;
const MAX_FOLDED: usize = 64;
/// Maximum number of runs of a loop, whose counter has 32 bits.
const MAX_REPEATS: u32 = 1 << 31;

/// Error of a tape that breaks a rule: a bug of the recorder or of a formula.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("step {step:?}, {}: {fault}", value.map_or_else(|| "as a whole".to_owned(), |id| format!("value {}", id.0)))]
pub struct InvalidTape {
    step: &'static str,
    value: Option<ValueId>,
    pub(super) fault: Fault,
}

/// Rule that a tape breaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Fault {
    #[error("there is no such value")]
    UnknownValue,
    #[error("its operation takes {takes} operands")]
    OperandCount { takes: usize },
    #[error("it is {is:?} where {wanted:?} is wanted")]
    Type { is: ValueType, wanted: ValueType },
    #[error("a constant or uniform is no Bool")]
    BoolInput,
    #[error("there is no uniform {0}")]
    UnknownUniform(u32),
    #[error("a shift is by a constant below 32")]
    Shift,
    #[error("a word's last index is a uniform that is in the table, with room for a row before it")]
    Table,
    #[error("word {0} of a row is used, which the function does not have")]
    Row(u32),
    #[error("function {0} is no function of lists, or takes or returns other values")]
    ListFunction(usize),
    #[error("function {0} is used by two folds, or called")]
    SharedListFunction(usize),
    #[error("a fold has no leaves or too many functions, or {0} values wait")]
    FoldSize(u32),
    #[error("a function of lists folds a list")]
    NestedFold,
    #[error("it is defined by another kind of statement than its operation says")]
    Statement,
    #[error("it is defined twice")]
    DefinedTwice,
    #[error("it is not defined")]
    NeverDefined,
    #[error("it is used before its definition, or outside its block")]
    NotVisible,
    #[error("lists that belong together have {0} and {1} values")]
    Lengths(usize, usize),
    #[error("a list has {0} values, and at most {MAX_LIST} are allowed")]
    LongList(usize),
    #[error("a loop runs 1 to {MAX_REPEATS} times, not {0}")]
    Limit(u32),
    #[error("function {0} is called, which is not an earlier one")]
    Callee(usize),
    #[error("an entry is called")]
    CalledEntry,
    #[error("an entry returns nothing")]
    NoResults,
    #[error("its name is no identifier")]
    Name,
    #[error("its name is that of another step")]
    SameName,
    #[error("a comment has more than one line")]
    Comment,
    #[error("there are {0} values, and at most {MAX_VALUES} are allowed")]
    ManyValues(usize),
    #[error("there are {0} functions, and at most {MAX_FUNCTIONS} are allowed")]
    ManyFunctions(usize),
    #[error("blocks are nested more than {MAX_DEPTH} deep")]
    Depth,
}

type Checked<T = ()> = Result<T, InvalidTape>;

/// A tape that [`Tape::verify`] found to be valid.
#[derive(Clone, Copy, Debug)]
pub struct VerifiedTape<'a>(&'a Tape);

impl Deref for VerifiedTape<'_> {
    type Target = Tape;

    fn deref(&self) -> &Tape {
        self.0
    }
}

/// Whether a value may be used at the place that the verifier has reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Visibility {
    Undefined,
    Visible,
    /// Its block has ended.
    Ended,
}

struct Verifier<'a> {
    tape: &'a Tape,
    values: Vec<Visibility>,
    /// Values of the open blocks, the innermost last.
    visible: Vec<ValueId>,
    /// Depth of the blocks of each earlier function and of those that it calls.
    depths: Vec<usize>,
    /// Whether each earlier function folds a list, itself or by those that it calls.
    folds: Vec<bool>,
    /// Functions of folds.
    folded: HashSet<usize>,
    /// Number of words of the row of the function that is being checked, if it has one.
    row_words: Option<u32>,
    /// The function that is being checked.
    step: &'static str,
}

impl Tape {
    /// Checks every rule of tapes.
    pub fn verify(&self) -> Checked<VerifiedTape<'_>> {
        let mut verifier = Verifier {
            tape: self,
            values: vec![Visibility::Undefined; self.instructions.len()],
            visible: Vec::new(),
            depths: Vec::new(),
            folds: Vec::new(),
            folded: HashSet::new(),
            row_words: None,
            step: "",
        };
        verifier.all()?;
        Ok(VerifiedTape(self))
    }
}

/// Error of a tape that has too many variables once functions are inlined.
pub(super) fn too_many_variables(count: usize) -> InvalidTape {
    InvalidTape { step: "", value: None, fault: Fault::ManyValues(count) }
}

impl Verifier<'_> {
    fn refuse<T>(&self, fault: Fault) -> Checked<T> {
        Err(InvalidTape { step: self.step, value: None, fault })
    }

    fn refuse_value<T>(&self, id: ValueId, fault: Fault) -> Checked<T> {
        Err(InvalidTape { step: self.step, value: Some(id), fault })
    }

    fn all(&mut self) -> Checked {
        let (values, functions) = (self.tape.instructions.len(), self.tape.functions.len());
        if values > MAX_VALUES || self.tape.uniforms.len() > MAX_VALUES {
            return self.refuse(Fault::ManyValues(values.max(self.tape.uniforms.len())));
        }
        if functions > MAX_FUNCTIONS {
            return self.refuse(Fault::ManyFunctions(functions));
        }
        for (index, instruction) in self.tape.instructions.iter().enumerate() {
            self.instruction(ValueId(index as u32), instruction)?;
        }
        let mut names = HashSet::new();
        for (index, function) in self.tape.functions.iter().enumerate() {
            self.step = function.name;
            if !names.insert(function.name) {
                return self.refuse(Fault::SameName);
            }
            self.function(index, function)?;
        }
        self.step = "";
        let is_undefined = |(state, instruction): (&Visibility, &Instruction)| {
            *state == Visibility::Undefined && !instruction.operation.is_constant()
        };
        match self.values.iter().zip(&self.tape.instructions).position(is_undefined) {
            Some(index) => self.refuse_value(ValueId(index as u32), Fault::NeverDefined),
            None => Ok(()),
        }
    }

    /// Checks a value's type, and the types of its operands, but not where it is defined.
    fn instruction(&self, id: ValueId, instruction: &Instruction) -> Checked {
        let Instruction { kind, operation, operands } = *instruction;
        let (types, result) = operation.signature();
        if operands.iter().flatten().count() != types.len() || operands[..types.len()].contains(&None) {
            return self.refuse_value(id, Fault::OperandCount { takes: types.len() });
        }
        for (&operand, &wanted) in operands.iter().flatten().zip(types) {
            self.expect_type(operand, wanted)?;
        }
        if let Some(wanted) = result
            && kind != wanted
        {
            return self.refuse_value(id, Fault::Type { is: kind, wanted });
        }
        match operation {
            Operation::Constant(_) | Operation::Uniform(_) | Operation::Row(_) if kind == ValueType::Bool => {
                self.refuse_value(id, Fault::BoolInput)
            }
            Operation::Uniform(place) if place as usize >= self.tape.uniforms.len() => {
                self.refuse_value(id, Fault::UnknownUniform(place))
            }
            Operation::ShiftLeft | Operation::ShiftRight => {
                let by = operands[1].map(|by| self.tape.definition(by).operation);
                let is_valid = matches!(by, Some(Operation::Constant(by)) if by < u32::BITS);
                if is_valid { Ok(()) } else { self.refuse_value(id, Fault::Shift) }
            }
            Operation::Word | Operation::Made => {
                let is_valid = operands[1].is_some_and(|last| self.is_last_word(last, 0));
                if is_valid { Ok(()) } else { self.refuse_value(id, Fault::Table) }
            }
            _ => Ok(()),
        }
    }

    /// Whether a value is the index of a word of the table that has this many before it.
    fn is_last_word(&self, last: ValueId, before: u32) -> bool {
        let last = match self.tape.instructions.get(last.0 as usize).map(|last| last.operation) {
            Some(Operation::Uniform(place)) => self.tape.uniforms.get(place as usize),
            _ => None,
        };
        let length = self.tape.table.as_ref().map_or(0, |table| table.capacity());
        last.is_some_and(|&last| (last as usize) < length && last >= before)
    }

    fn fold(&mut self, index: usize, fold: &Fold) -> Checked {
        if self.row_words.is_some() {
            return self.refuse(Fault::NestedFold);
        }
        let counts = [fold.leaves.len(), fold.joins.len()];
        let is_sized = (1..=MAX_WAITING).contains(&fold.depth) && fold.returned.len() <= MAX_FOLDED;
        if !is_sized || counts[0] == 0 || counts.into_iter().any(|count| count >= NO_LEAF as usize) {
            return self.refuse(Fault::FoldSize(fold.depth));
        }
        self.used_as(fold.list, ValueType::U32)?;
        self.all_used(&fold.arguments)?;
        for &id in &fold.arguments {
            self.expect_type(id, ValueType::F32)?;
        }
        let width = fold.returned.len();
        let mut row_words = 0;
        for (place, function) in fold.functions().enumerate() {
            let arguments = if place < counts[0] { fold.arguments.len() } else { 2 * width };
            let Some(callee) = self.tape.functions.get(function).filter(|_| function < index) else {
                return self.refuse(Fault::Callee(function));
            };
            let are_numbers = callee
                .arguments
                .iter()
                .chain(&callee.results)
                .all(|id| self.tape.instructions.get(id.0 as usize).is_some_and(|id| id.kind == ValueType::F32));
            let Some(words) = callee.row_words.filter(|words| *words <= MAX_ROW_WORDS && are_numbers) else {
                return self.refuse(Fault::ListFunction(function));
            };
            if callee.arguments.len() != arguments || callee.results.len() != width || width == 0 {
                return self.refuse(Fault::ListFunction(function));
            }
            if !self.folded.insert(function) {
                return self.refuse(Fault::SharedListFunction(function));
            }
            row_words = row_words.max(words);
        }
        if !self.is_last_word(fold.last, row_words + OPERATION_WORDS) {
            return self.refuse_value(fold.last, Fault::Table);
        }
        for &id in &fold.returned {
            self.define(id, Operation::CallResult)?;
            self.expect_type(id, ValueType::F32)?;
        }
        self.folds[index] = true;
        Ok(())
    }

    fn function(&mut self, index: usize, function: &Function) -> Checked {
        let is_identifier = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
        if function.name.is_empty() || !function.name.chars().all(is_identifier) {
            return self.refuse(Fault::Name);
        }
        self.short(&function.arguments)?;
        self.short(&function.results)?;
        if function.is_entry && function.row_words.is_some() {
            return self.refuse(Fault::ListFunction(index));
        }
        self.row_words = function.row_words;
        self.folds.push(false);
        for &id in &function.arguments {
            self.define(id, Operation::Argument)?;
        }
        let depth = self.block(index, &function.body, 0)?;
        for &id in &function.results {
            self.used(id)?;
        }
        if function.is_entry {
            if function.results.is_empty() {
                return self.refuse(Fault::NoResults);
            }
            for &id in function.arguments.iter().chain(&function.results) {
                self.expect_type(id, ValueType::F32)?;
            }
        }
        self.depths.push(depth);
        self.end_block(0);
        Ok(())
    }

    /// Checks a block; returns its depth.
    fn block(&mut self, function: usize, block: &[Statement], depth: usize) -> Checked<usize> {
        if depth > MAX_DEPTH {
            return self.refuse(Fault::Depth);
        }
        let mut deepest = depth;
        for statement in block {
            let reached = match statement {
                Statement::Emit(id) => {
                    self.emit(*id)?;
                    depth
                }
                Statement::Comment(text) if text.chars().any(char::is_control) || text.ends_with('\\') => {
                    return self.refuse(Fault::Comment);
                }
                Statement::Comment(_) => depth,
                Statement::Call { function: callee, arguments, returned } => {
                    self.call(function, *callee, arguments, returned)?;
                    depth + 1 + self.depths[*callee]
                }
                Statement::Fold(fold) => {
                    self.fold(function, fold)?;
                    depth + 1 + fold.functions().map(|function| self.depths[function]).max().unwrap_or(0)
                }
                Statement::When { condition, variables, otherwise, body, value } => {
                    self.used_as(*condition, ValueType::Bool)?;
                    self.all_used(otherwise)?;
                    let begin = self.visible.len();
                    let reached = self.block(function, body, depth + 1)?;
                    self.all_used(value)?;
                    self.end_block(begin);
                    self.define_variables(variables)?;
                    self.same_types(variables, otherwise)?;
                    self.same_types(variables, value)?;
                    reached
                }
                Statement::Repeat { limit, pauses: _, variables, start, body, next, again } => {
                    if !(1..=MAX_REPEATS).contains(limit) {
                        return self.refuse(Fault::Limit(*limit));
                    }
                    self.all_used(start)?;
                    self.define_variables(variables)?;
                    let begin = self.visible.len();
                    let reached = self.block(function, body, depth + 1)?;
                    self.all_used(next)?;
                    self.used_as(*again, ValueType::Bool)?;
                    self.end_block(begin);
                    self.same_types(variables, start)?;
                    self.same_types(variables, next)?;
                    reached
                }
            };
            deepest = deepest.max(reached);
        }
        if deepest > MAX_DEPTH { self.refuse(Fault::Depth) } else { Ok(deepest) }
    }

    fn emit(&mut self, id: ValueId) -> Checked {
        let definition = self.known(id)?;
        if definition.operation.operand_count() == 0 {
            return self.refuse_value(id, Fault::Statement);
        }
        for operand in definition.operands.into_iter().flatten() {
            self.used(operand)?;
        }
        self.define(id, definition.operation)
    }

    fn call(&mut self, caller: usize, callee: usize, arguments: &[ValueId], returned: &[ValueId]) -> Checked {
        if callee >= caller {
            return self.refuse(Fault::Callee(callee));
        }
        let function = &self.tape.functions[callee];
        // An entry keeps the arguments that it does not use, which a call does not pass.
        if function.is_entry {
            return self.refuse(Fault::CalledEntry);
        }
        // A function of lists has a row only in a fold.
        if function.row_words.is_some() {
            return self.refuse(Fault::SharedListFunction(callee));
        }
        if self.folds[callee] {
            if self.row_words.is_some() {
                return self.refuse(Fault::NestedFold);
            }
            self.folds[caller] = true;
        }
        self.all_used(arguments)?;
        for &id in returned {
            self.define(id, Operation::CallResult)?;
        }
        self.same_types(&function.arguments, arguments)?;
        self.same_types(&function.results, returned)
    }

    fn known(&self, id: ValueId) -> Checked<Instruction> {
        match self.tape.instructions.get(id.0 as usize) {
            Some(instruction) => Ok(*instruction),
            None => self.refuse_value(id, Fault::UnknownValue),
        }
    }

    fn expect_type(&self, id: ValueId, wanted: ValueType) -> Checked {
        let is = self.known(id)?.kind;
        if is == wanted { Ok(()) } else { self.refuse_value(id, Fault::Type { is, wanted }) }
    }

    fn define(&mut self, id: ValueId, operation: Operation) -> Checked {
        if self.known(id)?.operation != operation {
            return self.refuse_value(id, Fault::Statement);
        }
        if self.values[id.0 as usize] != Visibility::Undefined {
            return self.refuse_value(id, Fault::DefinedTwice);
        }
        self.values[id.0 as usize] = Visibility::Visible;
        self.visible.push(id);
        Ok(())
    }

    fn define_variables(&mut self, variables: &[ValueId]) -> Checked {
        variables.iter().try_for_each(|&id| self.define(id, Operation::Variable))
    }

    fn used(&self, id: ValueId) -> Checked {
        let operation = self.known(id)?.operation;
        if let Operation::Row(word) = operation
            && self.row_words.is_none_or(|words| word >= words)
        {
            return self.refuse_value(id, Fault::Row(word));
        }
        let is_input = operation.is_constant();
        let is_visible = is_input || self.values[id.0 as usize] == Visibility::Visible;
        if is_visible { Ok(()) } else { self.refuse_value(id, Fault::NotVisible) }
    }

    fn used_as(&self, id: ValueId, wanted: ValueType) -> Checked {
        self.used(id)?;
        self.expect_type(id, wanted)
    }

    fn all_used(&self, ids: &[ValueId]) -> Checked {
        ids.iter().try_for_each(|&id| self.used(id))
    }

    fn short(&self, list: &[ValueId]) -> Checked {
        if list.len() > MAX_LIST { self.refuse(Fault::LongList(list.len())) } else { Ok(()) }
    }

    fn same_types(&self, wanted: &[ValueId], given: &[ValueId]) -> Checked {
        if wanted.len() != given.len() {
            return self.refuse(Fault::Lengths(wanted.len(), given.len()));
        }
        self.short(wanted)?;
        wanted.iter().zip(given).try_for_each(|(&wanted, &id)| self.expect_type(id, self.known(wanted)?.kind))
    }

    /// Ends the blocks whose values come after the first `begin` visible ones.
    fn end_block(&mut self, begin: usize) {
        for id in self.visible.drain(begin..) {
            self.values[id.0 as usize] = Visibility::Ended;
        }
    }
}

#[cfg(test)]
mod tests;
