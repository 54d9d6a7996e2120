//! Random changes of recorded tapes. Each mutant is refused by the verifier, or it is a program like any other: it
//! becomes machine code, and all back ends compute the same bits.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use math::real::{Real, vec3};
use rayon::prelude::*;

use super::scalar::evaluate;
use super::{Fold, Function, Instruction, Operation, Statement, Tape, ValueId, ValueType, record};
use scene::cells::ScalarBuilder;

use crate::c_program;
use crate::evaluator::Evaluator;
use crate::picture_tape::record_distance;
use crate::random_formula::{Generator, fold, random_formula};
use crate::tape::Expr;

/// Scenes whose distances are changed too: with loops, branches, and calls.
const SCENES: [&str; 4] = ["csg", "mandelbulb", "menger", "modifiers"];
/// One mutant in this number is of a scene, which takes longer.
const SCENE_EVERY: usize = 64;
/// Lanes of a run: one batch of the interpreter.
const LANES: usize = 64;
/// Entry of a random formula.
const FORMULA: &str = "formula";

/// Tapes of random formulas, with more branches, loops and calls from one to the next.
fn formulas() -> Vec<Tape> {
    let of_seed = |seed: u64| {
        record(|recording| {
            recording
                .entry(FORMULA, |all: [Expr; 3]| vec![random_formula(&mut Generator(seed), &all, (seed % 4) as usize)]);
            recording.entry("second", |[a, b]: [Expr; 2]| {
                let (x, y) = Expr::repeat(4, (a, b), |(x, y)| ((x * y).lt(a), (y, x + 0.25)));
                vec![x, y.mul_add(x, b)]
            });
        })
    };
    let of_list = |seed: u64| {
        record(|recording| {
            recording.entry(FORMULA, |[a, b, c]: [Expr; 3]| {
                let (x, y) = fold(vec3(a, b, c));
                vec![random_formula(&mut Generator(seed), &[a, x, y], 1)]
            });
        })
    };
    let mut tapes: Vec<Tape> = (0..400).map(of_seed).chain((0..40).map(of_list)).collect();
    tapes.retain(|tape| tape.instructions.len() < 400);
    assert!(tapes.len() > 100, "{} small tapes", tapes.len());
    tapes
}

fn distances() -> Vec<Tape> {
    let of_scene = |name: &str| {
        let path = format!("{}/../../scenes/{name}.json", env!("CARGO_MANIFEST_DIR"));
        let job = scene::parse(&std::fs::read(path).expect("a shipped scene")).expect("a valid job");
        record_distance(&job.at(0).expect("a valid frame"), &ScalarBuilder)
    };
    SCENES.into_iter().map(of_scene).collect()
}

/// Changes one field of a tape.
fn mutate(tape: &mut Tape, random: &mut Generator) {
    match random.below(12) {
        0..=2 => change_operand(tape, random),
        3 => {
            let instruction = any_instruction(tape, random);
            instruction.operation = other_operation(instruction.operation, random);
        }
        4 => any_instruction(tape, random).kind = any_type(random),
        5 => any_instruction(tape, random).operands.rotate_right(1),
        6..=8 => change_statement(tape, random),
        9 => change_function(tape, random),
        10 => {
            tape.uniforms.pop();
        }
        _ => {
            let near = any_instruction(tape, random).operands[0];
            change_lists(tape, random, near);
        }
    }
}

fn any_instruction<'a>(tape: &'a mut Tape, random: &mut Generator) -> &'a mut Instruction {
    let index = random.below(tape.instructions.len());
    &mut tape.instructions[index]
}

fn any_type(random: &mut Generator) -> ValueType {
    [ValueType::F32, ValueType::Bool, ValueType::U32][random.below(3)]
}

