//! Tests that the verifier accepts what is recorded, and refuses tapes that are broken in each way.

use std::mem::discriminant;

use math::real::{FunctionKey, Real};

use super::*;
use crate::tape::{Expr, record};

/// Binds parts of the entry's first statement of a kind.
macro_rules! edit {
    ($tape:ident, $Kind:ident { $($part:ident),* } => $change:expr) => {{
        let all = &mut $tape.functions[MAIN].body;
        let Some(Statement::$Kind { $($part,)* .. }) =
            all.iter_mut().find(|statement| matches!(statement, Statement::$Kind { .. }))
        else {
            panic!("the example has every statement")
        };
        $change;
    }};
}

/// Place of the entry's first statement of a kind.
macro_rules! place {
    ($tape:ident, $pattern:pat) => {
        $tape.functions[MAIN]
            .body
            .iter()
            .position(|statement| matches!(statement, $pattern))
            .expect("the example has every statement")
    };
}

mod functions;
mod statements;
mod values;

/// Indices of the functions of [`example`].
const STEP: usize = 0;
const MAIN: usize = 1;

/// A tape with every operation and statement.
fn example() -> Tape {
    record(|recording| {
        recording.entry("main", |[a, b, c]: [Expr; 3]| {
            let called = a.call(FunctionKey::new("step"), (a, b), |(x, y): (Expr, Expr)| x * y + 1.0);
            let chosen = Expr::when(a.lt(b), c, || called.labeled("Box", || called.sqrt() + b));
            let (x, y) = Expr::repeat(9, (chosen, b), |(x, y)| {
                let next = Expr::when(!x.lt(y), x, || x * 0.7 + y);
                (next.lt(c), (y, next))
            });
            let word = ((x.to_bits() ^ y.to_bits()) * 3 + b.uniform_bits(7)) & 0xffff;
            let number = Expr::from_bits(((word << 3) >> 2) | 0x3f80_0000);
            let number = number.mul_add(a, b) - a / b.max(c).min(a);
            let number = Expr::select(a.lt(b) & b.lt(c) | !c.lt(a), number, -number.abs().floor());
            vec![y, number + a.uniform(0.5)]
        });
    })
}

/// First value with an operation of this kind.
fn find(tape: &Tape, operation: Operation) -> ValueId {
    let is_wanted = |other: &Instruction| discriminant(&other.operation) == discriminant(&operation);
    ValueId(tape.instructions.iter().position(is_wanted).expect("the example has every operation") as u32)
}

fn instruction(tape: &mut Tape, operation: Operation) -> &mut Instruction {
    let id = find(tape, operation);
    &mut tape.instructions[id.0 as usize]
}

/// A value of a type other than this one.
fn other_type(tape: &Tape, kind: ValueType) -> ValueId {
    find(tape, if kind == ValueType::F32 { Operation::Less } else { Operation::Add })
}

/// Adds a value that no statement defines.
fn add(tape: &mut Tape, kind: ValueType, operation: Operation, operands: [Option<ValueId>; 3]) -> ValueId {
    tape.instructions.push(Instruction { kind, operation, operands });
    ValueId(tape.instructions.len() as u32 - 1)
}

fn word(tape: &mut Tape, bits: u32) -> ValueId {
    add(tape, ValueType::U32, Operation::Constant(bits), [None; 3])
}

/// Adds a sum of two numbers, defined at the end of the entry.
fn add_sum(tape: &mut Tape, a: ValueId, b: ValueId) {
    let sum = add(tape, ValueType::F32, Operation::Add, [Some(a), Some(b), None]);
    tape.functions[MAIN].body.push(Statement::Emit(sum));
}

const NOWHERE: ValueId = ValueId(1 << 30);

/// A broken tape: its name, the way to break the example, and a fault of the kind that is found.
type Case = (&'static str, fn(&mut Tape), Fault);

const SOME_TYPE: Fault = Fault::Type { is: ValueType::F32, wanted: ValueType::F32 };

/// For each operation: an operand of another type, one too few, one too many, and another result.
fn cases_of_operations() -> Vec<(String, Tape, Fault)> {
    let example = example();
    let mut seen = HashSet::new();
    let mut cases = Vec::new();
    for (index, Instruction { kind, operation, operands }) in example.instructions.iter().copied().enumerate() {
        let (types, count) = (operation.signature().0, operation.operand_count());
        if count == 0 || !seen.insert(discriminant(&operation)) {
            continue;
        }
        let mut add = |how: &str, changed: Instruction, fault: Fault| {
            let mut tape = example.clone();
            tape.instructions[index] = changed;
            cases.push((format!("{operation:?} with {how}"), tape, fault));
        };
        for (place, &wanted) in types.iter().enumerate() {
            let mut changed = Instruction { kind, operation, operands };
            changed.operands[place] = Some(other_type(&example, wanted));
            add(&format!("another type of operand {place}"), changed, SOME_TYPE);
            changed.operands[place] = None;
            add(&format!("no operand {place}"), changed, Fault::OperandCount { takes: count });
            changed.operands[place] = Some(NOWHERE);
            add(&format!("an unknown operand {place}"), changed, Fault::UnknownValue);
        }
        if count < 3 {
            let mut changed = Instruction { kind, operation, operands };
            changed.operands[count] = operands[0];
            add("an operand too many", changed, Fault::OperandCount { takes: count });
        }
        for other in [ValueType::F32, ValueType::Bool, ValueType::U32].into_iter().filter(|other| *other != kind) {
            add(&format!("a result of type {other:?}"), Instruction { kind: other, operation, operands }, SOME_TYPE);
        }
    }
    cases
}

#[test]
fn recorded_tapes_are_valid() {
    assert_eq!(example().verify().err(), None);
    assert_eq!(Tape::default().verify().err(), None);
}

#[test]
fn every_broken_tape_is_refused_with_its_fault() {
    let by_hand = [values::CASES, statements::CASES, functions::CASES].concat();
    assert!(by_hand.len() >= 100, "{} tapes are broken by hand", by_hand.len());
    let by_hand = by_hand.into_iter().map(|(name, change, fault)| {
        let mut tape = example();
        change(&mut tape);
        (name.to_owned(), tape, fault)
    });
    let (mut wrong, mut count) = (Vec::new(), 0);
    for (name, tape, fault) in by_hand.chain(cases_of_operations()) {
        count += 1;
        match tape.verify() {
            Ok(_) => wrong.push(format!("{name}: accepted")),
            Err(found) if discriminant(&found.fault) == discriminant(&fault) => {}
            Err(found) => wrong.push(format!("{name}: {found}")),
        }
        assert!(crate::tape::LinearTape::new(&tape).is_err() && tape.to_c().is_err(), "{name} reaches a back end");
    }
    println!("{count} broken tapes");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_message_names_the_step_the_value_and_the_fault() {
    let mut tape = example();
    tape.functions[MAIN].results[0] = find(&tape, Operation::Sqrt);
    let reported = tape.verify().expect_err("a value of a branch is returned").to_string();
    let id = find(&tape, Operation::Sqrt).0;
    assert_eq!(reported, format!("step \"main\", value {id}: it is used before its definition, or outside its block"));
}
