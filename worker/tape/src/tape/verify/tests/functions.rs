//! Tapes that are broken in a function or a call.

use super::*;

pub(super) const CASES: &[Case] = &[
    ("call of itself", |t| edit!(t, Call { function } => *function = MAIN), Fault::Callee(MAIN)),
    ("call of a later function", |t| t.functions.swap(STEP, MAIN), Fault::Callee(MAIN)),
    ("call of no function", |t| edit!(t, Call { function } => *function = 7), Fault::Callee(7)),
    ("call of function number usize::MAX", |t| edit!(t, Call { function } => *function = usize::MAX), Fault::Callee(0)),
    ("call of an entry", |t| t.functions[STEP].is_entry = true, Fault::CalledEntry),
    ("argument missing", |t| edit!(t, Call { arguments } => arguments.truncate(1)), Fault::Lengths(2, 1)),
    ("argument too many", |t| edit!(t, Call { arguments } => arguments.push(arguments[0])), Fault::Lengths(2, 3)),
    (
        "argument is a condition",
        |t| {
            let less = find(t, Operation::Less);
            edit!(t, Call { arguments } => arguments[0] = less);
        },
        Fault::NotVisible,
    ),
    (
        "argument is a word",
        |t| {
            let bits = word(t, 0);
            edit!(t, Call { arguments } => arguments[1] = bits);
        },
        SOME_TYPE,
    ),
    ("argument is unknown", |t| edit!(t, Call { arguments } => arguments[0] = NOWHERE), Fault::UnknownValue),
    (
        "argument is the call's own result",
        |t| edit!(t, Call { arguments, returned } => arguments[0] = returned[0]),
        Fault::NotVisible,
    ),
    ("result missing", |t| edit!(t, Call { returned } => returned.clear()), Fault::Lengths(1, 0)),
    (
        "result too many",
        |t| {
            let more = add(t, ValueType::F32, Operation::CallResult, [None; 3]);
            edit!(t, Call { returned } => returned.push(more));
        },
        Fault::Lengths(1, 2),
    ),
    (
        "result of another type",
        |t| {
            let less = add(t, ValueType::Bool, Operation::CallResult, [None; 3]);
            edit!(t, Call { returned } => returned.push(less));
            let result = t.functions[STEP].results[0];
            t.functions[STEP].results.push(result);
        },
        SOME_TYPE,
    ),
    (
        "result twice",
        |t| {
            edit!(t, Call { returned } => returned.push(returned[0]));
            let result = t.functions[STEP].results[0];
            t.functions[STEP].results.push(result);
        },
        Fault::DefinedTwice,
    ),
    (
        "result is a variable",
        |t| {
            let variable = find(t, Operation::Variable);
            edit!(t, Call { returned } => returned[0] = variable);
        },
        Fault::Statement,
    ),
    ("result is unknown", |t| edit!(t, Call { returned } => returned[0] = NOWHERE), Fault::UnknownValue),
    (
        "formal argument missing",
        |t| {
            t.functions[STEP].arguments.pop();
        },
        Fault::NotVisible,
    ),
    (
        "formal argument twice",
        |t| {
            let all = &mut t.functions[STEP].arguments;
            all[1] = all[0];
        },
        Fault::DefinedTwice,
    ),
    (
        "formal argument of another function",
        |t| t.functions[MAIN].arguments[0] = t.functions[STEP].arguments[0],
        Fault::DefinedTwice,
    ),
    ("formal argument is a sum", |t| t.functions[STEP].arguments[0] = find(t, Operation::Add), Fault::Statement),
    ("formal argument is unknown", |t| t.functions[STEP].arguments.push(NOWHERE), Fault::UnknownValue),
    ("function returns an unknown value", |t| t.functions[STEP].results[0] = NOWHERE, Fault::UnknownValue),
    ("function returns too little", |t| t.functions[STEP].results.clear(), Fault::Lengths(0, 1)),
    ("entry returns nothing", |t| t.functions[MAIN].results.clear(), Fault::NoResults),
    ("entry returns a condition", |t| t.functions[MAIN].results[0] = find(t, Operation::Or), SOME_TYPE),
    ("entry returns a word", |t| t.functions[MAIN].results[1] = find(t, Operation::MulU32), SOME_TYPE),
    (
        "entry takes a word",
        |t| {
            let more = add(t, ValueType::U32, Operation::Argument, [None; 3]);
            t.functions[MAIN].arguments.push(more);
        },
        SOME_TYPE,
    ),
    (
        "entry takes a condition",
        |t| {
            let more = add(t, ValueType::Bool, Operation::Argument, [None; 3]);
            t.functions[MAIN].arguments.push(more);
        },
        SOME_TYPE,
    ),
    (
        "function left out",
        |t| {
            t.functions.remove(STEP);
        },
        Fault::Callee(0),
    ),
    (
        "entry left out",
        |t| {
            t.functions.pop();
        },
        Fault::NeverDefined,
    ),
    ("function twice", |t| t.functions.push(t.functions[STEP].clone()), Fault::SameName),
    (
        "function twice by two names",
        |t| {
            t.functions.push(Function { name: "copy", ..t.functions[STEP].clone() });
        },
        Fault::DefinedTwice,
    ),
    ("two steps of one name", |t| t.functions[STEP].name = "main", Fault::SameName),
    ("step without a name", |t| t.functions[STEP].name = "", Fault::Name),
    ("name of two words", |t| t.functions[STEP].name = "a step", Fault::Name),
    ("name that ends its function", |t| t.functions[MAIN].name = "main() {} //", Fault::Name),
    ("name outside of ASCII", |t| t.functions[MAIN].name = "mäin", Fault::Name),
    (
        "too many functions",
        |t| t.functions.resize(MAX_FUNCTIONS + 1, t.functions[STEP].clone()),
        Fault::ManyFunctions(0),
    ),
    (
        "calls too deep",
        |t| {
            for function in MAIN..MAX_DEPTH + 2 {
                let name = String::leak(format!("step_{function}"));
                let x = add(t, ValueType::F32, Operation::Argument, [None; 3]);
                let result = add(t, ValueType::F32, Operation::CallResult, [None; 3]);
                let callee = if function == MAIN { STEP } else { function };
                let mut arguments = vec![x];
                arguments.resize(t.functions[callee].arguments.len(), x);
                let body = vec![Statement::Call { function: callee, arguments, returned: vec![result] }];
                t.functions.push(Function {
                    name,
                    arguments: vec![x],
                    body,
                    results: vec![result],
                    is_entry: false,
                    row_words: None,
                });
            }
        },
        Fault::Depth,
    ),
];
