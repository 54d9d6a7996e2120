//! Machine code of the operations.

use iced_x86::{Code, Instruction, MemoryOperand, Register};
use math::real::SQRT_FLOOR;

use super::emit::{Emitter, ROW, UNIFORMS, memory, valid};
use super::operands::{MASK_SCRATCH, MASK_SCRATCH_2, Operand};
use crate::tape::{Location, Operation, Var};

/// Predicates of a comparison. Without NaN, ordered and unordered ones agree.
const LESS: u32 = 1;
const NOT_LESS: u32 = 5;
/// Round down, without a report of inexactness.
const FLOOR: u32 = 9;
const SIGN: u32 = 1 << 31;

impl Emitter<'_> {
    /// `to` = `yes` in these lanes, `no` in the others; without mask registers.
    pub(super) fn blend(&mut self, to: Register, lanes: Register, yes: Operand, no: Register) {
        let code = Code::VEX_Vblendvps_ymm_ymm_ymmm256_ymm;
        self.push(valid(match yes {
            Operand::Register(yes) => Instruction::with4(code, to, no, yes, lanes),
            Operand::Memory(yes) => Instruction::with4(code, to, no, yes, lanes),
        }));
    }

    /// Instruction of a target and two operands; the second may be in memory.
    fn two(&mut self, code: Code, to: Register, a: Operand, b: Operand) {
        let a = self.in_register(a, self.isa.scratch_2);
        self.three(code, to, a, b);
    }

    fn three(&mut self, code: Code, to: Register, second: Register, third: Operand) {
        self.push(valid(match third {
            Operand::Register(third) => Instruction::with3(code, to, second, third),
            Operand::Memory(third) => Instruction::with3(code, to, second, third),
        }));
    }

    /// Like [`Self::two`]; the operands may be exchanged.
    fn two_commuting(&mut self, code: Code, to: Register, a: Operand, b: Operand) {
        if matches!(a, Operand::Register(_)) { self.two(code, to, a, b) } else { self.two(code, to, b, a) }
    }

    pub(super) fn compute(&mut self, to: Var, operation: Operation, operands: [Var; 3]) {
        if self.place(to) == Location::Nowhere {
            return;
        }
        let target = self.target(to);
        if operation == Operation::Less {
            self.compare(target, operands);
        } else if self.is_mask(to) {
            self.combine_masks(target, operation, operands);
        } else if operation == Operation::Select {
            self.select(target, operands);
        } else {
            self.compute_vector(target, operation, operands);
        }
        self.store(to, target);
    }

    fn compare(&mut self, to: Register, [a, b, _]: [Var; 3]) {
        let (a, b) = (self.operand(a), self.operand(b));
        let a = self.in_register(a, self.isa.scratch_2);
        self.compare_with(to, a, b, LESS);
    }

    fn compare_with(&mut self, to: Register, a: Register, b: Operand, predicate: u32) {
        self.push(valid(match b {
            Operand::Register(b) => Instruction::with4(self.isa.compare, to, a, b, predicate),
            Operand::Memory(b) => Instruction::with4(self.isa.compare, to, a, b, predicate),
        }));
    }

    fn combine_masks(&mut self, to: Register, operation: Operation, [a, b, _]: [Var; 3]) {
        let a = self.mask_in_register(a, MASK_SCRATCH);
        let instruction = match operation {
            Operation::Not => Instruction::with2(Code::VEX_Knotw_kr_kr, to, a),
            Operation::And | Operation::Or => {
                let b = self.mask_in_register(b, MASK_SCRATCH_2);
                let code = if operation == Operation::And { Code::VEX_Kandw_kr_kr_kr } else { Code::VEX_Korw_kr_kr_kr };
                Instruction::with3(code, to, a, b)
            }
            _ => unreachable!("{operation:?} gives no mask"),
        };
        self.push(valid(instruction));
    }

    fn select(&mut self, to: Register, [lanes, yes, no]: [Var; 3]) {
        let (yes, no) = (self.operand(yes), self.operand(no));
        if self.isa.has_masks() {
            let lanes = self.mask_in_register(lanes, MASK_SCRATCH);
            let no = self.in_register(no, self.isa.scratch_2);
            self.three(Code::EVEX_Vblendmps_zmm_k1z_zmm_zmmm512b32, to, no, yes);
            self.assembly.instructions.last_mut().expect("it was pushed").set_op_mask(lanes);
        } else {
            let lanes = self.operand(lanes);
            let lanes = self.in_register(lanes, self.isa.scratch);
            let no = self.in_register(no, self.isa.scratch_2);
            self.blend(to, lanes, yes, no);
        }
    }

    fn compute_vector(&mut self, to: Register, operation: Operation, operands: [Var; 3]) {
        let isa = self.isa;
        let a = self.operand(operands[0]);
        let b = if operation.operand_count() > 1 { self.operand(operands[1]) } else { a };
        match operation {
            Operation::Add => self.two_commuting(isa.add, to, a, b),
            Operation::Sub => self.two(isa.sub, to, a, b),
            Operation::Mul => self.two_commuting(isa.mul, to, a, b),
            Operation::Div => self.two(isa.div, to, a, b),
            // If neither is less, the second operand is taken: the reference takes the first.
            Operation::Min => self.two_commuting(isa.min, to, b, a),
            Operation::Max => self.two_commuting(isa.max, to, b, a),
            Operation::AddU32 => self.two_commuting(isa.add_u32, to, a, b),
            Operation::MulU32 => self.two_commuting(isa.mul_u32, to, a, b),
            Operation::Xor => self.two_commuting(isa.xor, to, a, b),
            Operation::And | Operation::AndU32 => self.two_commuting(isa.and, to, a, b),
            Operation::Or | Operation::OrU32 => self.two_commuting(isa.or, to, a, b),
            Operation::Not => {
                let all = self.constant(u32::MAX);
                self.two_commuting(isa.xor, to, a, all);
            }
            Operation::Neg => {
                let sign = self.constant(SIGN);
                self.two_commuting(isa.xor, to, a, sign);
            }
            Operation::Abs => {
                let all_but_sign = self.constant(!SIGN);
                self.two_commuting(isa.and, to, a, all_but_sign);
            }
            Operation::Floor => self.push(valid(match a {
                Operand::Register(a) => Instruction::with3(isa.floor, to, a, FLOOR),
                Operand::Memory(a) => Instruction::with3(isa.floor, to, a, FLOOR),
            })),
            Operation::Sqrt => self.sqrt(to, a),
            Operation::ShiftLeft | Operation::ShiftRight => {
                let Location::Constant(by) = self.place(operands[1]) else { unreachable!("shifts are by constants") };
                let code = if operation == Operation::ShiftLeft { isa.shift_left } else { isa.shift_right };
                let a = self.in_register(a, isa.scratch_2);
                self.push(valid(Instruction::with3(code, to, a, by)));
            }
            Operation::Fma => self.fma(to, a, b, operands[2]),
            Operation::Word => self.word(to, a, b),
            _ => unreachable!("{operation:?} gives no number"),
        }
    }

    /// Words of the table at indices, at most `last`.
    fn word(&mut self, to: Register, indices: Operand, last: Operand) {
        let indices = self.in_register(indices, self.isa.scratch_2);
        self.three(self.isa.min_u32, self.isa.scratch_2, indices, last);
        let address = memory(UNIFORMS, self.isa.table_address_at(self.assembly.uniforms) as u32);
        self.push(valid(Instruction::with2(Code::Mov_r64_rm64, ROW, address)));
        let words = MemoryOperand::with_base_index_scale(ROW, self.isa.scratch_2, 4);
        if self.isa.has_masks() {
            self.push(valid(Instruction::with3(Code::VEX_Kxnorw_kr_kr_kr, MASK_SCRATCH, MASK_SCRATCH, MASK_SCRATCH)));
            let mut gather = valid(Instruction::with2(Code::EVEX_Vpgatherdd_zmm_k1_vm32z, to, words));
            gather.set_op_mask(MASK_SCRATCH);
            self.push(gather);
        } else {
            let all = self.isa.word_mask();
            self.push(valid(Instruction::with3(Code::VEX_Vpcmpeqd_ymm_ymm_ymmm256, all, all, all)));
            self.push(valid(Instruction::with3(Code::VEX_Vpgatherdd_ymm_vm32y_ymm, to, words, all)));
        }
    }

    /// The root; 0 below the floor.
    fn sqrt(&mut self, to: Register, a: Operand) {
        let floor = self.constant(SQRT_FLOOR.to_bits());
        let a = self.in_register(a, self.isa.scratch_2);
        if self.isa.has_masks() {
            self.compare_with(MASK_SCRATCH, a, floor, NOT_LESS);
            let mut root = valid(Instruction::with2(self.isa.sqrt, to, a));
            root.set_op_mask(MASK_SCRATCH);
            root.set_zeroing_masking(true);
            self.push(root);
        } else {
            let (above, root) = (self.isa.scratch, self.isa.scratch_2);
            self.compare_with(above, a, floor, NOT_LESS);
            self.push(valid(Instruction::with2(self.isa.sqrt, root, a)));
            self.three(self.isa.and, to, above, Operand::Register(root));
        }
    }

    /// `a · b + c`. The instruction overwrites one operand, so the target must be one.
    fn fma(&mut self, to: Register, a: Operand, b: Operand, c: Var) {
        let isa = self.isa;
        let c = self.operand(c);
        let is_target = |operand: &Operand| matches!(operand, Operand::Register(register) if *register == to);
        let (a, b) = if is_target(&b) { (b, a) } else { (a, b) };
        if is_target(&a) {
            self.fma_into_factor(to, b, c);
        } else if is_target(&c) {
            let (a, b) = if matches!(a, Operand::Register(_)) { (a, b) } else { (b, a) };
            let a = self.in_register(a, isa.scratch_2);
            self.three(isa.fma231, to, a, b);
        } else {
            // The target takes an operand that is in memory, if any.
            let in_memory = |operand: &Operand| matches!(operand, Operand::Memory(_));
            if in_memory(&c) || !(in_memory(&a) || in_memory(&b)) {
                self.load(to, c);
                let (a, b) = if in_memory(&a) { (b, a) } else { (a, b) };
                let a = self.in_register(a, isa.scratch_2);
                self.three(isa.fma231, to, a, b);
            } else {
                let (a, b) = if in_memory(&a) { (a, b) } else { (b, a) };
                self.load(to, a);
                self.fma_into_factor(to, b, c);
            }
        }
    }

    /// `to · b + c`; at most one operand can be read from memory.
    fn fma_into_factor(&mut self, to: Register, b: Operand, c: Operand) {
        match (b, c) {
            (Operand::Register(b), c) => self.three(self.isa.fma213, to, b, c),
            (b, Operand::Register(c)) => self.three(self.isa.fma132, to, c, b),
            (b, c) => {
                let b = self.in_register(b, self.isa.scratch_2);
                self.three(self.isa.fma213, to, b, c);
            }
        }
    }
}
