//! Generates source text from a tape: what all languages share, the order of functions and statements, names, and what is
//! left out because no result depends on it. A [`Language`] writes the operators and the syntax around them.

mod call_groups;
mod fold;

use std::collections::HashMap;
use std::fmt::Write;

use math::snake_case;

use call_groups::Step;

use crate::interrupt;

use super::liveness::Liveness;
use super::verify::InvalidTape;
use super::{Function, Instruction, Operation, Statement, Tape, ValueId, ValueType};

/// Inlining limit: a step that would add more statements stays a function.
const MAX_INLINED_STATEMENTS: usize = 2000;

/// Source text of a tape.
#[derive(Clone, Debug)]
pub struct SourceText {
    /// Functions: `step_NAME` for each recorded name, returning a `NAME_result` with parts f0, f1 …
    pub code: String,
    /// Number of statements.
    pub statements: usize,
}

/// A language that tapes are printed in. Braces, comments, `if`, `else`, assignments and calls are the same in all.
pub(super) trait Language {
    /// Name of a type.
    fn type_name(&self, kind: ValueType) -> &'static str;

    /// Statement that defines a value.
    fn constant(&self, kind: ValueType, name: &str, value: &str) -> String;

    /// Statement that defines the result of a call of a function of the tape.
    fn result(&self, function: &str, name: &str, call: &str) -> String;

    /// Statement that defines a variable.
    fn variable(&self, kind: ValueType, name: &str, value: &str) -> String;

    /// Beginning of a loop that runs at most this often.
    fn counted_loop(&self, limit: u32) -> String;

    /// Beginning of a loop over the operations of a list, `words` each, in the variable `at`.
    fn list_loop(&self, list: &str, words: u32) -> String;

    /// Statement that ends a loop.
    fn break_if(&self, condition: &str) -> String;

    /// Whether independent calls of one function become a loop.
    fn groups_calls(&self) -> bool;

    /// Statement that defines a list of values, which is only read.
    fn list(&self, kind: &str, name: &str, values: &[String]) -> String;

    /// Statement that defines a list of results of calls.
    fn empty_list(&self, kind: &str, name: &str, length: usize) -> String;

    /// Beginning of a loop over lists of this length, with the index `k`.
    fn loop_over(&self, length: usize) -> String;

    /// A function.
    fn function(&self, function: &FunctionParts<'_>) -> String;

    /// Value of a constant, a uniform or a word of a row, where it is used.
    fn known(&self, kind: ValueType, operation: Operation) -> String;

    /// Expression of an operation.
    fn operation(&self, operation: Operation, operands: [&str; 3]) -> String;
}

/// Parts of a function, in the words of its language.
pub(super) struct FunctionParts<'a> {
    pub(super) name: &'static str,
    /// Whether it should stay a function: it is long, and called in several places.
    pub(super) is_called: bool,
    /// Types and names of its arguments.
    pub(super) arguments: Vec<(ValueType, String)>,
    pub(super) body: &'a str,
    /// Types and values of its results.
    pub(super) results: Vec<(ValueType, String)>,
}

impl Tape {
    /// Generates source in a language. Fails if the tape is invalid.
    pub(super) fn print(&self, language: &dyn Language) -> Result<SourceText, InvalidTape> {
        let live = Liveness::new(self.verify()?);
        let calls = self.call_counts(&live);
        let mut text = SourceText { code: String::new(), statements: 0 };
        // Statements that each function adds where it is called.
        let mut lengths = vec![0; self.functions.len()];
        for (index, function) in self.functions.iter().enumerate() {
            if function.results.iter().any(|&id| live.is_live(id)) {
                let mut printer = Printer {
                    tape: self,
                    live: &live,
                    language,
                    names: HashMap::new(),
                    code: String::new(),
                    statements: 0,
                    inline_costs: &lengths,
                    inlined_statements: 0,
                    note: None,
                };
                let added = printer.function(function, calls[index]);
                text.code += &printer.code;
                text.statements += printer.statements;
                lengths[index] = added;
            }
        }
        Ok(text)
    }

    /// Number of calls of each function.
    pub(super) fn call_counts(&self, live: &Liveness) -> Vec<usize> {
        fn count(block: &[Statement], live: &Liveness, calls: &mut [usize]) {
            for statement in block {
                match statement {
                    Statement::Emit(_) | Statement::Comment(_) | Statement::Fold(_) => {}
                    Statement::Call { function, returned, .. } => {
                        calls[*function] += usize::from(returned.iter().any(|&id| live.is_live(id)));
                    }
                    Statement::When { body, .. } | Statement::Repeat { body, .. } => count(body, live, calls),
                }
            }
        }
        let mut calls = vec![0; self.functions.len()];
        for function in &self.functions {
            count(&function.body, live, &mut calls);
        }
        calls
    }
}

