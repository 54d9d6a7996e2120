//! Calls of one function whose arguments do not depend on one another's results: a language may print them as a loop, so that
//! a compiler that copies functions to their calls copies this one once.

use std::collections::{HashMap, HashSet};

use super::Printer;
use crate::tape::{Fold, Statement, Tape, ValueId};

/// The values that statements use and define.
#[derive(Default)]
struct Reach {
    used: HashSet<ValueId>,
    defined: HashSet<ValueId>,
}

impl Reach {
    fn of(tape: &Tape, statement: &Statement) -> Self {
        let mut reach = Self::default();
        reach.add(tape, statement);
        reach
    }

    fn add(&mut self, tape: &Tape, statement: &Statement) {
        match statement {
            Statement::Comment(_) => {}
            Statement::Emit(id) => {
                self.used.extend(tape.definition(*id).operands.into_iter().flatten());
                self.defined.insert(*id);
            }
            Statement::Call { arguments, returned, .. } => {
                self.used.extend(arguments);
                self.defined.extend(returned);
            }
            Statement::Fold(Fold { list, last, arguments, returned, .. }) => {
                self.used.extend(arguments.iter().chain([list, last]));
                self.defined.extend(returned);
            }
            Statement::When { condition, variables, otherwise, body, value } => {
                self.used.extend(otherwise.iter().chain(value).chain([condition]));
                self.defined.extend(variables);
                for inner in body {
                    self.add(tape, inner);
                }
            }
            Statement::Repeat { variables, start, body, next, again, .. } => {
                self.used.extend(start.iter().chain(next).chain([again]));
                self.defined.extend(variables);
                for inner in body {
                    self.add(tape, inner);
                }
            }
        }
    }
}

/// A statement of a block, or calls of one function.
pub(super) enum Step<'a> {
    One(&'a Statement),
    Calls { function: usize, calls: Vec<(&'a [ValueId], &'a [ValueId])> },
}

/// A block with independent calls of one function grouped. What a later call of a group needs is before the group; what
/// needs results of the group is after it. The tape has no effects but values, so that order does not matter otherwise.
pub(super) fn group_calls<'a>(printer: &Printer<'_>, block: &'a [Statement]) -> Vec<Step<'a>> {
    let is_live = |ids: &[ValueId]| ids.iter().any(|&id| printer.live.is_live(id));
    let mut live_calls: HashMap<usize, usize> = HashMap::new();
    for statement in block {
        if let Statement::Call { function, returned, .. } = statement
            && is_live(returned)
        {
            *live_calls.entry(*function).or_default() += 1;
        }
    }
    let mut rest: Vec<&Statement> = block.iter().collect();
    let mut steps = Vec::new();
    while let Some((&first, later)) = rest.split_first() {
        let callee = match first {
            Statement::Call { function, returned, .. }
                if live_calls.get(function).is_some_and(|&count| count > 1) && is_live(returned) =>
            {
                *function
            }
            _ => {
                steps.push(Step::One(first));
                rest.remove(0);
                continue;
            }
        };
        let (mut calls, mut before) = (Vec::new(), Vec::new());
        // Number of the statements before that some call may need.
        let mut needed = 0;
        let mut dependent: HashSet<ValueId> = HashSet::new();
        for &statement in std::iter::once(&first).chain(later) {
            let reach = Reach::of(printer.tape, statement);
            let is_independent = reach.used.is_disjoint(&dependent);
            match statement {
                Statement::Call { function, arguments, returned }
                    if *function == callee && is_independent && is_live(returned) =>
                {
                    calls.push((arguments.as_slice(), returned.as_slice()));
                    needed = before.len();
                    dependent.extend(returned);
                }
                _ if is_independent => before.push(statement),
                _ => dependent.extend(reach.defined),
            }
        }
        if calls.len() == 1 {
            steps.push(Step::One(first));
            rest.remove(0);
            continue;
        }
        let printed = |statement: &Statement| {
            before[..needed].iter().any(|&other| std::ptr::eq(other, statement))
                || matches!(statement, Statement::Call { returned, .. } if calls.iter().any(|(_, of_group)| *of_group == returned.as_slice()))
        };
        let remaining: Vec<&Statement> = later.iter().copied().filter(|statement| !printed(statement)).collect();
        steps.extend(before[..needed].iter().map(|&statement| Step::One(statement)));
        steps.push(Step::Calls { function: callee, calls });
        rest = remaining;
    }
    steps
}