/// Another operation, more often than not of the same signature.
fn other_operation(operation: Operation, random: &mut Generator) -> Operation {
    use Operation::{
        Abs, Add, AddU32, And, AndU32, Argument, CallResult, Constant, Div, Floor, Fma, FromBits, Less, Max, Min, Mul,
        MulU32, Neg, Not, Or, OrU32, Select, ShiftLeft, ShiftRight, Sqrt, Sub, ToBits, Uniform, Variable, Xor,
    };
    let all = [
        Add, Sub, Mul, Div, Fma, Min, Max, Neg, Abs, Floor, Sqrt, Less, And, Or, Not, Select, ToBits, FromBits, AddU32,
        MulU32, Xor, AndU32, OrU32, ShiftLeft, ShiftRight, Argument, CallResult, Variable,
    ];
    if let Constant(bits) = operation {
        return Constant(bits ^ 1 << random.below(32));
    }
    if random.below(8) == 0 {
        return if random.below(2) == 0 { Uniform(random.below(8) as u32) } else { all[random.below(all.len())] };
    }
    let same: Vec<Operation> = all.into_iter().filter(|other| other.signature() == operation.signature()).collect();
    same.get(random.below(same.len().max(1))).copied().unwrap_or(operation)
}

/// A value near this one, more often than not of the same type.
fn near(tape: &Tape, id: ValueId, random: &mut Generator) -> ValueId {
    let count = tape.instructions.len();
    let kind = tape.instructions.get(id.0 as usize).map(|instruction| instruction.kind);
    for _ in 0..8 {
        let other =
            if random.below(2) == 0 { random.below(count) } else { random.below((id.0 as usize).clamp(1, count)) };
        if kind.is_none_or(|kind| tape.instructions[other].kind == kind) {
            return ValueId(other as u32);
        }
    }
    ValueId(random.below(count + 2) as u32)
}

fn change_operand(tape: &mut Tape, random: &mut Generator) {
    let (index, place) = (random.below(tape.instructions.len()), random.below(3));
    tape.instructions[index].operands[place] = match tape.instructions[index].operands[place] {
        Some(_) if random.below(16) == 0 => None,
        None if random.below(16) != 0 => None,
        operand => Some(near(tape, operand.unwrap_or(ValueId(0)), random)),
    };
}

/// A block of the function, or one inside it.
fn any_block<'a>(body: &'a mut Vec<Statement>, random: &mut Generator) -> &'a mut Vec<Statement> {
    let is_nested = |statement: &Statement| matches!(statement, Statement::When { .. } | Statement::Repeat { .. });
    let inner: Vec<usize> = (0..body.len()).filter(|&index| is_nested(&body[index])).collect();
    if inner.is_empty() || random.below(3) == 0 {
        return body;
    }
    match &mut body[inner[random.below(inner.len())]] {
        Statement::When { body, .. } | Statement::Repeat { body, .. } => any_block(body, random),
        _ => unreachable!("it has a body"),
    }
}

fn any_function<'a>(tape: &'a mut Tape, random: &mut Generator) -> &'a mut Function {
    let index = random.below(tape.functions.len());
    &mut tape.functions[index]
}

/// Moves, exchanges, doubles or removes a statement, or changes it.
fn change_statement(tape: &mut Tape, random: &mut Generator) {
    let (functions, value) = (tape.functions.len(), ValueId(random.below(tape.instructions.len()) as u32));
    let function = any_function(tape, random);
    let block = any_block(&mut function.body, random);
    if block.is_empty() {
        return;
    }
    let (from, to) = (random.below(block.len()), random.below(block.len()));
    match random.below(8) {
        0 | 1 => block.swap(from, to),
        2 => {
            let statement = block.remove(from);
            any_block(&mut function.body, random).push(statement);
        }
        3 => {
            block.remove(from);
        }
        4 => {
            let again = block[from].clone();
            block.insert(to, again);
        }
        _ => match &mut block[from] {
            Statement::Emit(id) => *id = value,
            Statement::Comment(text) => *text = "changed",
            Statement::Call { function, .. } => *function = random.below(functions + 1),
            Statement::When { condition, .. } => *condition = value,
            Statement::Repeat { limit, .. } if random.below(2) == 0 => *limit = [0, 1, 2, 3, u32::MAX][random.below(5)],
            Statement::Repeat { again, .. } => *again = value,
            Statement::Fold(fold) => match random.below(4) {
                0 => fold.list = value,
                1 => fold.last = value,
                2 => fold.depth = random.below(10) as u32,
                _ => {
                    let list = if random.below(2) == 0 { &mut fold.leaves } else { &mut fold.joins };
                    list.push(random.below(functions + 1));
                }
            },
        },
    }
}