/// Generates one function.
struct Printer<'a> {
    tape: &'a Tape,
    live: &'a Liveness,
    language: &'a dyn Language,
    names: HashMap<ValueId, String>,
    code: String,
    statements: usize,
    /// Number of statements that each earlier function adds where it is called.
    inline_costs: &'a [usize],
    /// Number of statements of functions that are inlined here.
    inlined_statements: usize,
    /// Node whose formula follows, to be written as a comment before the next statement.
    note: Option<&'static str>,
}

impl Printer<'_> {
    /// Generates a function; returns the number of statements it adds where it is called.
    fn function(&mut self, function: &Function, calls: usize) -> usize {
        let keeps_all = function.keeps_all();
        let arguments = function.arguments.iter().filter(|&&id| keeps_all || self.live.is_live(id));
        let arguments = arguments.enumerate().map(|(place, &id)| {
            self.names.insert(id, format!("a{place}"));
            (self.kind(id), format!("a{place}"))
        });
        let row = function.row_words.map(|_| (ValueType::U32, "row".to_owned()));
        let arguments = row.into_iter().chain(arguments).collect();
        self.block(&function.body, 1);
        let body = std::mem::take(&mut self.code);
        let results = function.results.iter().copied().filter(|&id| self.live.is_live(id));
        let results = results.map(|id| (self.kind(id), self.operand(id))).collect();
        let length = self.statements + self.inlined_statements;
        let is_called = length * calls.saturating_sub(1) > MAX_INLINED_STATEMENTS;
        let parts = FunctionParts { name: function.name, is_called, arguments, body: &body, results };
        self.code = self.language.function(&parts);
        if is_called { 1 } else { length }
    }

    fn kind(&self, id: ValueId) -> ValueType {
        self.tape.definition(id).kind
    }

    fn line(&mut self, depth: usize, line: &str) {
        if let Some(note) = self.note.take() {
            let _ = writeln!(self.code, "{:indent$}// {}", "", snake_case(note), indent = depth * 4);
        }
        let _ = writeln!(self.code, "{:indent$}{line}", "", indent = depth * 4);
        self.statements += 1;
    }

    fn new_name(&mut self, id: ValueId) -> String {
        let letter = match self.kind(id) {
            ValueType::F32 => 'v',
            ValueType::Bool => 'c',
            ValueType::U32 => 'w',
        };
        let name = format!("{letter}{}", self.names.len());
        self.names.insert(id, name.clone());
        name
    }

    fn block(&mut self, block: &[Statement], depth: usize) {
        if !self.language.groups_calls() {
            for statement in block {
                self.statement(statement, depth);
            }
            return;
        }
        for step in call_groups::group_calls(self, block) {
            match step {
                Step::One(statement) => self.statement(statement, depth),
                Step::Calls { function, calls } => self.calls(depth, function, &calls),
            }
        }
    }

    fn statement(&mut self, statement: &Statement, depth: usize) {
        interrupt::check();
        match statement {
            Statement::Comment(name) => self.note = Some(name),
            Statement::Emit(id) if self.live.is_live(*id) => {
                let value = self.operation(self.tape.definition(*id));
                let name = self.new_name(*id);
                self.line(depth, &self.language.constant(self.kind(*id), &name, &value));
            }
            Statement::Call { function, arguments, returned } => self.call(depth, *function, arguments, returned),
            Statement::Fold(fold) if fold.returned.iter().any(|&id| self.live.is_live(id)) => {
                self.fold(depth, fold);
            }
            Statement::Emit(_) | Statement::Fold(_) => {}
            Statement::When { condition, variables, otherwise, body, value: then } => {
                let live = self.live.assignments(variables, otherwise, then);
                if live.is_empty() {
                    return;
                }
                self.declare(depth, &live);
                let condition = self.operand(*condition);
                self.line(depth, &format!("if ({condition}) {{"));
                self.block(body, depth + 1);
                self.assign(depth + 1, &live, Vec::new());
                self.line(depth, "}");
            }
            Statement::Repeat { limit, pauses: _, variables, start, body, next, again } => {
                let live = self.live.assignments(variables, start, next);
                if live.is_empty() {
                    return;
                }
                self.declare(depth, &live);
                self.line(depth, &self.language.counted_loop(*limit));
                self.block(body, depth + 1);
                let mut copied = Vec::new();
                let again = self.copied_operand(depth + 1, *again, variables, &mut copied);
                self.assign(depth + 1, &live, copied);
                self.line(depth + 1, &self.language.break_if(&format!("!{again}")));
                self.line(depth, "}");
            }
        }
    }

    fn call(&mut self, depth: usize, function: usize, arguments: &[ValueId], returned: &[ValueId]) {
        let callee = &self.tape.functions[function];
        if !returned.iter().any(|&id| self.live.is_live(id)) {
            return;
        }
        let used = callee.arguments.iter().zip(arguments).filter(|(formal, _)| self.live.is_live(**formal));
        let actual: Vec<String> = used.map(|(_, &actual)| self.operand(actual)).collect();
        let result = format!("r{}", self.names.len());
        let fields = callee.results.iter().zip(returned).filter(|(result, _)| self.live.is_live(**result));
        for (place, (_, &id)) in fields.enumerate() {
            self.names.insert(id, format!("{result}.f{place}"));
        }
        self.inlined_statements += self.inline_costs[function];
        let call = format!("step_{}({})", callee.name, actual.join(", "));
        self.line(depth, &self.language.result(callee.name, &result, &call));
    }

    /// Calls a function for each of these arguments, in a loop.
    fn calls(&mut self, depth: usize, function: usize, calls: &[(&[ValueId], &[ValueId])]) {
        let callee = &self.tape.functions[function];
        let group = self.names.len();
        let result = format!("r{group}");
        let used: Vec<usize> =
            (0..callee.arguments.len()).filter(|&place| self.live.is_live(callee.arguments[place])).collect();
        let mut actual = Vec::new();
        for place in used {
            let name = format!("g{group}_{place}");
            let values: Vec<String> = calls.iter().map(|(arguments, _)| self.operand(arguments[place])).collect();
            let kind = self.kind(callee.arguments[place]);
            self.line(depth, &self.language.list(self.language.type_name(kind), &name, &values));
            actual.push(format!("{name}[k]"));
        }
        self.line(depth, &self.language.empty_list(&format!("{}_result", callee.name), &result, calls.len()));
        self.line(depth, &self.language.loop_over(calls.len()));
        self.inlined_statements += self.inline_costs[function];
        self.line(depth + 1, &format!("{result}[k] = step_{}({});", callee.name, actual.join(", ")));
        self.line(depth, "}");
        for (index, (_, returned)) in calls.iter().enumerate() {
            let fields = callee.results.iter().zip(*returned).filter(|(result, _)| self.live.is_live(**result));
            for (place, (_, &id)) in fields.enumerate() {
                self.names.insert(id, format!("{result}[{index}].f{place}"));
            }
        }
    }

    fn declare(&mut self, depth: usize, variables: &[(ValueId, ValueId, ValueId)]) {
        for &(id, first, _) in variables {
            let first = self.operand(first);
            let name = self.new_name(id);
            self.line(depth, &self.language.variable(self.kind(id), &name, &first));
        }
    }

    /// Assigns to all variables at once, so that no assignment reads another's new value. Some have been copied.
    fn assign(&mut self, depth: usize, variables: &[(ValueId, ValueId, ValueId)], mut copied: Vec<ValueId>) {
        let ids: Vec<ValueId> = variables.iter().map(|&(id, ..)| id).collect();
        let changed: Vec<_> = variables.iter().filter(|(id, _, later)| id != later).collect();
        let mut later = Vec::new();
        for (.., id) in &changed {
            later.push(self.copied_operand(depth, *id, &ids, &mut copied));
        }
        for ((id, ..), later) in changed.into_iter().zip(later) {
            let name = self.operand(*id);
            self.line(depth, &format!("{name} = {later};"));
        }
    }

    /// Expression of a value that remains valid while `variables` change. Each is copied once in a block.
    fn copied_operand(
        &mut self,
        depth: usize,
        id: ValueId,
        variables: &[ValueId],
        copied: &mut Vec<ValueId>,
    ) -> String {
        let value = self.operand(id);
        if !variables.contains(&id) {
            return value;
        }
        let copy = format!("{value}_before");
        if !copied.contains(&id) {
            copied.push(id);
            self.line(depth, &self.language.constant(self.kind(id), &copy, &value));
        }
        copy
    }

    fn operand(&self, id: ValueId) -> String {
        let Instruction { kind, operation, .. } = self.tape.definition(id);
        if operation.is_constant() { self.language.known(kind, operation) } else { self.names[&id].clone() }
    }

    fn operation(&self, definition: Instruction) -> String {
        let operands = definition.operands.map(|id| id.map(|id| self.operand(id)).unwrap_or_default());
        self.language.operation(definition.operation, operands.each_ref().map(String::as_str))
    }
}
