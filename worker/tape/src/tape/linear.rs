//! A tape's functions as lists of steps without nesting, for a packet of lanes: branches become moves under a mask,
//! loops run while a lane remains. Each variable is a vector of numbers or a mask, and has one place for all its life.

use std::collections::HashMap;

use crate::interrupt;

use super::fold_step::FoldStep;
use super::liveness::Liveness;
use super::verify::{InvalidTape, MAX_VALUES, too_many_variables};
use super::{Fold, Operation, Statement, Tape, ValueId, ValueType};

/// Index of a variable of a [`Linear`].
pub(crate) type Var = u32;

/// Kind of register that a variable needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Class {
    /// 32 bits in each lane.
    Vector,
    /// One bit in each lane.
    Mask,
}

/// Where a variable's value comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Origin {
    /// The same bits in every lane, part of the code.
    Constant(u32),
    /// A uniform, by its index.
    Uniform(u32),
    /// A word of the function's row, by its index.
    Row(u32),
    /// A step.
    Step,
}

/// Variable of a function.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Variable {
    pub(crate) class: Class,
    pub(crate) source: Origin,
}

/// A loop that may pause does so when less than one of this many lanes is left, a power of two. If it is larger, lanes wait
/// longer for others; if it is smaller, fewer of them take what follows at once.
pub const PAUSE: u32 = 4;
/// Counters of a loop that may pause, beside that of its turns: the number of lanes that began, and memory to count them.
const LANE_COUNTERS: usize = 2;

/// Step of a function.
#[derive(Clone, Debug)]
pub(crate) enum Step {
    /// `to` becomes the result of an operation.
    Compute { to: Var, operation: Operation, operands: [Var; 3] },
    /// `to` becomes `from`.
    Move { to: Var, from: Var },
    /// `to` becomes `from` in the lanes of a mask.
    MoveWhere { mask: Var, to: Var, from: Var },
    /// Goes on after label `end` if the mask has no lane.
    SkipIfNone { mask: Var, end: usize },
    /// End of a branch.
    Label(usize),
    /// Sets a counter.
    Count { counter: usize, limit: u32 },
    /// Begin of a loop.
    Top(usize),
    /// Sets a counter to the number of a mask's lanes.
    CountLanes { counter: usize, mask: Var },
    /// Goes on after label `top` if the mask has a lane, unless the counter has reached 0. If it `pauses`, the mask must have
    /// one of [`PAUSE`] of the lanes that the next counter has counted.
    RepeatWhileAny { mask: Var, counter: usize, top: usize, pauses: bool },
    /// Calls another function, with its live arguments and results.
    Call { callee: usize, live: Var, arguments: Vec<Var>, results: Vec<Var> },
    /// `to` becomes the word in place of a missing one, in the active lanes.
    Make { live: Var, to: Var, missing: Var },
    /// Folds a list.
    Fold(Box<FoldStep>),
}

impl Step {
    /// Whether registers keep no value through the step.
    pub(crate) fn is_call(&self) -> bool {
        matches!(self, Self::Call { .. } | Self::Make { .. } | Self::Fold(_))
    }

    /// Calls a function with each variable that the step reads or writes.
    pub(crate) fn for_each_var(&self, mut see: impl FnMut(Var)) {
        match self {
            Self::Compute { to, operation, operands } => {
                operands[..operation.operand_count()].iter().for_each(|&var| see(var));
                see(*to);
            }
            Self::Move { to, from } => [*from, *to].into_iter().for_each(see),
            Self::MoveWhere { mask, to, from } => [*mask, *from, *to].into_iter().for_each(see),
            Self::SkipIfNone { mask, .. } | Self::RepeatWhileAny { mask, .. } | Self::CountLanes { mask, .. } => {
                see(*mask);
            }
            Self::Label(_) | Self::Count { .. } | Self::Top(_) => {}
            Self::Call { live, arguments, results, .. } => {
                see(*live);
                arguments.iter().chain(results).for_each(|&var| see(var));
            }
            Self::Make { live, to, missing } => [*live, *missing, *to].into_iter().for_each(see),
            Self::Fold(fold) => {
                let FoldStep { live, list, arguments, results, .. } = &**fold;
                [*live, *list].iter().chain(arguments).chain(results).for_each(|&var| see(var));
            }
        }
    }
}

