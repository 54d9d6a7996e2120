//! Interpreter of a tape, for every CPU: each step is a loop over a batch of lanes, which the Rust compiler turns into
//! vector instructions.

mod arithmetic;
mod fold;
mod masks;

use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::tape::{Allocation, Linear, LinearTape, Location, Operation, PAUSE, Registers, Step, Var, allocate};
#[cfg(target_arch = "x86_64")]
use crate::x86::{AVX2, AVX512};
pub(crate) use arithmetic::LANES;
use arithmetic::{Batch, Splat, apply, gather};
use fold::{Fold, Layout};
use math::real::{Table, Words};

/// Slot for a first operand that is an input.
const SCRATCH: usize = 0;

/// Instructions that loops are compiled for: the interpreter's, and those that prune lists.
#[derive(Clone, Copy, Debug)]
pub enum Instructions {
    /// AVX-512.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// The instructions that the build assumes of every CPU.
    OfTheBuild,
}

impl Instructions {
    /// The widest of this CPU.
    pub fn available() -> Self {
        #[cfg(target_arch = "x86_64")]
        if AVX512.is_available() {
            return Self::Avx512;
        } else if AVX2.is_available() {
            return Self::Avx2;
        }
        Self::OfTheBuild
    }
}

/// A tape to be interpreted.
#[derive(Debug)]
pub(crate) struct Program {
    instructions: Instructions,
    functions: Vec<Option<Function>>,
    entries: Vec<(&'static str, usize)>,
    inputs: Vec<Input>,
    slots: usize,
    counters: usize,
}

/// A function whose steps address slots of the frame.
#[derive(Debug)]
struct Function {
    operations: Vec<Instruction>,
    live: usize,
    arguments: Vec<usize>,
    /// Its results, and the slots where the caller finds them.
    results: Vec<(Operand, usize)>,
    /// Words of its row, and the inputs that they are.
    row: Vec<(u32, usize)>,
}

/// A number that is the same in all lanes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Input {
    Constant(u32),
    /// By its index.
    Uniform(u32),
    /// Word of the current row.
    Row(u32),
}

/// An operand: a slot of the frame, or an input by its index.
#[derive(Clone, Copy, Debug)]
enum Operand {
    Slot(usize),
    Input(usize),
}

/// A step on slots, with branch targets as indices of instructions. Moves of a call are pairs of a target and a source.
#[derive(Debug)]
enum Instruction {
    Compute { to: usize, operation: Operation, operands: [Operand; 3] },
    Move { to: usize, from: Operand },
    MoveWhere { mask: Operand, to: usize, from: Operand },
    SkipIfNone { mask: Operand, end: usize },
    Count { counter: usize, limit: u32 },
    CountLanes { counter: usize, mask: Operand },
    RepeatWhileAny { mask: Operand, counter: usize, top: usize, pauses: bool },
    Call { callee: usize, moves: Vec<(usize, Operand)>, results: Vec<(usize, usize)> },
    Make { live: Operand, to: usize, missing: Operand },
    Fold(Box<Fold>),
}

/// Memory of a thread that runs a program.
#[derive(Debug)]
pub(crate) struct Frame {
    #[expect(clippy::vec_box, reason = "a result is put in its slot without a copy")]
    slots: Vec<Box<Batch>>,
    /// Becomes the target of an operation when it is complete.
    spare: Box<Batch>,
    /// Values of the inputs.
    inputs: Vec<u32>,
    counters: Vec<u32>,
}

impl Program {
    /// Prepares a tape.
    pub(crate) fn new(tape: &LinearTape) -> Self {
        let allocated = |linear: &Linear| allocate(linear, Registers::default());
        let allocations: Vec<Option<Allocation>> =
            tape.functions.iter().map(|linear| linear.as_ref().map(allocated)).collect();
        let inputs = inputs(&allocations);
        // As in machine code: a callee's part of the frame begins after all its callers'.
        let mut layouts = vec![Layout { live: SCRATCH + 1, ..Layout::default() }; tape.functions.len()];
        let (mut slots, mut counters) = (SCRATCH + 1, 0);
        for (index, linear) in tape.functions.iter().enumerate().rev() {
            let (Some(linear), Some(allocation)) = (linear, &allocations[index]) else { continue };
            let layout = &mut layouts[index];
            // A fold gives the parts of functions of lists.
            if layout.slots == 0 {
                layout.arguments = layout.live + 1;
                layout.results = layout.arguments + linear.arguments.len();
                layout.slots = layout.results + linear.results.len();
            }
            layout.folds = layout.slots + allocation.slots as usize;
            let of_folds = linear.steps.iter().map(|step| if let Step::Fold(fold) = step { fold.packets() } else { 0 });
            layout.end = layout.folds + of_folds.max().unwrap_or(0) as usize;
            layout.counters = counters;
            counters += linear.counters;
            let end = layout.end;
            slots = slots.max(end);
            for step in &linear.steps {
                match step {
                    Step::Call { callee, .. } => layouts[*callee].live = layouts[*callee].live.max(end),
                    Step::Fold(fold) => fold::lay_out(fold, end, &mut layouts),
                    _ => {}
                }
            }
        }
        let input_indices: HashMap<Input, usize> =
            inputs.iter().enumerate().map(|(index, &input)| (input, index)).collect();
        let functions = tape.functions.iter().zip(&allocations).enumerate();
        let functions = functions.map(|(index, (linear, allocation))| {
            let places = Places { allocation: allocation.as_ref()?, layout: layouts[index], inputs: &input_indices };
            Some(places.function(linear.as_ref()?, &layouts))
        });
        Self {
            instructions: Instructions::available(),
            functions: functions.collect(),
            entries: tape.entries.clone(),
            inputs,
            slots,
            counters,
        }
    }

