//! Checks which memory machine code touches: each access lies in the frame, the uniforms, the constants, the flag, or a
//! packet's part of a row; only the frame and rows are written, no branch leaves the code, and the other addresses and
//! the stack stay as they are. Debug builds check all code that they emit.

use iced_x86::{Code, Instruction, OpKind, Register};

use super::emit::{
    ARGUMENTS, AT, CANCEL, CONSTANTS, FRAME, FUNCTION, NUMBERS, PACKETS, RESULTS, ROW, ROW_BYTES, SAVED, STACK, TABLE,
    UNIFORMS, WAITING, WORD,
};
use super::fold::low;
use super::make::{CALLERS, OWN};
use super::{AVX2, AVX512};

/// Sizes in bytes of the memory that a program is given.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    pub(super) frame: u64,
    pub(super) uniforms: u64,
    pub(super) constants: u64,
    /// A packet's part of a row.
    pub(super) packet: u64,
    /// A row of numbers in the table.
    pub(super) row: u64,
}

/// An instruction that could leave its memory or code, with the reason.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Violation {
    pub(super) instruction: Instruction,
    pub(super) reason: &'static str,
}

/// The first instruction that is not proved to stay inside. Targets of branches are numbers of instructions, from 1.
pub(super) fn violation(instructions: &[Instruction], sizes: Sizes) -> Option<Violation> {
    let count = instructions.len() as u64;
    instructions.iter().find_map(|instruction| {
        reason(instruction, sizes, count).map(|reason| Violation { instruction: *instruction, reason })
    })
}

fn reason(instruction: &Instruction, sizes: Sizes, count: u64) -> Option<&'static str> {
    if instruction.op_count() == 0 && !matches!(instruction.code(), Code::Retnq | Code::VEX_Vzeroupper) {
        return Some("it is not among the instructions in use");
    }
    if folds(instruction) || makes(instruction) {
        return None;
    }
    let walks = walks_rows(instruction, sizes);
    instruction.op_kinds().enumerate().find_map(|(operand, kind)| match kind {
        OpKind::Immediate8 | OpKind::Immediate32 => None,
        OpKind::Immediate32to64 if walks => None,
        OpKind::Register => {
            let register = instruction.op_register(operand as u32);
            let is_free = (Register::XMM0..=Register::ZMM31).contains(&register)
                || (Register::K0..=Register::K7).contains(&register)
                || [Register::EAX, Register::EBX, Register::EBP, Register::R15D].contains(&register);
            if is_free || walks { None } else { Some("it uses another register") }
        }
        OpKind::NearBranch64 if (1..=count).contains(&instruction.near_branch64()) => None,
        OpKind::NearBranch64 => Some("it branches to no instruction"),
        OpKind::Memory => reason_of_access(instruction, sizes, operand == 0),
        _ => Some("it has an operand of another kind"),
    })
}

/// Whether an instruction takes the part of an entry's code that goes from row to row and from packet to packet.
fn walks_rows(instruction: &Instruction, sizes: Sizes) -> bool {
    let (to, from) = (instruction.op0_register(), instruction.op1_register());
    match instruction.code() {
        Code::Mov_r64_rm64 if instruction.memory_base() == STACK => to == ROW_BYTES || to == PACKETS,
        Code::Mov_r64_rm64 if instruction.memory_base() == UNIFORMS => [ROW, TABLE, Register::RDX].contains(&to),
        Code::Mov_r64_rm64 if instruction.memory_base() == FRAME => SAVED.contains(&to),
        Code::Mov_rm64_r64 if instruction.memory_base() == FRAME => SAVED.contains(&from),
        Code::Mov_r64_rm64 => to == ROW && (from == ARGUMENTS || from == RESULTS),
        Code::Add_r64_rm64 => to == ROW && from == ROW_BYTES,
        Code::Add_rm64_imm32 => (to == ARGUMENTS || to == RESULTS) && instruction.immediate(1) == sizes.packet,
        Code::Dec_rm64 => to == PACKETS,
        _ => false,
    }
}

