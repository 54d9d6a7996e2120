//! Machine code of a function: its frame, its steps, and the moves between registers and memory.
//!
//! Registers: `rdi` the thread's frame, `rsi` the uniforms, `rdx` the constants, `rcx` the cancel flag. The last two
//! vector registers, k0, k6, k7 and `eax` are scratch. Nothing else is used, and memory is reached through these four only.

use std::collections::HashMap;

use iced_x86::{Code, Instruction, MemoryOperand, Register};

use super::isa::Isa;
use crate::tape::{Allocation, Class, Linear, Place, Step, Var};

pub(super) const FRAME: Register = Register::RDI;
pub(super) const UNIFORMS: Register = Register::RSI;
pub(super) const CONSTANTS: Register = Register::RDX;
pub(super) const CANCEL: Register = Register::RCX;
pub(super) const MASK_SCRATCH: Register = Register::K6;
pub(super) const MASK_SCRATCH_2: Register = Register::K7;
const MASK_SCRATCH_3: Register = Register::K0;
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
    slots: u32,
    /// Counters of loops, then the caller's rounding mode.
    counters: u32,
    /// End of all parts.
    pub(super) end: u32,
}

impl FrameLayout {
    pub(super) fn new(start: u32, linear: &Linear, slots: u32, vector_bytes: u32) -> Self {
        let arguments = start + vector_bytes;
        let results = arguments + vector_bytes * linear.arguments.len() as u32;
        let first_slot = results + vector_bytes * linear.results.len() as u32;
        let counters = first_slot + vector_bytes * slots;
        let end = (counters + 4 * (linear.counters as u32 + 1)).next_multiple_of(vector_bytes);
        Self { live: start, arguments, results, slots: first_slot, counters, end }
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
}

impl Assembly {
    fn next(&self) -> u64 {
        self.instructions.len() as u64 + 1
    }
}

/// Operand of an instruction.
#[derive(Clone, Copy)]
pub(super) enum Operand {
    Register(Register),
    /// A vector, or one number for all lanes.
    Memory(MemoryOperand),
}

/// Emits one function.
pub(super) struct Emitter<'a> {
    pub(super) assembly: &'a mut Assembly,
    pub(super) isa: &'static Isa,
    linear: &'a Linear,
    allocation: &'a Allocation,
    layouts: &'a [FrameLayout],
    index: usize,
    labels: Vec<u64>,
    /// Branches to labels that come later: instruction and label.
    open: Vec<(usize, usize)>,
}

