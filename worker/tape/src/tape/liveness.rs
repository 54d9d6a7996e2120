//! Liveness: the values of a tape that its results depend on; no code is generated for the others.

use super::verify::VerifiedTape;
use super::{Fold, Function, Statement, Tape, ValueId};

/// Values of a tape that its results depend on. A function of lists keeps what it returns if a fold that uses it does.
pub(super) struct Liveness {
    values: Vec<bool>,
}

impl Liveness {
    /// Finds the values that the tape's entries depend on.
    pub(super) fn new(tape: VerifiedTape<'_>) -> Self {
        let all = |function: &Function| function.results.clone();
        // Arguments that each function needs, callees first, as if all its results were used.
        let mut needs = Self { values: vec![false; tape.instructions.len()] };
        for function in &tape.functions {
            needs.mark(&tape, function, all(function), &|id, needs| needs.is_live(id));
        }
        // Values that are used, callers first.
        let mut live = Self { values: vec![false; tape.instructions.len()] };
        for (index, function) in tape.functions.iter().enumerate().rev() {
            let wanted = if function.is_entry { all(function) } else { live.live_results(&tape, index) };
            live.mark(&tape, function, wanted, &|id, _| needs.is_live(id));
        }
        live
    }

    /// Whether the value is used.
    pub(super) fn is_live(&self, id: ValueId) -> bool {
        self.values[id.0 as usize]
    }

    /// Variables of a branch or loop that are used, each with its first and its later value.
    pub(super) fn assignments(
        &self,
        variables: &[ValueId],
        first: &[ValueId],
        later: &[ValueId],
    ) -> Vec<(ValueId, ValueId, ValueId)> {
        let all = variables.iter().zip(first).zip(later).map(|((&id, &first), &later)| (id, first, later));
        all.filter(|(id, ..)| self.is_live(*id)).collect()
    }

    /// Results of a function that some call uses.
    fn live_results(&self, tape: &Tape, callee: usize) -> Vec<ValueId> {
        let results = &tape.functions[callee].results;
        let mut wanted = vec![false; results.len()];
        for function in &tape.functions[callee + 1..] {
            for_each_statement(&function.body, &mut |statement| {
                match statement {
                    Statement::Call { function, returned, .. } if *function == callee => {
                        returned.iter().zip(&mut wanted).for_each(|(id, wanted)| *wanted |= self.is_live(*id));
                    }
                    // One value of a join may depend on any of those before.
                    Statement::Fold(fold) if fold.functions().any(|function| function == callee) => {
                        let is_used = fold.returned.iter().any(|id| self.is_live(*id));
                        for wanted in &mut wanted {
                            *wanted |= is_used;
                        }
                    }
                    _ => {}
                }
            });
        }
        results.iter().zip(wanted).filter_map(|(id, wanted)| wanted.then_some(*id)).collect()
    }

    /// Marks the values that the `wanted` values of a function depend on. `needs` returns whether a callee uses
    /// an argument.
    fn mark(&mut self, tape: &Tape, function: &Function, wanted: Vec<ValueId>, needs: &dyn Fn(ValueId, &Self) -> bool) {
        let sources = self.dependencies(tape, function, needs);
        let mut open = wanted;
        while let Some(id) = open.pop() {
            if std::mem::replace(&mut self.values[id.0 as usize], true) {
                continue;
            }
            open.extend(tape.definition(id).operands.into_iter().flatten());
            if let Ok(place) = sources.binary_search_by_key(&id, |(id, _)| *id) {
                open.extend(&sources[place].1);
            }
        }
    }

    /// Sources of the variables and returned values of a function, sorted.
    fn dependencies(
        &self,
        tape: &Tape,
        function: &Function,
        needs: &dyn Fn(ValueId, &Self) -> bool,
    ) -> Vec<(ValueId, Vec<ValueId>)> {
        let mut sources = Vec::new();
        for_each_statement(&function.body, &mut |statement| match statement {
            Statement::Emit(_) | Statement::Comment(_) => {}
            Statement::Call { function, arguments, returned } => {
                let formal = &tape.functions[*function].arguments;
                let used = formal.iter().zip(arguments).filter(|(formal, _)| needs(**formal, self));
                let used: Vec<ValueId> = used.map(|(_, actual)| *actual).collect();
                sources.extend(returned.iter().map(|id| (*id, used.clone())));
            }
            Statement::Fold(Fold { list, last, arguments, returned, .. }) => {
                let used: Vec<ValueId> = arguments.iter().chain([list, last]).copied().collect();
                sources.extend(returned.iter().map(|id| (*id, used.clone())));
            }
            Statement::When { condition, variables, otherwise, value: then, .. } => {
                for ((id, otherwise), then) in variables.iter().zip(otherwise).zip(then) {
                    sources.push((*id, vec![*condition, *otherwise, *then]));
                }
            }
            Statement::Repeat { variables, start, next, again, .. } => {
                for ((id, start), next) in variables.iter().zip(start).zip(next) {
                    sources.push((*id, vec![*again, *start, *next]));
                }
            }
        });
        sources.sort_unstable_by_key(|(id, _)| *id);
        sources
    }
}

/// Visits every statement, also those in inner blocks.
fn for_each_statement<'a>(block: &'a [Statement], see: &mut impl FnMut(&'a Statement)) {
    for statement in block {
        see(statement);
        match statement {
            Statement::Emit(_) | Statement::Comment(_) | Statement::Call { .. } | Statement::Fold(_) => {}
            Statement::When { body, .. } | Statement::Repeat { body, .. } => for_each_statement(body, see),
        }
    }
}
