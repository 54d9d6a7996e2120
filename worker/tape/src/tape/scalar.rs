//! Evaluates a valid tape as it is written, one lane at a time, for tests: the meaning that all back ends must share.
//!
//! NaN is computed by no formula of a picture, and the sign of a zero is not defined. A value that depends on either is
//! *vague*: back ends may differ in it.

use math::real::list::{IS_LAST, IS_UNARY, NO_LEAF, OPERATION_WORDS, ROW_MASK, function_of};
use math::real::{Real, SQRT_FLOOR, Words};

use super::{Fold, Operation, Statement, Tape, ValueId, ValueType};

/// Bits of a value (0 or 1 for a condition), and whether back ends may differ in it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Word {
    pub(crate) bits: u32,
    pub(crate) is_vague: bool,
}

/// Results of an entry.
pub(crate) fn evaluate(tape: &Tape, entry: &str, arguments: &[f32]) -> Vec<Word> {
    let index = tape.functions.iter().position(|function| function.name == entry).expect("an entry of the tape");
    let arguments: Vec<Word> =
        arguments.iter().map(|number| Word { bits: number.to_bits(), is_vague: false }).collect();
    Run { tape, values: vec![Word::default(); tape.instructions.len()], row: 0 }.call(index, &arguments)
}

struct Run<'a> {
    tape: &'a Tape,
    values: Vec<Word>,
    /// First word of the current row.
    row: u32,
}