/// Whether an instruction takes the part of a fold that goes from operation to operation: registers of its own, words of
/// the table at the index or row that the instructions before limited, words of the frame at a lane, and the addresses of
/// rows and of values that wait.
fn folds(instruction: &Instruction) -> bool {
    let own = |register: Register| register == Register::EAX || [AT, WORD, FUNCTION].map(low).contains(&register);
    let has_memory = instruction.op_kinds().any(|kind| kind == OpKind::Memory);
    let is_table = instruction.memory_base() == TABLE && instruction.memory_index_scale() == 4;
    let of_table = is_table && instruction.memory_index() == AT && instruction.memory_displacement64() <= 4;
    let of_lane = instruction.memory_base() == FRAME
        && [Register::RAX, FUNCTION].contains(&instruction.memory_index())
        && instruction.memory_index_scale() == 4;
    let to = instruction.op0_register();
    match instruction.code() {
        Code::Lea_r64_m => match to {
            NUMBERS => is_table && instruction.memory_index() == WORD && instruction.memory_displacement64() == 0,
            _ => [WAITING, Register::RAX].contains(&to) && instruction.memory_base() == FRAME,
        },
        Code::Cmp_r64_rm64
        | Code::Cmova_r64_rm64
        | Code::Cmovb_r64_rm64
        | Code::Add_rm64_imm32
        | Code::Sub_rm64_imm32 => to == WAITING,
        Code::Mov_rm32_r32 => of_lane,
        Code::Test_rm32_imm32 => of_table,
        Code::Mov_r32_rm32 | Code::Cmp_rm32_imm8 if has_memory => of_table || of_lane,
        Code::Mov_r32_rm32
        | Code::Cmova_r32_rm32
        | Code::Cmp_r32_rm32
        | Code::Cmp_rm32_imm8
        | Code::Shr_rm32_imm8
        | Code::Shl_rm32_imm8
        | Code::And_rm32_imm8
        | Code::And_rm32_imm32
        | Code::Sub_rm32_imm32
        | Code::Add_rm32_imm8
        | Code::Or_r32_rm32
        | Code::Test_rm32_r32
        | Code::Bsf_r32_rm32
        | Code::Btr_rm32_r32
        | Code::Dec_rm32 => !has_memory && own(to),
        _ => false,
    }
}

/// Whether an instruction takes the part that calls the host for a word.
fn makes(instruction: &Instruction) -> bool {
    let (to, from) = (instruction.op0_register(), instruction.op1_register());
    match instruction.code() {
        Code::Push_r64 | Code::Pop_r64 => CALLERS.contains(&to) || OWN.contains(&to),
        Code::Call_rm64 => to == Register::RAX,
        Code::And_rm64_imm8 => to == STACK,
        Code::Mov_r64_rm64 if instruction.memory_base() == UNIFORMS => false,
        Code::Mov_r64_rm64 => [(Register::RDI, Register::RDX), (WORD, STACK), (STACK, WORD)].contains(&(to, from)),
        Code::Mov_r32_rm32 => to == Register::ESI && instruction.memory_index() == FUNCTION,
        _ => false,
    }
}

fn reason_of_access(instruction: &Instruction, sizes: Sizes, is_first: bool) -> Option<&'static str> {
    let code = instruction.code();
    if matches!(code, Code::EVEX_Vpgatherdd_zmm_k1_vm32z | Code::VEX_Vpgatherdd_ymm_vm32y_ymm) {
        return reason_of_gather(instruction);
    }
    let bytes = match instruction.memory_base() {
        // The values that wait are in the frame; the fold keeps their address there.
        FRAME | WAITING => sizes.frame,
        UNIFORMS => sizes.uniforms,
        CONSTANTS => sizes.constants,
        CANCEL => 1,
        ROW => sizes.packet,
        NUMBERS => sizes.row,
        // The return address and the two arguments above it.
        STACK => 24,
        _ => return Some("it reaches memory through another register"),
    };
    let is_read = !is_first || matches!(code, Code::Cmp_rm8_imm8 | Code::VEX_Vldmxcsr_m32);
    if !is_read && !matches!(instruction.memory_base(), FRAME | ROW | WAITING) {
        return Some("it writes to memory that is neither the frame nor a row");
    }
    if instruction.memory_index() != Register::None || instruction.has_segment_prefix() {
        return Some("its address is not a constant offset");
    }
    let size = instruction.memory_size().size() as u64;
    let end = instruction.memory_displacement64().checked_add(size);
    if size == 0 || end.is_none_or(|end| end > bytes) {
        return Some("it is outside of its memory");
    }
    None
}

/// Words of the table: the indices are in the register to which the instruction before limited them.
fn reason_of_gather(instruction: &Instruction) -> Option<&'static str> {
    let is_limited = [AVX512.scratch_2, AVX2.scratch_2].contains(&instruction.memory_index());
    let is_table = instruction.memory_base() == ROW
        && instruction.memory_index_scale() == 4
        && instruction.memory_displacement64() == 0
        && !instruction.has_segment_prefix();
    if is_limited && is_table { None } else { Some("it gathers no words of the table") }
}

