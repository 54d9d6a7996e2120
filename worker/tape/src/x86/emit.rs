//! Machine code of a function: its frame and its steps.
//!
//! Registers: `rdi` the thread's frame, `rsi` the uniforms, `rdx` the constants, `rcx` the cancel flag. Entries also have
//! `r8` the arguments, `r9` the results, `r10` the bytes of a row, `r11` the packets that remain. The last two vector
//! registers, k0, k7 and `rax` are scratch. Folds of lists use the registers that are named there. Nothing else is used,
//! and memory is reached through these only.

use std::collections::HashMap;

use iced_x86::{Code, Instruction, MemoryOperand, Register};

use super::isa::Isa;
use super::operands::{MASK_SCRATCH, MASK_SCRATCH_2};
use crate::interrupt;
use crate::tape::{Allocation, Linear, ListFunctionLayout, Location, PAUSE, Step, Var};

pub(super) const FRAME: Register = Register::RDI;
pub(super) const UNIFORMS: Register = Register::RSI;
pub(super) const CONSTANTS: Register = Register::RDX;
pub(super) const CANCEL: Register = Register::RCX;
pub(super) const ARGUMENTS: Register = Register::R8;
pub(super) const RESULTS: Register = Register::R9;
pub(super) const ROW_BYTES: Register = Register::R10;
pub(super) const PACKETS: Register = Register::R11;
/// The address of a row of arguments or results, or of the table.
pub(super) const ROW: Register = Register::RAX;
/// Registers of folds, which an entry gives back as they were: an index in the table, a word, the address of the current
/// row of numbers, that of the values that wait, the table's, and a function's number.
pub(super) const AT: Register = Register::RBX;
pub(super) const WORD: Register = Register::RBP;
pub(super) const NUMBERS: Register = Register::R12;
pub(super) const WAITING: Register = Register::R13;
pub(super) const TABLE: Register = Register::R14;
pub(super) const FUNCTION: Register = Register::R15;
pub(super) const SAVED: [Register; 6] = [AT, WORD, NUMBERS, WAITING, TABLE, FUNCTION];
pub(super) const STACK: Register = Register::RSP;
/// Round to nearest, keep subnormal numbers, report nothing.
const MXCSR: u32 = 0x1f80;
/// Its bits that are no flags of past operations.
const MXCSR_MODE: u32 = 0xffc0;

/// Parts of a function in the frame, as offsets in bytes.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FrameLayout {
    /// Mask of the active lanes.
    pub(super) live: u32,
    pub(super) arguments: u32,
    pub(super) results: u32,
    pub(super) slots: u32,
    /// Memory of the function's folds, and of the words that it has made.
    pub(super) folds: u32,
    /// Words of the function's row, as vectors, for an extension that can't take them from the row itself.
    pub(super) row: u32,
    /// Counters of loops, then the rounding mode of an entry's caller, then its registers.
    counters: u32,
    /// End of all parts.
    pub(super) end: u32,
    /// Places of a function of lists.
    pub(super) list_function: Option<ListFunctionLayout>,
}

impl FrameLayout {
    pub(super) fn new(
        start: u32,
        list_function: Option<ListFunctionLayout>,
        linear: &Linear,
        slots: u32,
        packet_bytes: u32,
    ) -> Self {
        let arguments = linear.arguments.len() as u32;
        let own = 1 + arguments + linear.results.len() as u32;
        let places = list_function.unwrap_or(ListFunctionLayout { arguments: 1, results: 1 + arguments, own });
        let [arguments, results, own] =
            [places.arguments, places.results, places.own].map(|packets| start + packet_bytes * packets);
        let folds = own + packet_bytes * slots;
        let of_fold = |step: &Step| match step {
            Step::Fold(fold) => fold.packets(),
            Step::Make { .. } => 2,
            _ => 0,
        };
        let row = folds + packet_bytes * linear.steps.iter().map(of_fold).max().unwrap_or(0);
        let counters = row + packet_bytes * linear.row_words();
        let end = (counters + 4 * (linear.counters as u32 + 1)).next_multiple_of(8) + 8 * SAVED.len() as u32;
        let end = end.next_multiple_of(packet_bytes);
        Self { live: start, arguments, results, slots: own, folds, row, counters, end, list_function }
    }
}

/// Constants of a program, each once.
#[derive(Debug, Default)]
pub(super) struct ConstantPool {
    pub(super) words: Vec<u32>,
    places: HashMap<u32, u32>,
}

impl ConstantPool {
    pub(super) fn place(&mut self, bits: u32) -> u32 {
        *self.places.entry(bits).or_insert_with(|| {
            self.words.push(bits);
            self.words.len() as u32 - 1
        })
    }
}

