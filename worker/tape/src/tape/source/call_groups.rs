//! Calls of one function whose arguments do not depend on one another's results: a language may print them as a loop, so that
//! a compiler that copies functions to their calls copies this one once.

use std::collections::{HashMap, HashSet};

use super::Printer;
use crate::interrupt;
use crate::tape::{Fold, Statement, Tape, ValueId};

/// Maximum number of statements looked at for all groups of a block; after them, calls are printed one by one. Shipped scenes
/// need a thousandth of it.
const MAX_LOOKS: usize = 10_000_000;

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
    let reaches: Vec<Reach> = block.iter().map(|statement| Reach::of(printer.tape, statement)).collect();
    let mut is_printed = vec![false; block.len()];
    let mut looks_left = MAX_LOOKS;
    let mut steps = Vec::new();
    for first in 0..block.len() {
        interrupt::check();
        if std::mem::replace(&mut is_printed[first], true) {
            continue;
        }
        let group = match &block[first] {
            Statement::Call { function, returned, .. } if is_live(returned) => {
                let count = live_calls.get_mut(function).expect("all were counted");
                let group = if *count > 1 && looks_left > 0 {
                    Group::find(&is_live, block, &reaches, &is_printed, first, *count, &mut looks_left)
                } else {
                    Group::default()
                };
                *count -= group.calls.len().max(1);
                group
            }
            _ => Group::default(),
        };
        let Group { calls, before } = group;
        if calls.len() < 2 {
            steps.push(Step::One(&block[first]));
            continue;
        }
        for &place in calls.iter().chain(&before) {
            is_printed[place] = true;
        }
        steps.extend(before.into_iter().map(|place| Step::One(&block[place])));
        let mut callee = 0;
        let parts = calls.into_iter().map(|place| match &block[place] {
            Statement::Call { function, arguments, returned } => {
                callee = *function;
                (arguments.as_slice(), returned.as_slice())
            }
            _ => unreachable!("a group has calls"),
        });
        let calls = parts.collect();
        steps.push(Step::Calls { function: callee, calls });
    }
    steps
}

/// Calls of one function, by their places in a block, and the statements before the last of them that some may need.
#[derive(Default)]
struct Group {
    calls: Vec<usize>,
    before: Vec<usize>,
}

impl Group {
    /// The group of a call, one of `count` live calls of its function that are not printed.
    fn find(
        is_live: &impl Fn(&[ValueId]) -> bool,
        block: &[Statement],
        reaches: &[Reach],
        is_printed: &[bool],
        first: usize,
        count: usize,
        looks_left: &mut usize,
    ) -> Self {
        let Statement::Call { function: callee, .. } = &block[first] else { return Self::default() };
        let mut group = Self::default();
        let (mut seen, mut needed) = (0, 0);
        let mut dependent: HashSet<ValueId> = HashSet::new();
        for place in first..block.len() {
            if seen == count || *looks_left == 0 {
                break;
            }
            if place != first && is_printed[place] {
                continue;
            }
            *looks_left -= 1;
            let is_independent = reaches[place].used.is_disjoint(&dependent);
            let is_call = matches!(&block[place], Statement::Call { function, returned, .. } if function == callee && is_live(returned));
            seen += usize::from(is_call);
            if is_call && is_independent {
                group.calls.push(place);
                needed = group.before.len();
            } else if is_independent {
                group.before.push(place);
                continue;
            }
            dependent.extend(&reaches[place].defined);
        }
        group.before.truncate(needed);
        group
    }
}
