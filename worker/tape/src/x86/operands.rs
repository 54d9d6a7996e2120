//! Operands: where the values of variables are, and the moves between registers and memory.

use iced_x86::{Code, Instruction, MemoryOperand, Register};

use super::emit::{CONSTANTS, Emitter, FRAME, NUMBERS, UNIFORMS, memory, valid};
use crate::tape::{Class, Location, Var};

pub(super) const MASK_SCRATCH: Register = Register::K7;
/// Can't be the mask of an instruction.
pub(super) const MASK_SCRATCH_2: Register = Register::K0;

/// Operand of an instruction.
#[derive(Clone, Copy)]
pub(super) enum Operand {
    Register(Register),
    /// A vector, or one number for all lanes.
    Memory(MemoryOperand),
}

impl Emitter<'_> {
    pub(super) fn place(&self, var: Var) -> Location {
        self.allocation.places[var as usize]
    }

    /// Whether the variable is in a mask register, or would be if there were enough.
    pub(super) fn is_mask(&self, var: Var) -> bool {
        self.isa.has_masks() && self.linear.variables[var as usize].class == Class::Mask
    }

    fn in_frame(&self, place: Location) -> Option<MemoryOperand> {
        let layout = self.layout();
        let offset = match place {
            Location::Slot(slot) => layout.slots + self.isa.packet_bytes() * slot,
            Location::Argument(argument) => layout.arguments + self.isa.packet_bytes() * argument,
            Location::Live => layout.live,
            _ => return None,
        };
        Some(self.in_packet(FRAME, offset))
    }

    /// Constants and uniforms have one word each for AVX-512, which broadcasts it, and a vector for AVX2.
    fn input(&self, base: Register, place: u32, broadcasts: bool) -> MemoryOperand {
        let mut at = memory(base, 4 * self.isa.copies() as u32 * place);
        at.is_broadcast = broadcasts && self.isa.has_masks();
        at
    }

    pub(super) fn constant_at(&self, place: u32, broadcasts: bool) -> MemoryOperand {
        self.input(CONSTANTS, place, broadcasts)
    }

    pub(super) fn constant(&mut self, bits: u32) -> Operand {
        let place = self.assembly.constants.place(bits);
        Operand::Memory(self.constant_at(place, true))
    }

    pub(super) fn operand(&mut self, var: Var) -> Operand {
        match self.place(var) {
            Location::Vector(register) => Operand::Register(self.isa.vector(register, self.vector)),
            Location::Constant(bits) => self.constant(bits),
            Location::Uniform(index) => Operand::Memory(self.input(UNIFORMS, index, true)),
            Location::Row(word) if self.isa.has_masks() => {
                Operand::Memory(MemoryOperand { is_broadcast: true, ..memory(NUMBERS, 4 * word) })
            }
            Location::Row(word) => Operand::Memory(memory(FRAME, self.layout().row + self.isa.packet_bytes() * word)),
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
            Location::Mask(register) => self.isa.mask(register, self.vector),
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
            Location::Vector(register) => self.isa.vector(register, self.vector),
            Location::Mask(register) => self.isa.mask(register, self.vector),
            _ if self.is_mask(var) => MASK_SCRATCH,
            _ => self.isa.scratch,
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

    /// Stores a variable to the frame at an offset.
    pub(super) fn store_to(&mut self, var: Var, offset: u32) {
        self.for_each_vector(|this| {
            let is_mask = this.is_mask(var);
            let from = if is_mask {
                this.mask_in_register(var, MASK_SCRATCH)
            } else {
                let operand = this.operand(var);
                this.in_register(operand, this.isa.scratch)
            };
            this.store_register(is_mask, this.in_packet(FRAME, offset), from);
        });
    }

    /// Loads a variable from the frame at an offset.
    pub(super) fn load_from(&mut self, var: Var, offset: u32) {
        if self.place(var) == Location::Nowhere {
            return;
        }
        self.for_each_vector(|this| {
            let (to, from) = (this.target(var), this.in_packet(FRAME, offset));
            if this.is_mask(var) {
                this.load_mask(to, from);
            } else {
                this.load(to, Operand::Memory(from));
            }
            this.store(var, to);
        });
    }

    pub(super) fn copy(&mut self, to: Var, from: Var) {
        if self.place(to) == Location::Nowhere {
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

    pub(super) fn copy_where(&mut self, lanes: Var, to: Var, from: Var) {
        if self.place(to) == Location::Nowhere {
            return;
        }
        if self.is_mask(to) {
            self.copy_mask_where(lanes, to, from);
        } else if self.isa.has_masks() {
            let lanes = self.mask_in_register(lanes, MASK_SCRATCH);
            let from = self.operand(from);
            let mut instruction = if let Some(to) = self.in_frame(self.place(to)) {
                let from = self.in_register(from, self.isa.scratch);
                valid(Instruction::with2(self.isa.store, to, from))
            } else {
                self.loading(self.target(to), from)
            };
            instruction.set_op_mask(lanes);
            self.push(instruction);
        } else {
            let lanes = self.operand(lanes);
            let lanes = self.in_register(lanes, self.isa.scratch);
            let (old, new) = (self.operand(to), self.operand(from));
            let old = self.in_register(old, self.isa.scratch_2);
            self.blend(old, lanes, new, old);
            self.store(to, old);
        }
    }

    fn copy_mask_where(&mut self, lanes: Var, to: Var, from: Var) {
        // Bits change where the lanes are in the mask and the values differ.
        let new = self.mask_in_register(from, MASK_SCRATCH);
        let old = self.mask_in_register(to, MASK_SCRATCH_2);
        self.push(valid(Instruction::with3(Code::VEX_Kxorw_kr_kr_kr, MASK_SCRATCH_2, old, new)));
        let lanes = self.mask_in_register(lanes, MASK_SCRATCH);
        self.push(valid(Instruction::with3(Code::VEX_Kandw_kr_kr_kr, MASK_SCRATCH_2, MASK_SCRATCH_2, lanes)));
        let old = self.mask_in_register(to, MASK_SCRATCH);
        let target = self.target(to);
        self.push(valid(Instruction::with3(Code::VEX_Kxorw_kr_kr_kr, target, old, MASK_SCRATCH_2)));
        self.store(to, target);
    }
}