impl Run<'_> {
    fn call(&mut self, index: usize, arguments: &[Word]) -> Vec<Word> {
        let function = &self.tape.functions[index];
        self.assign(&function.arguments, arguments);
        self.block(&function.body);
        self.read(&function.results)
    }

    fn table(&self) -> &Words {
        self.tape.table().expect("a tape with words has a table")
    }

    /// A list that names no function, or takes a value where none waits, has a vague value.
    fn fold(&mut self, fold: &Fold) -> Vec<Word> {
        let last = self.table().capacity() as u32 - 1;
        let row_words = fold.functions().filter_map(|index| self.tape.functions[index].row_words).max().unwrap_or(0);
        let (list, point) = (self.value(fold.list), self.read(&fold.arguments));
        let vague = vec![Word { bits: 0, is_vague: true }; fold.returned.len()];
        let (mut at, mut waiting): (u32, Vec<Vec<Word>>) = (list.bits, Vec::new());
        loop {
            at = at.min(last - 1);
            let (leaf, join) = (self.table().get(at), self.table().get(at + 1));
            let mut with_row = |functions: &[usize], index: usize, word: u32, arguments: &[Word]| {
                let function = functions.get(index)?;
                self.row = (word & ROW_MASK).min(last - row_words);
                Some(self.call(*function, arguments))
            };
            let value = match function_of(leaf) {
                NO_LEAF => waiting.pop(),
                function => with_row(&fold.leaves, function as usize, leaf, &point),
            };
            let Some(mut value) = value else { return vague };
            if let Some(function) = function_of(join).checked_sub(1) {
                let below = if join & IS_UNARY == 0 { waiting.pop() } else { Some(value.clone()) };
                let Some(below) = below else { return vague };
                let both: Vec<Word> = below.into_iter().chain(value).collect();
                let Some(joined) = with_row(&fold.joins, function as usize, join, &both) else { return vague };
                value = joined;
            }
            waiting.push(value);
            at += OPERATION_WORDS;
            if waiting.len() > fold.depth as usize {
                return vague;
            }
            if leaf & IS_LAST != 0 || at >= last {
                return if list.is_vague { vague } else { waiting.pop().unwrap_or(vague) };
            }
        }
    }

    fn value(&self, id: ValueId) -> Word {
        match self.tape.definition(id).operation {
            Operation::Constant(bits) => Word { bits, is_vague: false },
            Operation::Uniform(place) => Word { bits: self.tape.uniforms[place as usize], is_vague: false },
            Operation::Row(place) => Word { bits: self.table().get(self.row + place), is_vague: false },
            _ => self.values[id.0 as usize],
        }
    }

    fn read(&self, ids: &[ValueId]) -> Vec<Word> {
        ids.iter().map(|&id| self.value(id)).collect()
    }

    fn assign(&mut self, ids: &[ValueId], words: &[Word]) {
        for (id, word) in ids.iter().zip(words) {
            self.values[id.0 as usize] = *word;
        }
    }

    fn block(&mut self, block: &[Statement]) {
        for statement in block {
            match statement {
                Statement::Comment(_) => {}
                Statement::Emit(id) => self.values[id.0 as usize] = self.operation(*id),
                Statement::Call { function, arguments, returned } => {
                    let results = self.call(*function, &self.read(arguments));
                    self.assign(returned, &results);
                }
                Statement::Fold(fold) => {
                    let results = self.fold(fold);
                    self.assign(&fold.returned, &results);
                }
                Statement::When { condition, variables, otherwise, body, value } => {
                    let condition = self.value(*condition);
                    let mut words = self.read(otherwise);
                    if condition.bits != 0 {
                        self.block(body);
                        words = self.read(value);
                    }
                    for word in &mut words {
                        word.is_vague |= condition.is_vague;
                    }
                    self.assign(variables, &words);
                }
                Statement::Repeat { limit, pauses: _, variables, start, body, next, again } => {
                    self.assign(variables, &self.read(start));
                    for _ in 0..*limit {
                        self.block(body);
                        let again = self.value(*again);
                        let mut words = self.read(next);
                        for word in &mut words {
                            word.is_vague |= again.is_vague;
                        }
                        self.assign(variables, &words);
                        if again.bits == 0 || again.is_vague {
                            break;
                        }
                    }
                }
            }
        }
    }

    fn operation(&self, id: ValueId) -> Word {
        let definition = self.tape.definition(id);
        let words = definition.operands.map(|operand| operand.map(|id| self.value(id)).unwrap_or_default());
        let [a, b, c] = words.map(|word| word.bits);
        let [x, y, z] = [a, b, c].map(f32::from_bits);
        let bits = match definition.operation {
            Operation::Add => (x + y).to_bits(),
            Operation::Sub => (x - y).to_bits(),
            Operation::Mul => (x * y).to_bits(),
            Operation::Div => (x / y).to_bits(),
            Operation::Fma => Real::mul_add(x, y, z).to_bits(),
            Operation::Min => (if y < x { y } else { x }).to_bits(),
            Operation::Max => (if x < y { y } else { x }).to_bits(),
            Operation::Neg => (-x).to_bits(),
            Operation::Abs => x.abs().to_bits(),
            Operation::Floor => x.floor().to_bits(),
            Operation::Sqrt => (if x < SQRT_FLOOR { 0.0 } else { x.sqrt() }).to_bits(),
            Operation::Less => u32::from(x < y),
            Operation::Select => {
                if a != 0 {
                    b
                } else {
                    c
                }
            }
            Operation::And | Operation::AndU32 => a & b,
            Operation::Or | Operation::OrU32 => a | b,
            Operation::Not => 1 - a,
            Operation::Xor => a ^ b,
            Operation::ToBits | Operation::FromBits => a,
            Operation::AddU32 => a.wrapping_add(b),
            Operation::MulU32 => a.wrapping_mul(b),
            Operation::ShiftLeft => a << b,
            Operation::ShiftRight => a >> b,
            Operation::Word => self.table().get(a.min(b)),
            Operation::Made => self.table().make(a),
            Operation::Constant(_)
            | Operation::Uniform(_)
            | Operation::Row(_)
            | Operation::Argument
            | Operation::CallResult
            | Operation::Variable => panic!("no statement computes it"),
        };
        let is_nan = definition.kind == ValueType::F32 && f32::from_bits(bits).is_nan();
        let shows_sign = match definition.operation {
            Operation::ToBits => x == 0.0,
            Operation::Div => y == 0.0,
            _ => false,
        };
        Word { bits, is_vague: is_nan || shows_sign || words.iter().any(|word| word.is_vague) }
    }
}