fn memory(base: Register, offset: u32) -> MemoryOperand {
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
        Self { assembly, isa, linear, allocation, layouts, index, labels: vec![0; linear.labels], open: Vec::new() }
    }

    /// Emits the function; an entry also saves, sets and restores the rounding mode.
    pub(super) fn function(mut self, is_entry: bool) {
        self.assembly.functions[self.index] = Some(self.assembly.instructions.len());
        let saved_mode = memory(FRAME, self.layout().counters + 4 * self.linear.counters as u32);
        if is_entry {
            self.push(valid(Instruction::with1(Code::VEX_Vstmxcsr_m32, saved_mode)));
            let place = self.assembly.constants.place(MXCSR);
            self.set_mode_unless_usual(saved_mode, self.constant_at(place, false));
        }
        // In the order in which they were given registers: one that nothing reads may have that of a later one.
        let mut inputs = vec![(self.linear.live, memory(FRAME, self.layout().live))];
        let arguments = self.linear.arguments.iter().enumerate();
        inputs.extend(arguments.map(|(place, &var)| (var, self.argument(place as u32))));
        for (var, from) in inputs {
            match self.place(var) {
                Place::Vector(register) => self.load(self.isa.vector(register), Operand::Memory(from)),
                Place::Mask(register) => self.load_mask(Register::K0 + u32::from(register), from),
                _ => {}
            }
        }
        for step in &self.linear.steps {
            self.step(step);
        }
        for (place, &var) in self.linear.results.iter().enumerate() {
            let to = memory(FRAME, self.layout().results + self.isa.vector_bytes() * place as u32);
            self.store_to(var, to);
        }
        if is_entry {
            self.set_mode_unless_usual(saved_mode, saved_mode);
            self.push(Instruction::with(Code::VEX_Vzeroupper));
        }
        self.push(Instruction::with(Code::Retnq));
        for (instruction, label) in std::mem::take(&mut self.open) {
            self.assembly.instructions[instruction].set_near_branch64(self.labels[label]);
        }
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

    fn layout(&self) -> FrameLayout {
        self.layouts[self.index]
    }

    fn argument(&self, place: u32) -> MemoryOperand {
        memory(FRAME, self.layout().arguments + self.isa.vector_bytes() * place)
    }

    pub(super) fn place(&self, var: Var) -> Place {
        self.allocation.places[var as usize]
    }

    /// Whether the variable is in a mask register, or would be if there were enough.
    pub(super) fn is_mask(&self, var: Var) -> bool {
        self.isa.has_masks() && self.linear.variables[var as usize].class == Class::Mask
    }

    fn in_frame(&self, place: Place) -> Option<MemoryOperand> {
        match place {
            Place::Slot(slot) => Some(memory(FRAME, self.layout().slots + self.isa.vector_bytes() * slot)),
            Place::Argument(argument) => Some(self.argument(argument)),
            Place::Live => Some(memory(FRAME, self.layout().live)),
            _ => None,
        }
    }

    /// Constants and uniforms have one word each for AVX-512, which broadcasts it, and a vector for AVX2.
    fn input(&self, base: Register, place: u32, broadcasts: bool) -> MemoryOperand {
        let stride = if self.isa.has_masks() { 4 } else { self.isa.vector_bytes() };
        let mut at = memory(base, stride * place);
        at.is_broadcast = broadcasts && self.isa.has_masks();
        at
    }

    fn constant_at(&self, place: u32, broadcasts: bool) -> MemoryOperand {
        self.input(CONSTANTS, place, broadcasts)
    }

    pub(super) fn constant(&mut self, bits: u32) -> Operand {
        let place = self.assembly.constants.place(bits);
        Operand::Memory(self.constant_at(place, true))
    }

    pub(super) fn operand(&mut self, var: Var) -> Operand {
        match self.place(var) {
            Place::Vector(register) => Operand::Register(self.isa.vector(register)),
            Place::Constant(bits) => self.constant(bits),
            Place::Uniform(index) => Operand::Memory(self.input(UNIFORMS, index, true)),
            place => Operand::Memory(self.in_frame(place).expect("a number is a vector or in the frame")),
        }
    }

    /// Loads an operand into a register.
    pub(super) fn load(&mut self, to: Register, from: Operand) {
        let instruction = self.loading(to, from);
        if !matches!(from, Operand::Register(from) if from == to) {
            self.push(instruction);
        }
    }

    fn loading(&self, to: Register, from: Operand) -> Instruction {
        valid(match from {
            Operand::Register(from) => Instruction::with2(self.isa.load, to, from),
            Operand::Memory(mut from) if from.is_broadcast => {
                from.is_broadcast = false;
                Instruction::with2(Code::EVEX_Vbroadcastss_zmm_k1z_xmmm32, to, from)
            }
            Operand::Memory(from) => Instruction::with2(self.isa.load, to, from),
        })
    }

    fn load_mask(&mut self, to: Register, from: MemoryOperand) {
        self.push(valid(Instruction::with2(Code::VEX_Kmovw_kr_km16, to, from)));
    }

    /// Register that has the operand's value.
    pub(super) fn in_register(&mut self, operand: Operand, scratch: Register) -> Register {
        match operand {
            Operand::Register(register) => register,
            Operand::Memory(_) => {
                self.load(scratch, operand);
                scratch
            }
        }
    }

    pub(super) fn mask_in_register(&mut self, var: Var, scratch: Register) -> Register {
        match self.place(var) {
            Place::Mask(register) => Register::K0 + u32::from(register),
            place => {
                let from = self.in_frame(place).expect("a mask is in a register or in the frame");
                self.load_mask(scratch, from);
                scratch
            }
        }
    }

    /// Register for a result: that of the variable, or scratch to be stored by [`Self::store`].
    pub(super) fn target(&self, var: Var) -> Register {
        match self.place(var) {
            Place::Vector(register) => self.isa.vector(register),
            Place::Mask(register) => Register::K0 + u32::from(register),
            _ if self.is_mask(var) => MASK_SCRATCH,
            _ => self.isa.scratch(),
        }
    }

    /// Stores a result from its register to its place, if that is in the frame.
    pub(super) fn store(&mut self, var: Var, from: Register) {
        if let Some(to) = self.in_frame(self.place(var)) {
            self.store_register(self.is_mask(var), to, from);
        }
    }

    fn store_register(&mut self, is_mask: bool, to: MemoryOperand, from: Register) {
        let code = if is_mask { Code::VEX_Kmovw_m16_kr } else { self.isa.store };
        self.push(valid(Instruction::with2(code, to, from)));
    }

    /// Stores a variable to another place in the frame.
    fn store_to(&mut self, var: Var, to: MemoryOperand) {
        let is_mask = self.is_mask(var);
        let from = if is_mask {
            self.mask_in_register(var, MASK_SCRATCH)
        } else {
            let operand = self.operand(var);
            self.in_register(operand, self.isa.scratch())
        };
        self.store_register(is_mask, to, from);
    }

    fn branch(&mut self, code: Code, label: usize) {
        self.open.push((self.assembly.instructions.len(), label));
        self.push(valid(Instruction::with_branch(code, 0)));
    }

    /// Sets the zero flag if no lane is in the mask.
    fn test_mask(&mut self, mask: Var) {
        let instruction = if self.isa.has_masks() {
            let mask = self.mask_in_register(mask, MASK_SCRATCH);
            Instruction::with2(Code::VEX_Kortestw_kr_kr, mask, mask)
        } else {
            let operand = self.operand(mask);
            let mask = self.in_register(operand, self.isa.scratch());
            Instruction::with2(Code::VEX_Vtestps_ymm_ymmm256, mask, mask)
        };
        self.push(valid(instruction));
    }

    fn counter(&self, counter: usize) -> MemoryOperand {
        memory(FRAME, self.layout().counters + 4 * counter as u32)
    }

    fn step(&mut self, step: &Step) {
        match step {
            Step::Compute { to, operation, operands } => self.compute(*to, *operation, *operands),
            Step::Move { to, from } => self.copy(*to, *from),
            Step::MoveWhere { mask, to, from } => self.copy_where(*mask, *to, *from),
            Step::SkipIfNone { mask, end } => {
                self.test_mask(*mask);
                self.branch(Code::Je_rel32_64, *end);
            }
            Step::Label(label) | Step::Top(label) => self.labels[*label] = self.assembly.next(),
            Step::Count { counter, limit } => {
                let at = self.counter(*counter);
                self.push(valid(Instruction::with2(Code::Mov_rm32_imm32, at, *limit)));
            }
            Step::RepeatWhileAny { mask, counter, top } => self.repeat_while_any(*mask, *counter, *top),
            Step::Call { callee, live, arguments, results } => self.call(*callee, *live, arguments, results),
        }
    }

    /// A loop also ends when the render is cancelled; then nothing reads its results.
    fn repeat_while_any(&mut self, mask: Var, counter: usize, top: usize) {
        let mut leaving = Vec::new();
        self.test_mask(mask);
        leaving.push(self.assembly.instructions.len());
        self.push(valid(Instruction::with_branch(Code::Je_rel32_64, 0)));
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
        let (layout, bytes) = (self.layouts[callee], self.isa.vector_bytes());
        for (place, &var) in arguments.iter().enumerate() {
            self.store_to(var, memory(FRAME, layout.arguments + bytes * place as u32));
        }
        self.store_to(live, memory(FRAME, layout.live));
        let target = self.assembly.functions[callee].expect("callees come first");
        self.push(valid(Instruction::with_branch(Code::Call_rel32_64, target as u64 + 1)));
        for (place, &var) in results.iter().enumerate() {
            if self.place(var) == Place::Nowhere {
                continue;
            }
            let from = memory(FRAME, layout.results + bytes * place as u32);
            let to = self.target(var);
            if self.is_mask(var) {
                self.load_mask(to, from);
            } else {
                self.load(to, Operand::Memory(from));
            }
            self.store(var, to);
        }
    }

    fn copy(&mut self, to: Var, from: Var) {
        if self.place(to) == Place::Nowhere {
            return;
        }
        let target = self.target(to);
        if self.is_mask(to) {
            let from = self.mask_in_register(from, target);
            if from != target {
                self.push(valid(Instruction::with2(Code::VEX_Kmovw_kr_km16, target, from)));
            }
        } else {
            let from = self.operand(from);
            self.load(target, from);
        }
        self.store(to, target);
    }

    fn copy_where(&mut self, lanes: Var, to: Var, from: Var) {
        if self.place(to) == Place::Nowhere {
            return;
        }
        if self.is_mask(to) {
            self.copy_mask_where(lanes, to, from);
        } else if self.isa.has_masks() {
            let lanes = self.mask_in_register(lanes, MASK_SCRATCH);
            let from = self.operand(from);
            let mut instruction = if let Some(to) = self.in_frame(self.place(to)) {
                let from = self.in_register(from, self.isa.scratch());
                valid(Instruction::with2(self.isa.store, to, from))
            } else {
                self.loading(self.target(to), from)
            };
            instruction.set_op_mask(lanes);
            self.push(instruction);
        } else {
            let lanes = self.operand(lanes);
            let lanes = self.in_register(lanes, self.isa.scratch());
            let (old, new) = (self.operand(to), self.operand(from));
            let old = self.in_register(old, self.isa.scratch_2());
            self.blend(old, lanes, new, old);
            self.store(to, old);
        }
    }

    fn copy_mask_where(&mut self, lanes: Var, to: Var, from: Var) {
        let lanes = self.mask_in_register(lanes, MASK_SCRATCH);
        let old = self.mask_in_register(to, MASK_SCRATCH_2);
        // Lanes that keep the old value, then those that take the new one.
        self.push(valid(Instruction::with3(Code::VEX_Kandnw_kr_kr_kr, MASK_SCRATCH_2, lanes, old)));
        let new = self.mask_in_register(from, MASK_SCRATCH_3);
        self.push(valid(Instruction::with3(Code::VEX_Kandw_kr_kr_kr, MASK_SCRATCH, lanes, new)));
        let target = self.target(to);
        self.push(valid(Instruction::with3(Code::VEX_Korw_kr_kr_kr, target, MASK_SCRATCH, MASK_SCRATCH_2)));
        self.store(to, target);
    }
}