/// Machine code of all functions, with branch targets as numbers of instructions, from 1.
#[derive(Debug, Default)]
pub(super) struct Assembly {
    pub(super) instructions: Vec<Instruction>,
    /// First instruction of each function.
    pub(super) functions: Vec<Option<usize>>,
    pub(super) constants: ConstantPool,
    /// Number of the tape's uniforms.
    pub(super) uniforms: usize,
    /// Whether it reads words of a table.
    pub(super) has_table: bool,
}

impl Assembly {
    pub(super) fn next(&self) -> u64 {
        self.instructions.len() as u64 + 1
    }
}

/// Emits one function.
pub(super) struct Emitter<'a> {
    pub(super) assembly: &'a mut Assembly,
    pub(super) isa: &'static Isa,
    pub(super) linear: &'a Linear,
    pub(super) allocation: &'a Allocation,
    pub(super) layouts: &'a [FrameLayout],
    index: usize,
    /// The vector of the packet for which code is emitted.
    pub(super) vector: u32,
    labels: Vec<u64>,
    /// Branches to labels that come later: instruction and label.
    open: Vec<(usize, usize)>,
}

pub(super) fn memory(base: Register, offset: u32) -> MemoryOperand {
    MemoryOperand::with_base_displ(base, i64::from(offset))
}

/// Creation fails only for an operation that has another number of operands, which the tests of all operations show.
pub(super) fn valid(instruction: Result<Instruction, iced_x86::IcedError>) -> Instruction {
    instruction.expect("the code takes these operands")
}

impl<'a> Emitter<'a> {
    pub(super) fn new(
        assembly: &'a mut Assembly,
        isa: &'static Isa,
        linear: &'a Linear,
        allocation: &'a Allocation,
        layouts: &'a [FrameLayout],
        index: usize,
    ) -> Self {
        let labels = vec![0; linear.labels];
        Self { assembly, isa, linear, allocation, layouts, index, vector: 0, labels, open: Vec::new() }
    }

    /// Emits the function. An entry saves, sets and restores the rounding mode, and goes from packet to packet.
    pub(super) fn function(mut self, is_entry: bool) {
        self.assembly.functions[self.index] = Some(self.assembly.instructions.len());
        if is_entry {
            self.entry();
        } else {
            self.take_inputs();
            self.steps();
            for (place, &var) in self.linear.results.iter().enumerate() {
                self.store_to(var, self.layout().results + self.isa.packet_bytes() * place as u32);
            }
        }
        self.push(Instruction::with(Code::Retnq));
        for (instruction, label) in std::mem::take(&mut self.open) {
            self.assembly.instructions[instruction].set_near_branch64(self.labels[label]);
        }
    }

    /// Loads what a caller left in the frame.
    fn take_inputs(&mut self) {
        if !self.isa.has_masks() {
            // No operand of this extension is one number for all lanes.
            for word in 0..self.linear.row_words() {
                let (from, scratch) = (memory(NUMBERS, 4 * word), self.isa.scratch);
                self.push(valid(Instruction::with2(Code::VEX_Vbroadcastss_ymm_m32, scratch, from)));
                let to = memory(FRAME, self.layout().row + self.isa.packet_bytes() * word);
                self.push(valid(Instruction::with2(self.isa.store, to, scratch)));
            }
        }
        // In the order in which they were given registers: one that nothing reads may have that of a later one.
        self.load_from(self.linear.live, self.layout().live);
        for (place, &var) in self.linear.arguments.iter().enumerate() {
            if !matches!(self.place(var), Location::Argument(_)) {
                self.load_from(var, self.layout().arguments + self.isa.packet_bytes() * place as u32);
            }
        }
    }

    fn steps(&mut self) {
        for step in &self.linear.steps {
            interrupt::check();
            self.step(step);
        }
    }