/// Changes the lists of one statement or function.
fn change_lists(tape: &mut Tape, random: &mut Generator, value: Option<ValueId>) {
    let other = near(tape, value.unwrap_or(ValueId(0)), random);
    let function = any_function(tape, random);
    let list = if random.below(4) == 0 {
        if random.below(2) == 0 { &mut function.arguments } else { &mut function.results }
    } else {
        let block = any_block(&mut function.body, random);
        let lists = block.iter_mut().filter_map(|statement| match statement {
            Statement::Emit(_) | Statement::Comment(_) => None,
            Statement::Call { arguments, returned, .. } => Some([arguments, returned].into_iter().collect::<Vec<_>>()),
            Statement::Fold(Fold { arguments, returned, .. }) => Some(vec![arguments, returned]),
            Statement::When { variables, otherwise, value, .. } => Some(vec![variables, otherwise, value]),
            Statement::Repeat { variables, start, next, .. } => Some(vec![variables, start, next]),
        });
        let mut lists: Vec<&mut Vec<ValueId>> = lists.flatten().collect();
        if lists.is_empty() {
            return;
        }
        lists.swap_remove(random.below(lists.len()))
    };
    let (length, place) = (list.len(), random.below(list.len().max(1)));
    match random.below(6) {
        0 => list.push(other),
        _ if length == 0 => {}
        1 => {
            list.remove(place);
        }
        2 => list.swap(place, random.below(length)),
        3 => list[place] = list[random.below(length)],
        _ => list[place] = other,
    }
}

fn change_function(tape: &mut Tape, random: &mut Generator) {
    let (a, b) = (random.below(tape.functions.len()), random.below(tape.functions.len()));
    match random.below(6) {
        0 => tape.functions.swap(a, b),
        5 => tape.functions[a].row_words = [None, Some(0), Some(2), Some(1 << 20)][random.below(4)],
        1 => {
            tape.functions.remove(a);
        }
        2 => tape.functions[a].is_entry ^= true,
        3 => tape.functions[a].name = ["formula", "other", "no name", ""][random.below(4)],
        _ => {
            let again = tape.functions[a].clone();
            tape.functions.insert(b, again);
        }
    }
}

/// Runs all entries by all back ends; returns the number of results that were compared.
fn assert_equal(name: &str, tape: &Tape) -> usize {
    let (mut compared, cancel, mut random) = (0, AtomicBool::new(false), Generator(7));
    let evaluators = Evaluator::each(tape).expect("the tape is valid");
    for entry in tape.functions.iter().filter(|function| function.is_entry) {
        let rows = entry.arguments.len();
        let arguments: Vec<f32> = (0..rows * LANES).map(|_| random.word() as f32 / (1 << 30) as f32 - 1.998).collect();
        let of_lane = |lane: usize| (0..rows).map(|row| arguments[row * LANES + lane]).collect::<Vec<f32>>();
        let want: Vec<_> = (0..LANES).map(|lane| evaluate(tape, entry.name, &of_lane(lane))).collect();
        for (simd, evaluator) in &evaluators {
            let (inputs, mut frame) = (evaluator.inputs(tape), evaluator.frame());
            // Wide ones are given each lane more than once.
            let width = evaluator.lanes().max(LANES);
            let given: Vec<f32> =
                (0..rows * width).map(|place| arguments[place / width * LANES + place % width % LANES]).collect();
            let mut results = vec![0.0; entry.results.len() * width];
            evaluator.run(entry.name, &mut frame, &inputs, &cancel, &given, &mut results);
            for (place, result) in results.iter().enumerate() {
                let (row, lane) = (place / width, place % width % LANES);
                let word = want[lane][row];
                if !word.is_vague {
                    compared += 1;
                    let (got, want) = (result + 0.0, f32::from_bits(word.bits) + 0.0);
                    assert!(
                        got.to_bits() == want.to_bits(),
                        "{name}: {} by {simd}, lane {lane} of result {row} is {got} for {want}\n{tape:?}",
                        entry.name
                    );
                }
            }
        }
    }
    compared
}

