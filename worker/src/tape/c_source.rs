//! Generates C source from a tape: the same source for CUDA's compiler and for the host's; only the preamble
//! differs (`cuda/kernel.cu`). Operations with a defined rounding are functions in the preamble. Straight source for
//! packets (`bench/straight.cpp`) has another preamble, and a function that selects, because C++ has no operator for
//! that to define.

mod fold;

use std::collections::HashMap;
use std::fmt::Write;

use scene::nodes::snake_case;
use scene::real::{INDEX_BITS, LENGTH_PLACE, STAND_IN};

use super::liveness::Liveness;
use super::verify::InvalidTape;
use super::{Function, Instruction, Operation, Statement, Tape, ValueId, ValueType};

/// Inlining limit: a step that would add more statements stays a function.
const MAX_INLINED_STATEMENTS: usize = 2500;

/// C source of a tape.
#[derive(Clone, Debug)]
pub struct CSource {
    /// Functions: `step_NAME` for each recorded name, returning a `NAME_result` with parts f0, f1 …
    pub code: String,
    /// Number of statements.
    pub statements: usize,
}

/// Whether a condition is one or a packet of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Conditions {
    Single,
    Packets,
}

impl Tape {
    /// Generates C source. Fails if the tape is invalid.
    pub fn to_c(&self) -> Result<CSource, InvalidTape> {
        self.print(Conditions::Single)
    }

    /// Generates C source in which `float`, `bool` and `unsigned` may be packets, if the tape has no loops and
    /// branches.
    pub(crate) fn to_packet_c(&self) -> Result<CSource, InvalidTape> {
        self.print(Conditions::Packets)
    }

    fn print(&self, conditions: Conditions) -> Result<CSource, InvalidTape> {
        let live = Liveness::new(self.verify()?);
        let calls = self.call_counts(&live);
        let mut text = CSource { code: String::new(), statements: 0 };
        // Statements that each function adds where it is called.
        let mut lengths = vec![0; self.functions.len()];
        for (index, function) in self.functions.iter().enumerate() {
            if function.results.iter().any(|&id| live.is_live(id)) {
                let mut printer = Printer {
                    tape: self,
                    live: &live,
                    conditions,
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
    conditions: Conditions,
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
            format!("{} a{place}", self.kind(id))
        });
        let row = function.row_words.map(|_| "unsigned row".to_owned());
        let arguments: Vec<String> = row.into_iter().chain(arguments).collect();
        self.block(&function.body, 1);
        let body = std::mem::take(&mut self.code);
        let results: Vec<ValueId> = function.results.iter().copied().filter(|&id| self.live.is_live(id)).collect();
        let name = function.name;
        let fields: Vec<String> =
            results.iter().enumerate().map(|(place, &id)| format!("{} f{place};", self.kind(id))).collect();
        let values: Vec<String> = results.iter().map(|&id| self.operand(id)).collect();
        let length = self.statements + self.inlined_statements;
        let is_called = length * calls.saturating_sub(1) > MAX_INLINED_STATEMENTS;
        let linkage = if is_called { "NOINLINE_FN" } else { "INLINE_FN" };
        self.code = format!(
            "struct {name}_result {{ {} }};\n{linkage} {name}_result step_{name}({}) {{\n{body}    return {{ {} }};\n}}\n\n",
            fields.join(" "),
            arguments.join(", "),
            values.join(", "),
        );
        if is_called { 1 } else { length }
    }

    fn kind(&self, id: ValueId) -> &'static str {
        match self.tape.definition(id).kind {
            ValueType::F32 => "float",
            ValueType::Bool => "bool",
            ValueType::U32 => "unsigned",
        }
    }

    fn line(&mut self, depth: usize, line: &str) {
        if let Some(note) = self.note.take() {
            let _ = writeln!(self.code, "{:indent$}// {}", "", snake_case(note), indent = depth * 4);
        }
        let _ = writeln!(self.code, "{:indent$}{line}", "", indent = depth * 4);
        self.statements += 1;
    }

    fn new_name(&mut self, id: ValueId) -> String {
        let letter = match self.tape.definition(id).kind {
            ValueType::F32 => 'v',
            ValueType::Bool => 'c',
            ValueType::U32 => 'w',
        };
        let name = format!("{letter}{}", self.names.len());
        self.names.insert(id, name.clone());
        name
    }