    /// The same, but without the instructions that a build does not assume.
    pub(crate) fn of_the_build(self) -> Self {
        Self { instructions: Instructions::OfTheBuild, ..self }
    }

    /// Memory to run it in.
    pub(crate) fn frame(&self) -> Frame {
        let batch = || Box::new(Batch([0; LANES]));
        Frame {
            slots: std::iter::repeat_with(batch).take(self.slots).collect(),
            spare: batch(),
            inputs: Vec::new(),
            counters: vec![0; self.counters],
        }
    }

    /// Evaluates an entry. Arguments and results are rows of one length, a multiple of [`LANES`]. Once `cancel` is set,
    /// it returns early, with meaningless results.
    ///
    /// # Panics
    /// If there is no such entry, or the arguments or results do not match the entry.
    pub(crate) fn run(
        &self,
        entry: &str,
        frame: &mut Frame,
        (uniforms, table): (&[u32], &Table),
        cancel: &AtomicBool,
        arguments: &[f32],
        results: &mut [f32],
    ) {
        let (_, index) = *self.entries.iter().find(|(name, _)| *name == entry).expect("an entry of the tape");
        let function = self.functions[index].as_ref().expect("an entry has results");
        let length = results.len() / function.results.len();
        assert!(length.is_multiple_of(LANES), "whole batches");
        assert_eq!(arguments.len(), function.arguments.len() * length, "arguments of the entry");
        assert_eq!(results.len(), function.results.len() * length, "results of the entry");
        frame.inputs.clear();
        frame.inputs.extend(self.inputs.iter().map(|input| match *input {
            Input::Constant(bits) => bits,
            Input::Uniform(index) => uniforms[index as usize],
            // Until a fold begins with a row.
            Input::Row(_) => 0,
        }));
        for first in (0..length).step_by(LANES) {
            frame.slots[function.live].0.fill(u32::MAX);
            for (&slot, argument) in function.arguments.iter().zip(arguments.chunks_exact(length)) {
                let argument = &argument[first..first + LANES];
                frame.slots[slot].0.iter_mut().zip(argument).for_each(|(to, from)| *to = from.to_bits());
            }
            Run { program: self, cancel, table, frame }.call(index);
            for (result, (_, slot)) in results.chunks_exact_mut(length).zip(&function.results) {
                let result = &mut result[first..first + LANES];
                result.iter_mut().zip(&frame.slots[*slot].0).for_each(|(to, from)| *to = f32::from_bits(*from));
            }
        }
    }
}

/// Constants and uniforms of all functions, each once.
fn inputs(allocations: &[Option<Allocation>]) -> Vec<Input> {
    let mut inputs = Vec::new();
    let mut known = HashSet::new();
    for place in allocations.iter().flatten().flat_map(|allocation| &allocation.places) {
        inputs.extend(Input::at(*place).filter(|input| known.insert(*input)));
    }
    inputs
}

impl Input {
    fn at(place: Location) -> Option<Self> {
        match place {
            Location::Constant(bits) => Some(Self::Constant(bits)),
            Location::Uniform(index) => Some(Self::Uniform(index)),
            Location::Row(word) => Some(Self::Row(word)),
            Location::Slot(_)
            | Location::Argument(_)
            | Location::Live
            | Location::Vector(_)
            | Location::Mask(_)
            | Location::Nowhere => None,
        }
    }
}

/// Places of one function's variables in the frame.
struct Places<'a> {
    allocation: &'a Allocation,
    layout: Layout,
    inputs: &'a HashMap<Input, usize>,
}