/// Mutant of a number: one of these tapes with one to three changes.
fn mutant(seed: usize, tapes: &[Tape]) -> Tape {
    let mut random = Generator(seed as u64);
    random.word();
    let mut tape = tapes[random.below(tapes.len())].clone();
    for _ in 0..=random.below(3) {
        if !tape.functions.is_empty() {
            mutate(&mut tape, &mut random);
        }
    }
    tape
}

/// Makes this number of mutants, and runs those that are valid.
fn assert_refused_or_equal(count: usize) {
    let (small, large) = (formulas(), distances());
    let (valid, compared) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let counts = [AtomicUsize::new(0), AtomicUsize::new(0)];
    (0..count).into_par_iter().for_each(|seed| {
        let is_scene = seed % SCENE_EVERY == 0;
        let tape = mutant(seed, if is_scene { &large } else { &small });
        counts[usize::from(is_scene)].fetch_add(1, Ordering::Relaxed);
        if tape.verify().is_ok() {
            valid.fetch_add(1, Ordering::Relaxed);
            compared.fetch_add(assert_equal(&format!("mutant {seed}"), &tape), Ordering::Relaxed);
        }
    });
    let [of_formulas, of_scenes] = counts.map(AtomicUsize::into_inner);
    let (valid, compared) = (valid.into_inner(), compared.into_inner());
    println!("{of_formulas} mutants of formulas, {of_scenes} of scenes: {valid} valid, {compared} results compared");
    assert!(valid > count / 20 && compared > valid * LANES, "too few mutants are valid to show much");
}

#[test]
fn mutants_are_refused_or_equal_on_all_back_ends() {
    assert_refused_or_equal(20_000);
}

#[test]
#[ignore = "long: a million mutants of tapes; 2 minutes"]
fn a_million_mutants_are_refused_or_equal_on_all_back_ends() {
    assert_refused_or_equal(1_000_000);
}

#[test]
fn c_source_of_valid_mutants_gives_the_same_bits() {
    let tapes = formulas();
    let is_entry = |function: &Function| function.name == FORMULA && function.is_entry && function.arguments.len() == 3;
    let mutants: Vec<Tape> = (0..4000)
        .map(|seed| mutant(seed, &tapes))
        .filter(|tape| tape.functions.iter().any(is_entry) && tape.verify().is_ok())
        // Text trusts the lists of a scene, which a mutant's index may miss.
        .filter(|tape| tape.functions.iter().all(|function| function.row_words.is_none()))
        .take(400)
        .collect();
    let mut random = Generator(3);
    let arguments: Vec<f32> = (0..3 * LANES).map(|_| random.word() as f32 / (1 << 30) as f32 - 1.998).collect();
    let Some(results) = c_program::evaluate(&mutants.iter().collect::<Vec<_>>(), FORMULA, &arguments) else { return };
    let mut compared = 0;
    for (index, (tape, results)) in mutants.iter().zip(results).enumerate() {
        for (lane, got) in results.into_iter().enumerate() {
            let given = [0, 1, 2].map(|row| arguments[row * LANES + lane]);
            let word = evaluate(tape, FORMULA, &given)[0];
            if !word.is_vague {
                compared += 1;
                let want = f32::from_bits(word.bits) + 0.0;
                assert!((got + 0.0).to_bits() == want.to_bits(), "mutant {index}: {got} for {want}\n{tape:?}");
            }
        }
    }
    println!("{} mutants as C: {compared} results compared", mutants.len());
    assert!(mutants.len() >= 300 && compared > 100 * LANES, "too few mutants are valid to show much");
}
