//! Records a tape while a formula runs on symbolic numbers.
//!
//! Numbers are handles of four bytes that operators consume, so the tape under construction is in a
//! thread-local variable.

use std::any::{Any, TypeId};
use std::cell::RefCell;
use std::collections::HashMap;

use math::real::list::ListFunctions;
use math::real::{Bundle, FunctionKey, Merge, Table, Vec3};

use crate::interrupt;

#[cfg(test)]
use super::same_function;
use super::{BoolExpr, Expr, Fold, Function, Instruction, Operation, Statement, Tape, ValueId, ValueType};

thread_local! {
    static RECORDER: RefCell<Option<Recorder>> = const { RefCell::new(None) };
}

/// Number of values between two looks at whether the recording is interrupted.
const VALUES_BETWEEN_CHECKS: u32 = 256;

/// The tape under construction.
#[derive(Default)]
struct Recorder {
    tape: Tape,
    /// Functions being recorded, the innermost last.
    open: Vec<FunctionBuilder>,
    /// The function of each key and type of call.
    shared: HashMap<(FunctionKey, TypeId), RecordedFunction>,
    /// Whether the body of each further call is recorded again, and compared with the first.
    #[cfg(test)]
    compares: bool,
    /// Index of the function that defined each value, counted from the first function.
    defining_function: Vec<u32>,
    begun: u32,
    /// The uniform that is the index of the table's last word.
    last_word: Option<ValueId>,
}

struct FunctionBuilder {
    number: u32,
    arguments: Vec<ValueId>,
    blocks: Vec<BlockBuilder>,
    /// In a function of lists, the number of words of its row that were used: numbers of the scene are these.
    row_words: Option<u32>,
}

/// Statements, and the value of each operation already among them.
#[derive(Default)]
struct BlockBuilder {
    statements: Vec<Statement>,
    value_numbers: HashMap<Instruction, ValueId>,
}

/// Recorded function that later calls reuse.
struct RecordedFunction {
    function: usize,
    /// Example of the bundle that it returns.
    example: Box<dyn Any>,
}

/// Guard that shows that a recording is in progress on this thread.
#[derive(Debug)]
pub struct Recording(());

/// Records the formulas that `formulas` evaluates.
pub fn record(formulas: impl FnOnce(&Recording)) -> Tape {
    record_by(Recorder::default(), formulas)
}

/// Like [`record`], and panics if the body of a further call differs from the one of its key.
#[cfg(test)]
pub(crate) fn record_and_compare(formulas: impl FnOnce(&Recording)) -> Tape {
    record_by(Recorder { compares: true, ..Recorder::default() }, formulas)
}

fn record_by(recorder: Recorder, formulas: impl FnOnce(&Recording)) -> Tape {
    /// Restores the recorder of the outer recording, also when the inner one is interrupted.
    struct Outer(Option<Recorder>);

    impl Drop for Outer {
        fn drop(&mut self) {
            RECORDER.set(self.0.take());
        }
    }

    let _outer = Outer(RECORDER.replace(Some(recorder)));
    formulas(&Recording(()));
    RECORDER.take().expect("nothing else ends a recording").tape
}

impl Recording {
    /// Records a function that the surrounding source calls.
    pub fn entry<const N: usize>(&self, name: &'static str, formula: impl FnOnce([Expr; N]) -> Vec<Expr>) {
        let formula = |all: Vec<Expr>| formula(all.try_into().expect("it has as many arguments as were asked for"));
        self.entry_of(name, N, formula);
    }

    /// Records a function of this many arguments.
    pub fn entry_of(&self, name: &'static str, arguments: usize, formula: impl FnOnce(Vec<Expr>) -> Vec<Expr>) {
        begin();
        let arguments = (0..arguments).map(|_| Expr(argument(ValueType::F32))).collect();
        let results = formula(arguments).into_iter().map(|number| number.0).collect();
        end(name, results, true);
    }
}