    fn entry(&mut self) {
        let saved_mode = memory(FRAME, self.layout().counters + 4 * self.linear.counters as u32);
        self.push(valid(Instruction::with1(Code::VEX_Vstmxcsr_m32, saved_mode)));
        if self.assembly.has_table {
            for (place, register) in SAVED.into_iter().enumerate() {
                let to = self.saved(place as u32);
                self.push(valid(Instruction::with2(Code::Mov_rm64_r64, to, register)));
            }
        }
        let place = self.assembly.constants.place(MXCSR);
        self.set_mode_unless_usual(saved_mode, self.constant_at(place, false));
        // Above the return address.
        for (register, offset) in [(ROW_BYTES, 8), (PACKETS, 16)] {
            let from = memory(STACK, offset);
            self.push(valid(Instruction::with2(Code::Mov_r64_rm64, register, from)));
        }
        let top = self.assembly.next();
        self.for_each_vector(|this| {
            let all = this.target(this.linear.live);
            let code =
                if this.isa.has_masks() { Code::VEX_Kxnorw_kr_kr_kr } else { Code::VEX_Vpcmpeqd_ymm_ymm_ymmm256 };
            this.push(valid(Instruction::with3(code, all, all, all)));
            this.store(this.linear.live, all);
        });
        let linear = self.linear;
        self.for_each_row(ARGUMENTS, &linear.arguments, |this, var, row| {
            let to = this.target(var);
            this.push(valid(Instruction::with2(this.isa.load_unaligned, to, row)));
            this.store(var, to);
        });
        self.steps();
        self.for_each_row(RESULTS, &linear.results, |this, var, row| {
            let operand = this.operand(var);
            let from = this.in_register(operand, this.isa.scratch);
            this.push(valid(Instruction::with2(this.isa.store_unaligned, row, from)));
        });
        for rows in [ARGUMENTS, RESULTS] {
            self.push(valid(Instruction::with2(Code::Add_rm64_imm32, rows, self.isa.packet_bytes())));
        }
        self.push(valid(Instruction::with1(Code::Dec_rm64, PACKETS)));
        self.push(valid(Instruction::with_branch(Code::Jne_rel32_64, top)));
        self.set_mode_unless_usual(saved_mode, saved_mode);
        if self.assembly.has_table {
            for (place, register) in SAVED.into_iter().enumerate() {
                let from = self.saved(place as u32);
                self.push(valid(Instruction::with2(Code::Mov_r64_rm64, register, from)));
            }
        }
        self.push(Instruction::with(Code::VEX_Vzeroupper));
    }

    /// Emits code for each variable and the packet's part of its row.
    fn for_each_row(&mut self, first: Register, rows: &[Var], emit: impl Fn(&mut Self, Var, MemoryOperand)) {
        self.push(valid(Instruction::with2(Code::Mov_r64_rm64, ROW, first)));
        for (place, &var) in rows.iter().enumerate() {
            if place > 0 {
                self.push(valid(Instruction::with2(Code::Add_r64_rm64, ROW, ROW_BYTES)));
            }
            self.for_each_vector(|this| emit(this, var, this.in_packet(ROW, 0)));
        }
    }

    pub(super) fn for_each_vector(&mut self, mut emit: impl FnMut(&mut Self)) {
        for vector in 0..self.isa.vectors {
            self.vector = vector;
            emit(self);
        }
    }

    /// The vector's part of a packet's values at an offset.
    pub(super) fn in_packet(&self, base: Register, offset: u32) -> MemoryOperand {
        memory(base, offset + self.isa.vector_bytes() * self.vector)
    }

    /// Sets the rounding mode, which is slow, if the caller's is not the usual one.
    fn set_mode_unless_usual(&mut self, callers: MemoryOperand, mode: MemoryOperand) {
        self.push(valid(Instruction::with2(Code::Mov_r32_rm32, Register::EAX, callers)));
        self.push(valid(Instruction::with2(Code::And_rm32_imm32, Register::EAX, MXCSR_MODE)));
        self.push(valid(Instruction::with2(Code::Cmp_rm32_imm32, Register::EAX, MXCSR)));
        let branch = self.assembly.instructions.len();
        self.push(valid(Instruction::with_branch(Code::Je_rel32_64, 0)));
        self.push(valid(Instruction::with1(Code::VEX_Vldmxcsr_m32, mode)));
        let after = self.assembly.next();
        self.assembly.instructions[branch].set_near_branch64(after);
    }

    pub(super) fn push(&mut self, instruction: Instruction) {
        self.assembly.instructions.push(instruction);
    }

    pub(super) fn layout(&self) -> FrameLayout {
        self.layouts[self.index]
    }

    fn branch(&mut self, code: Code, label: usize) {
        self.open.push((self.assembly.instructions.len(), label));
        self.push(valid(Instruction::with_branch(code, 0)));
    }

    /// Sets the zero flag if no lane is in the mask.
    fn test_mask(&mut self, mask: Var) {
        if self.isa.has_masks() {
            self.vector = 0;
            let first = self.mask_in_register(mask, MASK_SCRATCH);
            self.vector = self.isa.vectors - 1;
            let last = self.mask_in_register(mask, MASK_SCRATCH_2);
            self.push(valid(Instruction::with2(Code::VEX_Kortestw_kr_kr, first, last)));
        } else {
            let operand = self.operand(mask);
            let mask = self.in_register(operand, self.isa.scratch);
            self.push(valid(Instruction::with2(Code::VEX_Vtestps_ymm_ymmm256, mask, mask)));
        }
    }