    fn block(&mut self, block: &[Statement], depth: usize) {
        for statement in block {
            match statement {
                Statement::Comment(name) => self.note = Some(name),
                Statement::Emit(id) if self.live.is_live(*id) => {
                    let value = self.operation(self.tape.definition(*id));
                    let kind = self.kind(*id);
                    let name = self.new_name(*id);
                    self.line(depth, &format!("const {kind} {name} = {value};"));
                }
                Statement::Call { function, arguments, returned } => self.call(depth, *function, arguments, returned),
                Statement::Fold(fold) if fold.returned.iter().any(|&id| self.live.is_live(id)) => {
                    self.fold(depth, fold);
                }
                Statement::Emit(_) | Statement::Fold(_) => {}
                Statement::When { condition, variables, otherwise, body, value: then } => {
                    let live = self.live.assignments(variables, otherwise, then);
                    if live.is_empty() {
                        continue;
                    }
                    self.declare(depth, &live);
                    let condition = self.operand(*condition);
                    self.line(depth, &format!("if ({condition}) {{"));
                    self.block(body, depth + 1);
                    self.assign(depth + 1, &live, Vec::new());
                    self.line(depth, "}");
                }
                Statement::Repeat { limit, variables, start, body, next, again } => {
                    let live = self.live.assignments(variables, start, next);
                    if live.is_empty() {
                        continue;
                    }
                    self.declare(depth, &live);
                    self.line(depth, &format!("for (unsigned i = 0; i < {limit}u; ++i) {{"));
                    self.block(body, depth + 1);
                    let mut copied = Vec::new();
                    let again = self.copied_operand(depth + 1, *again, variables, &mut copied);
                    self.assign(depth + 1, &live, copied);
                    self.line(depth + 1, &format!("if (!{again}) break;"));
                    self.line(depth, "}");
                }
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
        self.line(depth, &format!("const {0}_result {result} = step_{0}({1});", callee.name, actual.join(", ")));
    }

    fn declare(&mut self, depth: usize, variables: &[(ValueId, ValueId, ValueId)]) {
        for &(id, first, _) in variables {
            let (kind, first) = (self.kind(id), self.operand(first));
            let name = self.new_name(id);
            self.line(depth, &format!("{kind} {name} = {first};"));
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
        let (kind, copy) = (self.kind(id), format!("{value}_before"));
        if !copied.contains(&id) {
            copied.push(id);
            self.line(depth, &format!("const {kind} {copy} = {value};"));
        }
        copy
    }

    fn operand(&self, id: ValueId) -> String {
        let Instruction { kind, operation, .. } = self.tape.definition(id);
        match (operation, kind) {
            (Operation::Constant(bits), ValueType::F32) => number(f32::from_bits(bits)),
            (Operation::Constant(bits), ValueType::Bool | ValueType::U32) => format!("{bits}u"),
            (Operation::Uniform(place), ValueType::F32 | ValueType::Bool) => format!("uniforms[{place}]"),
            (Operation::Uniform(place), ValueType::U32) => format!("bits_of(uniforms[{place}])"),
            (Operation::Row(place), ValueType::F32 | ValueType::Bool) => {
                format!("float_from_bits(word_of_row(row, {place}u))")
            }
            (Operation::Row(place), ValueType::U32) => format!("word_of_row(row, {place}u)"),
            _ => self.names[&id].clone(),
        }
    }

    fn operation(&self, definition: Instruction) -> String {
        let [a, b, c] = definition.operands.map(|id| id.map(|id| self.operand(id)).unwrap_or_default());
        match definition.operation {
            Operation::Add | Operation::AddU32 => format!("{a} + {b}"),
            Operation::Sub => format!("{a} - {b}"),
            Operation::Mul | Operation::MulU32 => format!("{a} * {b}"),
            Operation::Div => format!("div_rn({a}, {b})"),
            Operation::Fma => format!("fma_rn({a}, {b}, {c})"),
            Operation::Min => format!("min_f({a}, {b})"),
            Operation::Max => format!("max_f({a}, {b})"),
            Operation::Neg => format!("-{a}"),
            Operation::Abs => format!("abs_f({a})"),
            Operation::Floor => format!("floor_f({a})"),
            Operation::Sqrt => format!("sqrt_rn({a})"),
            Operation::Less => format!("{a} < {b}"),
            Operation::And => format!("{a} && {b}"),
            Operation::Or => format!("{a} || {b}"),
            Operation::Not => format!("!{a}"),
            Operation::Select => match self.conditions {
                Conditions::Single => format!("{a} ? {b} : {c}"),
                Conditions::Packets => format!("select_f({a}, {b}, {c})"),
            },
            Operation::ToBits => format!("bits_of({a})"),
            Operation::FromBits => format!("float_from_bits({a})"),
            Operation::Xor => format!("{a} ^ {b}"),
            Operation::AndU32 => format!("{a} & {b}"),
            Operation::OrU32 => format!("{a} | {b}"),
            Operation::ShiftLeft => format!("{a} << {b}"),
            Operation::ShiftRight => format!("{a} >> {b}"),
            Operation::Word => format!("word_at({a}, {b})"),
            Operation::Made => {
                format!("made_word({a}, {}u, {LENGTH_PLACE}u, {STAND_IN}u)", (1_u32 << INDEX_BITS) - 1)
            }
            Operation::Constant(_)
            | Operation::Uniform(_)
            | Operation::Row(_)
            | Operation::Argument
            | Operation::CallResult
            | Operation::Variable => unreachable!("not defined by a statement"),
        }
    }
}

/// C literal of a number, exact to the bit.
fn number(value: f32) -> String {
    if !value.is_finite() {
        return format!("float_from_bits({:#010x}u)", value.to_bits());
    }
    // The shortest digits that parse to this number.
    if value.is_sign_negative() { format!("({value:?}f)") } else { format!("{value:?}f") }
}