fn with<T>(act: impl FnOnce(&mut Recorder) -> T) -> T {
    RECORDER.with_borrow_mut(|recorder| act(recorder.as_mut().expect("symbols are only used while recording")))
}

impl Recorder {
    fn function(&mut self) -> &mut FunctionBuilder {
        self.open.last_mut().expect("symbols are only used in a function")
    }

    fn block(&mut self) -> &mut BlockBuilder {
        self.function().blocks.last_mut().expect("a function has a block until it ends")
    }

    fn new_value(&mut self, kind: ValueType, operation: Operation, operands: [Option<ValueId>; 3]) -> ValueId {
        let id = ValueId(self.tape.instructions.len() as u32);
        if id.0.is_multiple_of(VALUES_BETWEEN_CHECKS) {
            interrupt::check();
        }
        self.tape.instructions.push(Instruction { kind, operation, operands });
        let owner = self.function().number;
        self.defining_function.push(owner);
        id
    }

    /// Panics if a formula uses a value of another function than the one being recorded.
    fn check(&mut self, id: ValueId) {
        let is_own = self.defining_function[id.0 as usize] == self.function().number;
        assert!(
            is_own || self.tape.definition(id).operation.is_constant(),
            "a shared step used a number that is not one of its arguments"
        );
    }
}

/// Value of an operation; equal operations share one value.
pub(super) fn emit(kind: ValueType, operation: Operation, operands: &[ValueId]) -> ValueId {
    with(|recorder| {
        let mut all = [None; 3];
        for (place, &operand) in all.iter_mut().zip(operands) {
            recorder.check(operand);
            *place = Some(operand);
        }
        if operation.is_commutative() && all[1] < all[0] {
            all.swap(0, 1);
        }
        let definition = Instruction { kind, operation, operands: all };
        let known = recorder.function().blocks.iter().find_map(|block| block.value_numbers.get(&definition).copied());
        known.unwrap_or_else(|| {
            let id = recorder.new_value(kind, operation, all);
            let block = recorder.block();
            block.value_numbers.insert(definition, id);
            if !operation.is_constant() {
                block.statements.push(Statement::Emit(id));
            }
            id
        })
    })
}

/// Uniform of the scene, by its bits; in a function of lists, the next word of its row.
pub(super) fn uniform(kind: ValueType, bits: u32) -> ValueId {
    let place = with(|recorder| {
        let is_inner = recorder.open.iter().rev().skip(1).any(|function| function.row_words.is_some());
        assert!(!is_inner, "numbers of a row are given to shared steps as arguments");
        let words = recorder.function().row_words.as_mut()?;
        *words += 1;
        Some(*words - 1)
    });
    match place {
        Some(place) => emit(kind, Operation::Row(place), &[]),
        None => new_uniform(kind, bits),
    }
}

/// Word of a table. All words of a tape are of one table.
pub(super) fn word(table: &Table, index: ValueId) -> ValueId {
    let last = last_word(table);
    emit(ValueType::U32, Operation::Word, &[index, last])
}

/// Word in place of one that says that its contents do not exist.
pub(super) fn made(table: &Table, missing: ValueId) -> ValueId {
    let last = last_word(table);
    emit(ValueType::U32, Operation::Made, &[missing, last])
}

/// The uniform that is the index of the table's last word.
fn last_word(table: &Table) -> ValueId {
    let known = with(|recorder| recorder.tape.table.clone().zip(recorder.last_word));
    if let Some((known, last)) = known {
        assert!(Table::ptr_eq(&known, table), "a formula reads one table");
        return last;
    }
    let last = new_uniform(ValueType::U32, table.capacity() as u32 - 1);
    with(|recorder| {
        recorder.tape.table = Some(table.clone());
        recorder.last_word = Some(last);
    });
    last
}