    /// Sets `eax` to the number of lanes in a mask. `counter` is memory for that.
    fn count_lanes(&mut self, mask: Var, counter: usize) {
        if self.isa.has_masks() {
            let memory = self.counter(counter);
            for vector in 0..self.isa.vectors {
                self.vector = vector;
                let part = self.mask_in_register(mask, MASK_SCRATCH);
                self.push(valid(Instruction::with2(Code::VEX_Kmovw_r32_kr, Register::EAX, part)));
                self.push(valid(Instruction::with2(Code::Popcnt_r32_rm32, Register::EAX, Register::EAX)));
                if vector > 0 {
                    self.push(valid(Instruction::with2(Code::Add_r32_rm32, Register::EAX, memory)));
                }
                if vector + 1 < self.isa.vectors {
                    self.push(valid(Instruction::with2(Code::Mov_rm32_r32, memory, Register::EAX)));
                }
            }
        } else {
            let operand = self.operand(mask);
            let mask = self.in_register(operand, self.isa.scratch);
            self.push(valid(Instruction::with2(Code::VEX_Vmovmskps_r32_ymm, Register::EAX, mask)));
            self.push(valid(Instruction::with2(Code::Popcnt_r32_rm32, Register::EAX, Register::EAX)));
        }
    }

    /// Place of a register of an entry's caller.
    fn saved(&self, place: u32) -> MemoryOperand {
        let first = (self.layout().counters + 4 * (self.linear.counters as u32 + 1)).next_multiple_of(8);
        memory(FRAME, first + 8 * place)
    }

    fn counter(&self, counter: usize) -> MemoryOperand {
        memory(FRAME, self.layout().counters + 4 * counter as u32)
    }

    fn step(&mut self, step: &Step) {
        match step {
            Step::Compute { to, operation, operands } => {
                self.for_each_vector(|this| this.compute(*to, *operation, *operands));
            }
            Step::Move { to, from } => self.for_each_vector(|this| this.copy(*to, *from)),
            Step::MoveWhere { mask, to, from } => self.for_each_vector(|this| this.copy_where(*mask, *to, *from)),
            Step::SkipIfNone { mask, end } => {
                self.test_mask(*mask);
                self.branch(Code::Je_rel32_64, *end);
            }
            Step::Label(label) | Step::Top(label) => self.labels[*label] = self.assembly.next(),
            Step::Count { counter, limit } => {
                let at = self.counter(*counter);
                self.push(valid(Instruction::with2(Code::Mov_rm32_imm32, at, *limit)));
            }
            Step::CountLanes { counter, mask } => {
                self.count_lanes(*mask, *counter + 1);
                let at = self.counter(*counter);
                self.push(valid(Instruction::with2(Code::Mov_rm32_r32, at, Register::EAX)));
            }
            Step::RepeatWhileAny { mask, counter, top, pauses } => {
                self.repeat_while_any(*mask, *counter, *top, *pauses);
            }
            Step::Call { callee, live, arguments, results } => self.call(*callee, *live, arguments, results),
            Step::Make { live, to, missing } => self.make(*live, *to, *missing),
            Step::Fold(fold) => self.fold(fold),
        }
    }

    /// A loop also ends when the render is cancelled; then nothing reads its results.
    fn repeat_while_any(&mut self, mask: Var, counter: usize, top: usize, pauses: bool) {
        let mut leaving = Vec::new();
        self.test_mask(mask);
        leaving.push(self.assembly.instructions.len());
        self.push(valid(Instruction::with_branch(Code::Je_rel32_64, 0)));
        if pauses {
            self.count_lanes(mask, counter + 2);
            self.push(valid(Instruction::with2(Code::Shl_rm32_imm8, Register::EAX, PAUSE.trailing_zeros())));
            let began = self.counter(counter + 1);
            self.push(valid(Instruction::with2(Code::Cmp_r32_rm32, Register::EAX, began)));
            leaving.push(self.assembly.instructions.len());
            self.push(valid(Instruction::with_branch(Code::Jb_rel32_64, 0)));
        }
        self.push(valid(Instruction::with2(Code::Cmp_rm8_imm8, memory(CANCEL, 0), 0_u32)));
        leaving.push(self.assembly.instructions.len());
        self.push(valid(Instruction::with_branch(Code::Jne_rel32_64, 0)));
        let at = self.counter(counter);
        self.push(valid(Instruction::with1(Code::Dec_rm32, at)));
        self.branch(Code::Jne_rel32_64, top);
        let after = self.assembly.next();
        for branch in leaving {
            self.assembly.instructions[branch].set_near_branch64(after);
        }
    }

    fn call(&mut self, callee: usize, live: Var, arguments: &[Var], results: &[Var]) {
        let (layout, bytes) = (self.layouts[callee], self.isa.packet_bytes());
        for (place, &var) in arguments.iter().enumerate() {
            self.store_to(var, layout.arguments + bytes * place as u32);
        }
        self.store_to(live, layout.live);
        let target = self.assembly.functions[callee].expect("callees come first");
        self.push(valid(Instruction::with_branch(Code::Call_rel32_64, target as u64 + 1)));
        for (place, &var) in results.iter().enumerate() {
            self.load_from(var, layout.results + bytes * place as u32);
        }
    }
}