impl Places<'_> {
    fn source(&self, var: Var) -> Operand {
        let place = self.allocation.places[var as usize];
        match Input::at(place) {
            Some(input) => Operand::Input(self.inputs[&input]),
            None => Operand::Slot(self.in_frame(place).expect("there are no registers")),
        }
    }

    fn in_frame(&self, place: Location) -> Option<usize> {
        match place {
            Location::Slot(slot) => Some(self.layout.slots + slot as usize),
            Location::Argument(argument) => Some(self.layout.arguments + argument as usize),
            Location::Live => Some(self.layout.live),
            Location::Vector(_)
            | Location::Mask(_)
            | Location::Constant(_)
            | Location::Uniform(_)
            | Location::Row(_)
            | Location::Nowhere => None,
        }
    }

    fn target(&self, var: Var) -> Option<usize> {
        self.in_frame(self.allocation.places[var as usize])
    }

    fn function(&self, linear: &Linear, layouts: &[Layout]) -> Function {
        let mut operations = Vec::with_capacity(linear.steps.len());
        let mut labels = vec![0; linear.labels];
        for step in &linear.steps {
            if let Step::Label(label) | Step::Top(label) = step {
                labels[*label] = operations.len();
            } else {
                operations.extend(self.instruction(step, layouts));
            }
        }
        // Labels that came later than their branches.
        for operation in &mut operations {
            if let Instruction::SkipIfNone { end: label, .. } | Instruction::RepeatWhileAny { top: label, .. } =
                operation
            {
                *label = labels[*label];
            }
        }
        let results = linear.results.iter().enumerate();
        let rows = self.allocation.places.iter().filter_map(|place| match Input::at(*place) {
            Some(input @ Input::Row(word)) => Some((word, self.inputs[&input])),
            _ => None,
        });
        Function {
            row: rows.collect(),
            operations,
            live: self.layout.live,
            arguments: (0..linear.arguments.len()).map(|place| self.layout.arguments + place).collect(),
            results: results.map(|(place, &var)| (self.source(var), self.layout.results + place)).collect(),
        }
    }

    /// Instruction of a step that is not a label; `None` if nothing reads its result. Its branches go to labels.
    fn instruction(&self, step: &Step, layouts: &[Layout]) -> Option<Instruction> {
        Some(match step {
            Step::Compute { to, operation, operands } => {
                let (to, count) = (self.target(*to)?, operation.operand_count());
                // Those that it does not have are not read.
                let mut sources = [Operand::Slot(to); 3];
                for (source, &var) in sources.iter_mut().zip(&operands[..count]) {
                    *source = self.source(var);
                }
                let is_product = matches!(operation, Operation::Fma);
                if let [Operand::Input(_), Operand::Slot(_), _] = sources
                    && (is_product || operation.is_commutative())
                {
                    sources.swap(0, 1);
                }
                Instruction::Compute { to, operation: *operation, operands: sources }
            }
            Step::Move { to, from } => Instruction::Move { to: self.target(*to)?, from: self.source(*from) },
            Step::MoveWhere { mask, to, from } => {
                Instruction::MoveWhere { mask: self.source(*mask), to: self.target(*to)?, from: self.source(*from) }
            }
            Step::SkipIfNone { mask, end } => Instruction::SkipIfNone { mask: self.source(*mask), end: *end },
            Step::Count { counter, limit } => {
                Instruction::Count { counter: self.layout.counters + counter, limit: *limit }
            }
            Step::CountLanes { counter, mask } => {
                Instruction::CountLanes { counter: self.layout.counters + counter, mask: self.source(*mask) }
            }
            Step::RepeatWhileAny { mask, counter, top, pauses } => Instruction::RepeatWhileAny {
                pauses: *pauses,
                mask: self.source(*mask),
                counter: self.layout.counters + counter,
                top: *top,
            },
            Step::Call { callee, live, arguments, results } => {
                let layout = layouts[*callee];
                let arguments = arguments.iter().enumerate();
                let arguments = arguments.map(|(place, &var)| (layout.arguments + place, self.source(var)));
                let results = results.iter().enumerate();
                Instruction::Call {
                    callee: *callee,
                    moves: arguments.chain([(layout.live, self.source(*live))]).collect(),
                    results: results
                        .filter_map(|(place, &var)| Some((self.target(var)?, layout.results + place)))
                        .collect(),
                }
            }
            Step::Make { live, to, missing } => {
                Instruction::Make { live: self.source(*live), to: self.target(*to)?, missing: self.source(*missing) }
            }
            Step::Fold(fold) => Instruction::Fold(Box::new(self.fold(fold, layouts))),
            Step::Label(_) | Step::Top(_) => return None,
        })
    }
}

/// A program being run.
struct Run<'a> {
    program: &'a Program,
    cancel: &'a AtomicBool,
    table: &'a Words,
    frame: &'a mut Frame,
}