/// Value of a list.
pub(super) fn fold<F: ListFunctions<Expr>>(table: &Table, first: ValueId, p: Vec3<Expr>, functions: &F) -> F::Value {
    let last = last_word(table);
    let leaf = |(index, name): (usize, &&'static str)| function_of_rows(name, p, |p| functions.leaf(index, None, p));
    let (leaves, values): (Vec<usize>, Vec<F::Value>) = functions.leaf_names().iter().enumerate().map(leaf).unzip();
    let example = *values.first().expect("a list has leaves");
    let join = |(index, name): (usize, &&'static str)| {
        function_of_rows(name, (example, example), |(below, value)| functions.join(index, None, below, value)).0
    };
    let joins = functions.join_names().iter().enumerate().map(join).collect();
    let result = fresh_values(example, Operation::CallResult);
    push(Statement::Fold(Fold {
        list: first,
        last,
        arguments: parts(p),
        leaves,
        joins,
        depth: functions.depth() as u32,
        returned: parts(result),
    }));
    result
}

/// Records a function of lists; returns its index, and an example of its value.
fn function_of_rows<A: Bundle<Expr>, T: Bundle<Expr>>(
    name: &'static str,
    arguments: A,
    step: impl FnOnce(A) -> T,
) -> (usize, T) {
    begin();
    with(|recorder| recorder.function().row_words = Some(0));
    let formal = arguments.merge(arguments, &mut FreshValues(argument));
    let result = step(formal);
    (end(name, parts(result), false), result)
}

fn new_uniform(kind: ValueType, bits: u32) -> ValueId {
    with(|recorder| {
        let place = recorder.tape.uniforms.len() as u32;
        recorder.tape.uniforms.push(bits);
        recorder.new_value(kind, Operation::Uniform(place), [None; 3])
    })
}

pub(super) fn note(name: &'static str) {
    with(|recorder| recorder.block().statements.push(Statement::Comment(name)));
}

fn fresh(kind: ValueType, operation: Operation) -> ValueId {
    with(|recorder| recorder.new_value(kind, operation, [None; 3]))
}

fn argument(kind: ValueType) -> ValueId {
    let id = fresh(kind, Operation::Argument);
    with(|recorder| recorder.function().arguments.push(id));
    id
}

fn begin() {
    with(|recorder| {
        let number = recorder.begun;
        recorder.begun += 1;
        recorder.open.push(FunctionBuilder {
            number,
            arguments: Vec::new(),
            blocks: vec![BlockBuilder::default()],
            row_words: None,
        });
    });
}

fn end(name: &'static str, results: Vec<ValueId>, is_entry: bool) -> usize {
    with(|recorder| {
        for &id in &results {
            recorder.check(id);
        }
        let FunctionBuilder { arguments, mut blocks, row_words, .. } =
            recorder.open.pop().expect("a function was begun");
        let body = blocks.pop().expect("a function has a block until it ends").statements;
        recorder.tape.functions.push(Function { name, arguments, body, results, is_entry, row_words });
        recorder.tape.functions.len() - 1
    })
}

/// Records the operations of `inside` as a block.
fn block<T>(inside: impl FnOnce() -> T) -> (T, Vec<Statement>) {
    with(|recorder| recorder.function().blocks.push(BlockBuilder::default()));
    let value = inside();
    let block = with(|recorder| recorder.function().blocks.pop()).expect("it was opened above");
    (value, block.statements)
}

fn push(statement: Statement) {
    with(|recorder| recorder.block().statements.push(statement));
}

/// Lists the parts of a bundle.
struct CollectIds(Vec<ValueId>);

impl Merge<Expr> for CollectIds {
    fn number(&mut self, a: Expr, _: Expr) -> Expr {
        self.0.push(a.0);
        a
    }

    fn mask(&mut self, a: BoolExpr, _: BoolExpr) -> BoolExpr {
        self.0.push(a.0);
        a
    }
}

/// Creates a bundle of new values.
struct FreshValues<F>(F);

impl<F: FnMut(ValueType) -> ValueId> Merge<Expr> for FreshValues<F> {
    fn number(&mut self, _: Expr, _: Expr) -> Expr {
        Expr((self.0)(ValueType::F32))
    }

    fn mask(&mut self, _: BoolExpr, _: BoolExpr) -> BoolExpr {
        BoolExpr((self.0)(ValueType::Bool))
    }
}

fn parts<T: Bundle<Expr>>(bundle: T) -> Vec<ValueId> {
    let mut parts = CollectIds(Vec::new());
    bundle.merge(bundle, &mut parts);
    parts.0
}

fn fresh_values<T: Bundle<Expr>>(example: T, operation: Operation) -> T {
    example.merge(example, &mut FreshValues(|kind| fresh(kind, operation)))
}

pub(super) fn when<T: Bundle<Expr>>(condition: BoolExpr, otherwise: T, then: impl FnOnce() -> T) -> T {
    let (then, body) = block(then);
    let variables = fresh_values(otherwise, Operation::Variable);
    push(Statement::When {
        condition: condition.0,
        variables: parts(variables),
        otherwise: parts(otherwise),
        body,
        value: parts(then),
    });
    variables
}

pub(super) fn repeat<T: Bundle<Expr>>(limit: u32, pauses: bool, start: T, step: impl FnOnce(T) -> (BoolExpr, T)) -> T {
    let variables = fresh_values(start, Operation::Variable);
    let ((again, next), body) = block(|| step(variables));
    push(Statement::Repeat {
        limit,
        pauses,
        variables: parts(variables),
        start: parts(start),
        body,
        next: parts(next),
        again: again.0,
    });
    variables
}

pub(super) fn shared<A: Bundle<Expr>, T: Bundle<Expr>>(key: FunctionKey, arguments: A, body: impl FnOnce(A) -> T) -> T {
    let scope = (key, TypeId::of::<(A, T)>());
    let known = with(|recorder| {
        let shared = recorder.shared.get(&scope)?;
        let example = shared.example.downcast_ref::<T>().expect("its scope has the type");
        Some((shared.function, *example))
    });
    let (function, example) = if let Some(known) = known {
        #[cfg(test)]
        check_again(key, known.0, || record_function(key, arguments, body));
        known
    } else {
        let (function, result) = record_function(key, arguments, body);
        with(|recorder| recorder.shared.insert(scope, RecordedFunction { function, example: Box::new(result) }));
        (function, result)
    };
    let result = fresh_values(example, Operation::CallResult);
    push(Statement::Call { function, arguments: parts(arguments), returned: parts(result) });
    result
}

/// Records a shared function; returns its index, and an example of its result.
fn record_function<A: Bundle<Expr>, T: Bundle<Expr>>(
    key: FunctionKey,
    arguments: A,
    body: impl FnOnce(A) -> T,
) -> (usize, T) {
    begin();
    let formal = arguments.merge(arguments, &mut FreshValues(argument));
    let result = body(formal);
    (end(key.name(), parts(result), false), result)
}

/// Panics if a function that is recorded again differs from the one of its key; forgets the second recording.
#[cfg(test)]
fn check_again<T>(key: FunctionKey, function: usize, record_again: impl FnOnce() -> (usize, T)) {
    // Functions that the second recording calls were compared at their own calls.
    if !with(|recorder| std::mem::replace(&mut recorder.compares, false)) {
        return;
    }
    let counts = |tape: &Tape| (tape.instructions.len(), tape.uniforms.len(), tape.functions.len());
    let (instructions, uniforms, functions) = with(|recorder| counts(&recorder.tape));
    let (again, _) = record_again();
    with(|recorder| {
        let tape = &mut recorder.tape;
        let is_same = same_function::is_same(tape, &tape.functions[function], &tape.functions[again]);
        assert!(is_same, "the function {key:?} has two bodies");
        tape.instructions.truncate(instructions);
        tape.uniforms.truncate(uniforms);
        tape.functions.truncate(functions);
        recorder.defining_function.truncate(instructions);
        recorder.compares = true;
    });
}