/// A function as a list of steps.
#[derive(Clone, Debug, Default)]
pub(crate) struct Linear {
    /// Its variables.
    pub(crate) variables: Vec<Variable>,
    /// Its steps.
    pub(crate) steps: Vec<Step>,
    /// Its live arguments.
    pub(crate) arguments: Vec<Var>,
    /// The mask of its active lanes.
    pub(crate) live: Var,
    /// Its live results.
    pub(crate) results: Vec<Var>,
    /// Number of its labels.
    pub(crate) labels: usize,
    /// Number of its counters.
    pub(crate) counters: usize,
}

/// A tape whose functions are lists of steps.
#[derive(Clone, Debug)]
pub(crate) struct LinearTape {
    /// Callees before their callers; `None` for those that are never called.
    pub(crate) functions: Vec<Option<Linear>>,
    /// Name and index of each entry.
    pub(crate) entries: Vec<(&'static str, usize)>,
    /// Number of uniforms.
    pub(crate) uniforms: usize,
    /// Whether it reads words of a table.
    pub(crate) has_table: bool,
}

/// Inlining limit: a function that would add more steps stays one.
const MAX_INLINED_STEPS: usize = 2500;

impl LinearTape {
    /// Lists the steps of all functions; those that would add few steps become part of their callers. Fails if the
    /// tape is invalid.
    pub(crate) fn new(tape: &Tape) -> Result<Self, InvalidTape> {
        let live = Liveness::new(tape.verify()?);
        let calls = tape.call_counts(&live);
        let count = tape.functions.len();
        let (mut lengths, mut inlined) = (vec![0; count], vec![false; count]);
        for (index, function) in tape.functions.iter().enumerate() {
            let own = length(&function.body, &lengths);
            inlined[index] = !function.keeps_all() && own * calls[index].saturating_sub(1) <= MAX_INLINED_STEPS;
            lengths[index] = if inlined[index] { own } else { 1 };
        }
        let linear = |index: usize| {
            let results = &tape.functions[index].results;
            let is_used = !inlined[index] && results.iter().any(|&id| live.is_live(id));
            is_used.then(|| Linear::new(tape, &live, &inlined, index))
        };
        let entries = tape.functions.iter().enumerate().filter(|(_, function)| function.is_entry);
        let functions: Vec<Option<Linear>> = (0..count).map(linear).collect();
        let variables = functions.iter().flatten().map(|linear| linear.variables.len()).sum();
        if variables > MAX_VALUES {
            return Err(too_many_variables(variables));
        }
        Ok(Self {
            functions,
            entries: entries.map(|(index, function)| (function.name, index)).collect(),
            uniforms: tape.uniforms.len(),
            has_table: tape.table.is_some(),
        })
    }
}

/// Number of steps of a block, given those that each function adds where it is called.
fn length(block: &[Statement], lengths: &[usize]) -> usize {
    let of = |statement: &Statement| match statement {
        Statement::Emit(_) | Statement::Fold(_) => 1,
        Statement::Comment(_) => 0,
        Statement::Call { function, .. } => lengths[*function],
        Statement::When { body, .. } | Statement::Repeat { body, .. } => 4 + length(body, lengths),
    };
    block.iter().map(of).sum()
}

impl Linear {
    /// Number of words of its row that it uses, with those between them.
    pub(crate) fn row_words(&self) -> u32 {
        let used = self.variables.iter().map(|variable| match variable.source {
            Origin::Row(word) => word + 1,
            _ => 0,
        });
        used.max().unwrap_or(0)
    }

    /// Lists the steps of a function.
    fn new(tape: &Tape, live: &Liveness, inlined: &[bool], index: usize) -> Self {
        let function = &tape.functions[index];
        let mut builder = Builder {
            tape,
            live,
            inlined,
            linear: Self::default(),
            inputs: HashMap::new(),
            scopes: vec![HashMap::new()],
            mask: 0,
        };
        builder.linear.live = builder.fresh(Class::Mask, Origin::Step);
        builder.mask = builder.linear.live;
        for &id in &function.arguments {
            if function.keeps_all() || live.is_live(id) {
                let var = builder.define(id);
                builder.linear.arguments.push(var);
            }
        }
        builder.block(&function.body);
        let results = function.results.iter().filter(|id| live.is_live(**id));
        let results: Vec<Var> = results.map(|&id| builder.var(id)).collect();
        // The results of a function of lists may lie where its arguments were.
        let own = |builder: &mut Builder<'_>, from: Var| {
            if function.row_words.is_none() || !builder.linear.arguments.contains(&from) {
                return from;
            }
            let to = builder.fresh(Class::Vector, Origin::Step);
            builder.push(Step::Move { to, from });
            to
        };
        let results = results.into_iter().map(|from| own(&mut builder, from)).collect();
        builder.linear.results = results;
        builder.linear
    }
}