impl Run<'_> {
    fn call(&mut self, index: usize) {
        #[cfg(target_arch = "x86_64")]
        #[expect(unsafe_code, reason = "functions with more instructions than the build assumes")]
        match self.program.instructions {
            // SAFETY: this CPU has the instructions, as `available` found.
            Instructions::Avx512 => return unsafe { self.steps_with_avx512(index) },
            // SAFETY: as above.
            Instructions::Avx2 => return unsafe { self.steps_with_avx2(index) },
            Instructions::OfTheBuild => {}
        }
        self.steps::<{ cfg!(target_arch = "aarch64") }>(index);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,fma")]
    fn steps_with_avx512(&mut self, index: usize) {
        self.steps::<true>(index);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn steps_with_avx2(&mut self, index: usize) {
        self.steps::<true>(index);
    }

    #[inline(always)]
    fn steps<const HAS_FMA: bool>(&mut self, index: usize) {
        let function = self.program.functions[index].as_ref().expect("functions that are called have results");
        let mut next = 0;
        while let Some(instruction) = function.operations.get(next) {
            next += 1;
            match instruction {
                Instruction::Compute { to, operation, operands } => self.compute::<HAS_FMA>(*to, *operation, *operands),
                Instruction::Move { to, from } => self.copy(*to, *from),
                Instruction::MoveWhere { mask, to, from } => {
                    let operands = [*mask, *from, Operand::Slot(*to)];
                    self.compute::<HAS_FMA>(*to, Operation::Select, operands);
                }
                Instruction::SkipIfNone { mask, end } => {
                    if !self.has_lane(*mask) {
                        next = *end;
                    }
                }
                Instruction::Count { counter, limit } => self.frame.counters[*counter] = *limit,
                Instruction::CountLanes { counter, mask } => self.frame.counters[*counter] = self.lane_count(*mask),
                Instruction::RepeatWhileAny { mask, counter, top, pauses } => {
                    let are_few = *pauses && self.lane_count(*mask) * PAUSE < self.frame.counters[*counter + 1];
                    let left = &mut self.frame.counters[*counter];
                    *left -= 1;
                    if *left > 0 && !are_few && self.has_lane(*mask) && !self.cancel.load(Ordering::Relaxed) {
                        next = *top;
                    }
                }
                Instruction::Call { callee, moves, results } => {
                    for &(to, from) in moves {
                        self.copy(to, from);
                    }
                    self.call(*callee);
                    for &(to, from) in results {
                        self.copy(to, Operand::Slot(from));
                    }
                }
                Instruction::Make { live, to, missing } => self.make(*live, *to, *missing),
                Instruction::Fold(fold) => self.fold(fold),
            }
        }
        for &(from, to) in &function.results {
            self.copy(to, from);
        }
    }

    #[inline(always)]
    fn copy(&mut self, to: usize, from: Operand) {
        match from {
            Operand::Slot(from) => {
                let Frame { slots, spare, .. } = &mut *self.frame;
                spare.0.copy_from_slice(&slots[from].0);
                std::mem::swap(&mut slots[to], spare);
            }
            Operand::Input(index) => self.frame.slots[to].0.fill(self.frame.inputs[index]),
        }
    }

    #[inline(always)]
    fn compute<const HAS_FMA: bool>(&mut self, to: usize, operation: Operation, [a, b, c]: [Operand; 3]) {
        use Operand::{Input, Slot};
        let Frame { slots, spare, inputs, .. } = &mut *self.frame;
        let a = match a {
            Slot(a) => a,
            // Rarely more than a quotient or a difference.
            Input(a) => {
                slots[SCRATCH].0.fill(inputs[a]);
                SCRATCH
            }
        };
        let a = &*slots[a];
        if operation == Operation::Word {
            match b {
                Slot(last) => gather(spare, self.table, a, &*slots[last]),
                Input(last) => gather(spare, self.table, a, Splat(inputs[last])),
            }
            std::mem::swap(&mut slots[to], spare);
            return;
        }
        match (b, c) {
            (Slot(b), Slot(c)) => apply::<HAS_FMA>(operation, spare, a, &*slots[b], &*slots[c]),
            (Input(b), Slot(c)) => apply::<HAS_FMA>(operation, spare, a, Splat(inputs[b]), &*slots[c]),
            (Slot(b), Input(c)) => apply::<HAS_FMA>(operation, spare, a, &*slots[b], Splat(inputs[c])),
            (Input(b), Input(c)) => apply::<HAS_FMA>(operation, spare, a, Splat(inputs[b]), Splat(inputs[c])),
        }
        std::mem::swap(&mut slots[to], spare);
    }
}
