//! Tapes that are broken in a statement.

use super::*;

pub(super) const CASES: &[Case] = &[
    ("unknown value computed", |t| t.functions[MAIN].body.push(Statement::Emit(NOWHERE)), Fault::UnknownValue),
    (
        "constant computed",
        |t| {
            let id = word(t, 1);
            t.functions[MAIN].body.push(Statement::Emit(id));
        },
        Fault::Statement,
    ),
    (
        "uniform computed",
        |t| {
            let id = find(t, Operation::Uniform(0));
            t.functions[MAIN].body.push(Statement::Emit(id));
        },
        Fault::Statement,
    ),
    (
        "argument computed",
        |t| {
            let id = t.functions[MAIN].arguments[0];
            t.functions[MAIN].body.push(Statement::Emit(id));
        },
        Fault::Statement,
    ),
    (
        "variable computed",
        |t| {
            let id = find(t, Operation::Variable);
            t.functions[MAIN].body.push(Statement::Emit(id));
        },
        Fault::Statement,
    ),
    (
        "call's result computed",
        |t| {
            let id = find(t, Operation::CallResult);
            t.functions[MAIN].body.push(Statement::Emit(id));
        },
        Fault::Statement,
    ),
    (
        "statement twice",
        |t| {
            let at = place!(t, Statement::Emit(_));
            let again = t.functions[MAIN].body[at].clone();
            t.functions[MAIN].body.push(again);
        },
        Fault::DefinedTwice,
    ),
    (
        "call twice",
        |t| {
            let at = place!(t, Statement::Call { .. });
            let again = t.functions[MAIN].body[at].clone();
            t.functions[MAIN].body.push(again);
        },
        Fault::DefinedTwice,
    ),
    (
        "branch twice",
        |t| {
            let at = place!(t, Statement::When { .. });
            let again = t.functions[MAIN].body[at].clone();
            t.functions[MAIN].body.push(again);
        },
        Fault::DefinedTwice,
    ),
    (
        "loop twice",
        |t| {
            let at = place!(t, Statement::Repeat { .. });
            let again = t.functions[MAIN].body[at].clone();
            t.functions[MAIN].body.push(again);
        },
        Fault::DefinedTwice,
    ),
    (
        "statement left out",
        |t| {
            let at = place!(t, Statement::Emit(_));
            t.functions[MAIN].body.remove(at);
        },
        Fault::NotVisible,
    ),
    (
        "call left out",
        |t| {
            let at = place!(t, Statement::Call { .. });
            t.functions[MAIN].body.remove(at);
        },
        Fault::NotVisible,
    ),
    (
        "branch left out",
        |t| {
            let at = place!(t, Statement::When { .. });
            t.functions[MAIN].body.remove(at);
        },
        Fault::NotVisible,
    ),
    (
        "loop left out",
        |t| {
            let at = place!(t, Statement::Repeat { .. });
            t.functions[MAIN].body.remove(at);
        },
        Fault::NotVisible,
    ),
    ("body left out", |t| t.functions[STEP].body.clear(), Fault::NotVisible),
    ("statements in reverse", |t| t.functions[MAIN].body.reverse(), Fault::NotVisible),
    (
        "value of another function used",
        |t| {
            let of_step = t.functions[STEP].arguments[0];
            let a = t.functions[MAIN].arguments[0];
            add_sum(t, of_step, a);
        },
        Fault::NotVisible,
    ),
    (
        "value of another function returned",
        |t| t.functions[MAIN].results[0] = t.functions[STEP].results[0],
        Fault::NotVisible,
    ),
    (
        "value of a branch's body used after it",
        |t| {
            let inner = find(t, Operation::Sqrt);
            add_sum(t, inner, inner);
        },
        Fault::NotVisible,
    ),
    (
        "value of a branch's body returned",
        |t| t.functions[MAIN].results[0] = find(t, Operation::Sqrt),
        Fault::NotVisible,
    ),
    (
        "value of a loop's body used after it",
        |t| {
            let a = t.functions[MAIN].arguments[0];
            let inner = add(t, ValueType::F32, Operation::Neg, [Some(a), None, None]);
            edit!(t, Repeat { body } => body.push(Statement::Emit(inner)));
            add_sum(t, inner, a);
        },
        Fault::NotVisible,
    ),
    (
        "branch's variable used in its body",
        |t| edit!(t, When { variables, value } => value[0] = variables[0]),
        Fault::NotVisible,
    ),
    (
        "branch's variable before the branch",
        |t| edit!(t, When { variables, otherwise } => otherwise[0] = variables[0]),
        Fault::NotVisible,
    ),
    (
        "branch's own value without the branch",
        |t| edit!(t, When { value, otherwise } => otherwise[0] = value[0]),
        Fault::NotVisible,
    ),
    (
        "loop's variable as its own start",
        |t| edit!(t, Repeat { variables, start } => start[0] = variables[0]),
        Fault::NotVisible,
    ),
    ("loop's inner value as its start", |t| edit!(t, Repeat { next, start } => start[1] = next[1]), Fault::NotVisible),
    ("condition of a branch is unknown", |t| edit!(t, When { condition } => *condition = NOWHERE), Fault::UnknownValue),
    (
        "condition of a branch is a number",
        |t| edit!(t, When { condition, otherwise } => *condition = otherwise[0]),
        SOME_TYPE,
    ),
    (
        "condition of a branch comes later",
        |t| {
            let late = find(t, Operation::Or);
            edit!(t, When { condition } => *condition = late);
        },
        Fault::NotVisible,
    ),
    ("condition of a loop is unknown", |t| edit!(t, Repeat { again } => *again = NOWHERE), Fault::UnknownValue),
    ("condition of a loop is a number", |t| edit!(t, Repeat { again, next } => *again = next[0]), SOME_TYPE),
    (
        "condition of a loop comes later",
        |t| {
            let late = find(t, Operation::Or);
            edit!(t, Repeat { again } => *again = late);
        },
        Fault::NotVisible,
    ),
    ("branch with more variables than values", |t| edit!(t, When { value } => value.clear()), Fault::Lengths(1, 0)),
    (
        "branch with more values than variables",
        |t| edit!(t, When { value } => value.push(value[0])),
        Fault::Lengths(1, 2),
    ),
    (
        "branch without a value for the other lanes",
        |t| edit!(t, When { otherwise } => otherwise.clear()),
        Fault::Lengths(1, 0),
    ),
    (
        "branch with too many for the other lanes",
        |t| edit!(t, When { otherwise } => otherwise.push(otherwise[0])),
        Fault::Lengths(1, 2),
    ),
    ("loop with fewer starts", |t| edit!(t, Repeat { start } => start.truncate(1)), Fault::Lengths(2, 1)),
    ("loop with more starts", |t| edit!(t, Repeat { start } => start.push(start[0])), Fault::Lengths(2, 3)),
    ("loop with fewer next values", |t| edit!(t, Repeat { next } => next.truncate(1)), Fault::Lengths(2, 1)),
    ("loop with more next values", |t| edit!(t, Repeat { next } => next.push(next[0])), Fault::Lengths(2, 3)),
    (
        "same variable twice in a branch",
        |t| edit!(t, When { variables, otherwise, value } => for list in [variables, otherwise, value] { list.push(list[0]); }),
        Fault::DefinedTwice,
    ),
    (
        "same variable twice in a loop",
        |t| edit!(t, Repeat { variables } => variables[1] = variables[0]),
        Fault::DefinedTwice,
    ),
    (
        "variable of a branch is a sum",
        |t| {
            let sum = find(t, Operation::FromBits);
            edit!(t, When { variables } => variables[0] = sum);
        },
        Fault::Statement,
    ),
    (
        "variable of a loop is an argument",
        |t| {
            let a = t.functions[MAIN].arguments[0];
            edit!(t, Repeat { variables } => variables[0] = a);
        },
        Fault::Statement,
    ),
    ("unknown variable", |t| edit!(t, Repeat { variables } => variables[0] = NOWHERE), Fault::UnknownValue),
    (
        "branch assigns a condition to a number",
        |t| edit!(t, When { condition, otherwise } => otherwise[0] = *condition),
        SOME_TYPE,
    ),
    (
        "branch's body gives a condition for a number",
        |t| edit!(t, When { condition, value } => value[0] = *condition),
        SOME_TYPE,
    ),
    (
        "loop's start is a word",
        |t| {
            let bits = word(t, 0);
            edit!(t, Repeat { start } => start[0] = bits);
        },
        SOME_TYPE,
    ),
    ("loop's next value is a condition", |t| edit!(t, Repeat { next, again } => next[0] = *again), SOME_TYPE),
    ("loop that never runs", |t| edit!(t, Repeat { limit } => *limit = 0), Fault::Limit(0)),
    ("loop that hardly ends", |t| edit!(t, Repeat { limit } => *limit = MAX_REPEATS + 1), Fault::Limit(0)),
    ("loop without an end", |t| edit!(t, Repeat { limit } => *limit = u32::MAX), Fault::Limit(0)),
    ("comment of two lines", |t| t.functions[MAIN].body.push(Statement::Comment("box\nreturn 0;")), Fault::Comment),
    (
        "comment that continues on the next line",
        |t| t.functions[MAIN].body.push(Statement::Comment("box\\")),
        Fault::Comment,
    ),
    (
        "blocks too deep",
        |t| {
            for _ in 0..=MAX_DEPTH {
                let (a, again) = (t.functions[MAIN].arguments[0], find(t, Operation::Less));
                let body = std::mem::take(&mut t.functions[MAIN].body);
                let variables = vec![add(t, ValueType::F32, Operation::Variable, [None; 3])];
                t.functions[MAIN].body = vec![Statement::Repeat {
                    limit: 1,
                    pauses: false,
                    variables,
                    start: vec![a],
                    body,
                    next: vec![a],
                    again,
                }];
            }
        },
        Fault::Depth,
    ),
    (
        "list too long",
        |t| edit!(t, Call { arguments } => arguments.resize(MAX_LIST + 1, arguments[0])),
        Fault::Lengths(2, 0),
    ),
    (
        "too many results",
        |t| {
            let all = &mut t.functions[MAIN].results;
            all.resize(MAX_LIST + 1, all[0]);
        },
        Fault::LongList(0),
    ),
];