struct Builder<'a> {
    tape: &'a Tape,
    live: &'a Liveness,
    inlined: &'a [bool],
    linear: Linear,
    /// Variables of constants and uniforms.
    inputs: HashMap<(Origin, bool), Var>,
    /// Variables of the values of each inlined call, the innermost last.
    scopes: Vec<HashMap<ValueId, Var>>,
    /// The active lanes.
    mask: Var,
}

impl Builder<'_> {
    fn fresh(&mut self, class: Class, source: Origin) -> Var {
        self.linear.variables.push(Variable { class, source });
        (self.linear.variables.len() - 1) as Var
    }

    fn class(&self, id: ValueId) -> Class {
        match self.tape.definition(id).kind {
            ValueType::Bool => Class::Mask,
            ValueType::F32 | ValueType::U32 => Class::Vector,
        }
    }

    fn scope(&mut self) -> &mut HashMap<ValueId, Var> {
        self.scopes.last_mut().expect("a function has a scope")
    }

    /// A new variable for a value.
    fn define(&mut self, id: ValueId) -> Var {
        let class = self.class(id);
        let var = self.fresh(class, Origin::Step);
        self.scope().insert(id, var);
        var
    }

    /// Variable of a value.
    fn var(&mut self, id: ValueId) -> Var {
        let source = match self.tape.definition(id).operation {
            Operation::Constant(bits) => Origin::Constant(bits),
            Operation::Uniform(place) => Origin::Uniform(place),
            Operation::Row(place) => Origin::Row(place),
            _ => return self.scope()[&id],
        };
        let class = self.class(id);
        let key = (source, class == Class::Mask);
        if let Some(&var) = self.inputs.get(&key) {
            return var;
        }
        let var = self.fresh(class, source);
        self.inputs.insert(key, var);
        var
    }

    fn push(&mut self, step: Step) {
        self.linear.steps.push(step);
    }

    fn block(&mut self, block: &[Statement]) {
        for statement in block {
            interrupt::check();
            match statement {
                Statement::Emit(id) if self.live.is_live(*id) => self.emit(*id),
                Statement::Emit(_) | Statement::Comment(_) => {}
                Statement::Call { function, arguments, returned } => self.call(*function, arguments, returned),
                Statement::Fold(fold) => self.fold(fold),
                Statement::When { condition, variables, otherwise, body, value } => {
                    let live = self.live.assignments(variables, otherwise, value);
                    if !live.is_empty() {
                        self.when(*condition, &live, body);
                    }
                }
                Statement::Repeat { limit, pauses, variables, start, body, next, again } => {
                    let live = self.live.assignments(variables, start, next);
                    if !live.is_empty() {
                        self.repeat(*limit, *pauses, &live, body, *again);
                    }
                }
            }
        }
    }

    fn emit(&mut self, id: ValueId) {
        let definition = self.tape.definition(id);
        let mut operands = [0; 3];
        for (place, operand) in operands.iter_mut().zip(definition.operands) {
            if let Some(operand) = operand {
                *place = self.var(operand);
            }
        }
        if matches!(definition.operation, Operation::ToBits | Operation::FromBits) {
            self.scope().insert(id, operands[0]);
            return;
        }
        let to = self.define(id);
        self.push(match definition.operation {
            Operation::Made => Step::Make { live: self.mask, to, missing: operands[0] },
            operation => Step::Compute { to, operation, operands },
        });
    }

    fn fold(&mut self, fold: &Fold) {
        if !fold.returned.iter().any(|&id| self.live.is_live(id)) {
            return;
        }
        let Operation::Uniform(last) = self.tape.definition(fold.last).operation else {
            unreachable!("the verifier has seen a uniform")
        };
        let list = self.var(fold.list);
        let arguments = fold.arguments.iter().map(|&id| self.var(id)).collect();
        let results = fold.returned.iter().map(|&id| self.define(id)).collect();
        let row_words = fold.functions().filter_map(|function| self.tape.functions[function].row_words).max();
        self.push(Step::Fold(Box::new(FoldStep {
            live: self.mask,
            list,
            last,
            arguments,
            leaves: fold.leaves.clone(),
            joins: fold.joins.clone(),
            row_words: row_words.unwrap_or(0),
            depth: fold.depth,
            results,
        })));
    }

    fn when(&mut self, condition: ValueId, assigned: &[(ValueId, ValueId, ValueId)], body: &[Statement]) {
        let condition = self.var(condition);
        let outer = self.mask;
        let mask = self.fresh(Class::Mask, Origin::Step);
        self.push(Step::Compute { to: mask, operation: Operation::And, operands: [condition, outer, 0] });
        // The values without the branch are read before any variable is assigned.
        let mut targets = Vec::new();
        for &(id, otherwise, _) in assigned {
            let from = self.var(otherwise);
            let to = self.define(id);
            self.push(Step::Move { to, from });
            targets.push(to);
        }
        let end = self.linear.labels;
        self.linear.labels += 1;
        self.push(Step::SkipIfNone { mask, end });
        self.mask = mask;
        self.block(body);
        self.mask = outer;
        for (&(_, _, value), to) in assigned.iter().zip(targets) {
            let from = self.var(value);
            self.push(Step::MoveWhere { mask, to, from });
        }
        self.push(Step::Label(end));
    }

    fn repeat(
        &mut self,
        limit: u32,
        pauses: bool,
        assigned: &[(ValueId, ValueId, ValueId)],
        body: &[Statement],
        again: ValueId,
    ) {
        let starts: Vec<Var> = assigned.iter().map(|&(_, start, _)| self.var(start)).collect();
        let targets: Vec<Var> = assigned.iter().map(|&(id, ..)| self.define(id)).collect();
        for (&to, &from) in targets.iter().zip(&starts) {
            self.push(Step::Move { to, from });
        }
        let outer = self.mask;
        let active = self.fresh(Class::Mask, Origin::Step);
        self.push(Step::Move { to: active, from: outer });
        let (counter, top) = (self.linear.counters, self.linear.labels);
        self.linear.counters += if pauses { 1 + LANE_COUNTERS } else { 1 };
        self.linear.labels += 1;
        self.push(Step::Count { counter, limit });
        if pauses {
            self.push(Step::CountLanes { counter: counter + 1, mask: active });
        }
        self.push(Step::Top(top));
        self.mask = active;
        self.block(body);
        self.mask = outer;
        let again = self.var(again);
        // All at once: a value that another assignment changes is copied first.
        let mut moves = Vec::new();
        for (&(_, _, next), &to) in assigned.iter().zip(&targets) {
            let mut from = self.var(next);
            if from == to {
                continue;
            }
            if targets.contains(&from) {
                let class = self.linear.variables[from as usize].class;
                let copy = self.fresh(class, Origin::Step);
                self.push(Step::Move { to: copy, from });
                from = copy;
            }
            moves.push((to, from));
        }
        let remaining = if targets.contains(&again) {
            let remaining = self.fresh(Class::Mask, Origin::Step);
            self.push(Step::Compute { to: remaining, operation: Operation::And, operands: [again, active, 0] });
            Some(remaining)
        } else {
            None
        };
        for (to, from) in moves {
            self.push(Step::MoveWhere { mask: active, to, from });
        }
        match remaining {
            Some(from) => self.push(Step::Move { to: active, from }),
            None => self.push(Step::Compute { to: active, operation: Operation::And, operands: [again, active, 0] }),
        }
        self.push(Step::RepeatWhileAny { mask: active, counter, top, pauses });
    }

    fn call(&mut self, callee: usize, arguments: &[ValueId], returned: &[ValueId]) {
        let function = &self.tape.functions[callee];
        if !returned.iter().any(|&id| self.live.is_live(id)) {
            return;
        }
        let used = function.arguments.iter().zip(arguments).filter(|(formal, _)| self.live.is_live(**formal));
        let used: Vec<(ValueId, Var)> = used.map(|(&formal, &actual)| (formal, self.var(actual))).collect();
        let results: Vec<(ValueId, ValueId)> = function
            .results
            .iter()
            .zip(returned)
            .filter(|(result, _)| self.live.is_live(**result))
            .map(|(&result, &id)| (result, id))
            .collect();
        if self.inlined[callee] {
            self.scopes.push(used.into_iter().collect());
            self.block(&function.body);
            let values: Vec<Var> = results.iter().map(|&(result, _)| self.var(result)).collect();
            self.scopes.pop();
            for (&(_, id), value) in results.iter().zip(values) {
                self.scope().insert(id, value);
            }
            return;
        }
        let arguments = used.into_iter().map(|(_, var)| var).collect();
        let results = results.iter().map(|&(_, id)| self.define(id)).collect();
        let live = self.mask;
        self.push(Step::Call { callee, live, arguments, results });
    }
}