#[cfg(test)]
mod tests {
    use iced_x86::{IcedError, MemoryOperand};

    use super::*;

    const SIZES: Sizes = Sizes { frame: 128, uniforms: 64, constants: 8, packet: 128, row: 16 };

    fn at(base: Register, offset: i64) -> MemoryOperand {
        MemoryOperand::with_base_displ(base, offset)
    }

    /// The word of a table at an index and a constant offset.
    fn indexed(base: Register, index: Register, offset: i64) -> MemoryOperand {
        MemoryOperand::new(base, index, 4, offset, 1, false, Register::None)
    }

    fn broadcast(base: Register, offset: i64) -> MemoryOperand {
        MemoryOperand { is_broadcast: true, ..at(base, offset) }
    }

    fn found(instruction: Result<&Instruction, &IcedError>) -> Option<&'static str> {
        let instruction = *instruction.expect("it can be created");
        violation(&[Instruction::with(Code::VEX_Vzeroupper), instruction], SIZES).map(|violation| violation.reason)
    }

    #[test]
    fn accesses_inside_the_memory_are_accepted() {
        let (load, store) = (Code::EVEX_Vmovaps_zmm_k1z_zmmm512, Code::EVEX_Vmovaps_zmmm512_k1z_zmm);
        let add = Code::EVEX_Vaddps_zmm_k1z_zmm_zmmm512b32_er;
        let gathered = MemoryOperand::with_base_index_scale(ROW, AVX512.scratch_2, 4);
        for inside in [
            Instruction::with2(load, Register::ZMM1, at(FRAME, 64)),
            Instruction::with2(store, at(FRAME, 0), Register::ZMM1),
            Instruction::with2(load, Register::ZMM1, at(UNIFORMS, 0)),
            Instruction::with3(add, Register::ZMM1, Register::ZMM2, broadcast(CONSTANTS, 4)),
            Instruction::with2(Code::VEX_Kmovw_kr_km16, Register::K1, at(FRAME, 126)),
            Instruction::with2(Code::Cmp_rm8_imm8, at(CANCEL, 0), 0_u32),
            Instruction::with1(Code::VEX_Vldmxcsr_m32, at(CONSTANTS, 4)),
            Instruction::with2(Code::EVEX_Vmovups_zmm_k1z_zmmm512, Register::ZMM1, at(ROW, 64)),
            Instruction::with2(Code::Mov_r64_rm64, ROW_BYTES, at(STACK, 8)),
            Instruction::with2(Code::Mov_r64_rm64, ROW, ARGUMENTS),
            Instruction::with2(Code::Mov_r64_rm64, ROW, at(UNIFORMS, 56)),
            Instruction::with2(Code::EVEX_Vpgatherdd_zmm_k1_vm32z, Register::ZMM1, gathered),
            Instruction::with2(Code::Add_r64_rm64, ROW, ROW_BYTES),
            Instruction::with2(Code::Add_rm64_imm32, RESULTS, 128_u32),
            Instruction::with1(Code::Dec_rm64, PACKETS),
            Instruction::with2(Code::Mov_r64_rm64, TABLE, at(UNIFORMS, 40)),
            Instruction::with3(add, Register::ZMM1, Register::ZMM2, broadcast(NUMBERS, 12)),
            Instruction::with2(Code::Mov_r32_rm32, Register::EBP, indexed(TABLE, AT, 4)),
            Instruction::with2(store, at(WAITING, 64), Register::ZMM1),
            Instruction::with1(Code::Push_r64, FRAME),
            Instruction::with_branch(Code::Je_rel32_64, 2),
            Ok(Instruction::with(Code::Retnq)),
        ] {
            assert_eq!(found(inside.as_ref()), None, "{inside:?}");
        }
    }

    #[test]
    fn accesses_outside_the_memory_are_found() {
        let (load, store) = (Code::EVEX_Vmovaps_zmm_k1z_zmmm512, Code::EVEX_Vmovaps_zmmm512_k1z_zmm);
        let add = Code::EVEX_Vaddps_zmm_k1z_zmm_zmmm512b32_er;
        let (outside, written) =
            ("it is outside of its memory", "it writes to memory that is neither the frame nor a row");
        let (address, register) = ("its address is not a constant offset", "it uses another register");
        let (other, branch) = ("it reaches memory through another register", "it branches to no instruction");
        let unlimited = MemoryOperand::with_base_index_scale(ROW, Register::ZMM2, 4);
        let no_table = "it gathers no words of the table";
        let by_index = MemoryOperand::with_base_index_scale(FRAME, Register::RAX, 4);
        let prefixed = MemoryOperand { segment_prefix: Register::FS, ..at(FRAME, 0) };
        for (instruction, want) in [
            (Instruction::with2(load, Register::ZMM1, at(FRAME, 65)), outside),
            (Instruction::with2(load, Register::ZMM1, at(FRAME, 128)), outside),
            (Instruction::with2(load, Register::ZMM1, at(FRAME, -1)), outside),
            (Instruction::with2(store, at(FRAME, 68), Register::ZMM1), outside),
            (Instruction::with2(load, Register::ZMM1, at(CONSTANTS, 0)), outside),
            (Instruction::with3(add, Register::ZMM1, Register::ZMM2, broadcast(CONSTANTS, 8)), outside),
            (Instruction::with2(Code::VEX_Kmovw_m16_kr, at(FRAME, 127), Register::K1), outside),
            (Instruction::with2(Code::Cmp_rm8_imm8, at(CANCEL, 1), 0_u32), outside),
            (Instruction::with2(store, at(UNIFORMS, 0), Register::ZMM1), written),
            (Instruction::with2(Code::VEX_Kmovw_m16_kr, at(CONSTANTS, 0), Register::K1), written),
            (Instruction::with2(Code::Mov_rm32_imm32, at(CANCEL, 0), 1_u32), written),
            (Instruction::with1(Code::Dec_rm32, at(UNIFORMS, 0)), written),
            (Instruction::with2(load, Register::ZMM1, at(Register::R8, 0)), other),
            (Instruction::with2(load, Register::ZMM1, at(ROW, 65)), outside),
            (Instruction::with2(load, Register::ZMM1, at(STACK, 0)), outside),
            (Instruction::with2(Code::Mov_r64_rm64, PACKETS, at(STACK, 24)), outside),
            (Instruction::with2(Code::Mov_r64_rm64, ARGUMENTS, at(STACK, 8)), register),
            (Instruction::with2(Code::Mov_r64_rm64, ROW, FRAME), register),
            (Instruction::with2(Code::Add_r64_rm64, ROW, PACKETS), register),
            (Instruction::with2(Code::Add_rm64_imm32, ARGUMENTS, 64_u32), register),
            (Instruction::with1(Code::Dec_rm64, ROW_BYTES), register),
            (Instruction::with2(Code::Mov_rm64_r64, at(STACK, 0), ROW), written),
            (Instruction::with2(load, Register::ZMM1, at(Register::RIP, 64)), other),
            (Instruction::with2(load, Register::ZMM1, by_index), address),
            (Instruction::with2(load, Register::ZMM1, prefixed), address),
            (Instruction::with2(Code::Mov_r64_rm64, ROW, at(UNIFORMS, 60)), outside),
            (Instruction::with2(Code::EVEX_Vpgatherdd_zmm_k1_vm32z, Register::ZMM1, unlimited), no_table),
            (Instruction::with1(Code::Push_r64, Register::RAX), register),
            (Instruction::with2(Code::Mov_r64_rm64, TABLE, at(UNIFORMS, 60)), outside),
            (Instruction::with3(add, Register::ZMM1, Register::ZMM2, broadcast(NUMBERS, 16)), outside),
            (Instruction::with2(store, at(NUMBERS, 0), Register::ZMM1), written),
            (Instruction::with2(Code::Mov_r32_rm32, Register::EBP, indexed(TABLE, AT, 8)), other),
            (Instruction::with2(Code::Mov_rm32_r32, indexed(TABLE, AT, 0), Register::EBP), other),
            (Instruction::with2(Code::Mov_r64_rm64, Register::RDI, Register::RSI), register),
            (Ok(Instruction::with(Code::Leaveq)), "it is not among the instructions in use"),
            (Instruction::with_branch(Code::Call_rel32_64, 3), branch),
            (Instruction::with_branch(Code::Jne_rel32_64, 0), branch),
            (Instruction::with_rep_stosb(64), "it has an operand of another kind"),
        ] {
            assert_eq!(found(instruction.as_ref()), Some(want), "{instruction:?}");
        }
    }
}
