//! Machine code that asks the host for words of the table that do not exist yet.

use iced_x86::{Code, Instruction, MemoryOperand, Register};

use super::emit::{
    ARGUMENTS, AT, CANCEL, CONSTANTS, Emitter, FRAME, FUNCTION, PACKETS, RESULTS, ROW_BYTES, STACK, UNIFORMS, WORD,
    memory, valid,
};
use super::fold::low;
use crate::tape::Var;

/// Registers that the host's function may change.
pub(super) const CALLERS: [Register; 8] = [FRAME, UNIFORMS, CONSTANTS, CANCEL, ARGUMENTS, RESULTS, ROW_BYTES, PACKETS];
/// Registers that this code uses, and that the host's function keeps.
pub(super) const OWN: [Register; 3] = [AT, WORD, FUNCTION];

impl Emitter<'_> {
    /// `to` = the words in place of missing ones, in the active lanes.
    pub(super) fn make(&mut self, live: Var, to: Var, missing: Var) {
        let words = self.layout().folds;
        let mask = words + self.isa.packet_bytes();
        self.store_to(missing, words);
        self.store_to(live, mask);
        self.push_all(&OWN);
        self.load_lanes(mask);
        self.push(valid(Instruction::with2(Code::Mov_r32_rm32, low(AT), Register::EAX)));
        let next = self.assembly.next();
        self.push(valid(Instruction::with2(Code::Test_rm32_r32, low(AT), low(AT))));
        let done = self.jump(Code::Je_rel32_64);
        let lane = FUNCTION;
        self.push(valid(Instruction::with2(Code::Bsf_r32_rm32, low(lane), low(AT))));
        self.push(valid(Instruction::with2(Code::Btr_rm32_r32, low(AT), low(lane))));
        self.push_all(&CALLERS);
        let host = self.isa.table_address_at(self.assembly.uniforms) as u32;
        for (register, offset) in [(Register::RAX, 8), (Register::RDX, 16)] {
            let from = memory(UNIFORMS, host + offset);
            self.push(valid(Instruction::with2(Code::Mov_r64_rm64, register, from)));
        }
        let word = MemoryOperand::new(FRAME, lane, 4, words.into(), 1, false, Register::None);
        self.push(valid(Instruction::with2(Code::Mov_r32_rm32, Register::ESI, word)));
        self.push(valid(Instruction::with2(Code::Mov_r64_rm64, Register::RDI, Register::RDX)));
        // The host's function expects an aligned stack.
        self.push(valid(Instruction::with2(Code::Mov_r64_rm64, WORD, STACK)));
        self.push(valid(Instruction::with2(Code::And_rm64_imm8, STACK, -16)));
        self.push(Instruction::with(Code::VEX_Vzeroupper));
        self.push(valid(Instruction::with1(Code::Call_rm64, Register::RAX)));
        self.push(valid(Instruction::with2(Code::Mov_r64_rm64, STACK, WORD)));
        self.pop_all(&CALLERS);
        self.push(valid(Instruction::with2(Code::Mov_rm32_r32, word, Register::EAX)));
        self.push(valid(Instruction::with_branch(Code::Jmp_rel32_64, next)));
        self.land([done]);
        self.pop_all(&OWN);
        self.load_from(to, words);
    }

    fn push_all(&mut self, registers: &[Register]) {
        for &register in registers {
            self.push(valid(Instruction::with1(Code::Push_r64, register)));
        }
    }

    fn pop_all(&mut self, registers: &[Register]) {
        for &register in registers.iter().rev() {
            self.push(valid(Instruction::with1(Code::Pop_r64, register)));
        }
    }
}
