//! Machine code of folds of lists. The lanes of a packet that have one list are evaluated together: which operations
//! come, and where their numbers are, is then the same for all of them, and the numbers are read like the scene's.

use iced_x86::{Code, Instruction, MemoryOperand, Register};
use math::real::list::{NO_LEAF, OPERATION_WORDS, ROW_BITS, ROW_MASK};

use super::emit::{AT, CANCEL, Emitter, FRAME, FUNCTION, NUMBERS, TABLE, UNIFORMS, WAITING, WORD, memory, valid};
use super::operands::{MASK_SCRATCH, MASK_SCRATCH_2};
use crate::tape::FoldStep;

/// A scalar register of 64 bits as one of 32.
pub(super) fn low(register: Register) -> Register {
    register - (Register::RAX as u32 - Register::EAX as u32)
}

/// Word of the current operation.
fn word_of_operation(word: u32) -> MemoryOperand {
    MemoryOperand::new(TABLE, AT, 4, i64::from(4 * word), u32::from(word > 0), false, Register::None)
}

/// Places in the frame that a fold uses, as offsets in bytes.
struct Places {
    lists: u32,
    remaining: u32,
    results: u32,
    /// The values that wait, and their bytes together.
    waiting: u32,
    waiting_bytes: u32,
    /// Bytes of a value.
    value_bytes: u32,
    /// Mask of the active lanes of the fold's functions.
    lanes: u32,
    below: u32,
    value: u32,
    /// Index of the table's last word.
    last: MemoryOperand,
}

impl Emitter<'_> {
    fn places(&self, fold: &FoldStep) -> Places {
        let bytes = self.isa.packet_bytes();
        let (own, lanes) = (self.layout().folds, self.layouts[fold.leaves[0]].live);
        let value_bytes = bytes * fold.width();
        let below = lanes + bytes * fold.join_layout().arguments;
        let last = memory(UNIFORMS, 4 * self.isa.copies() as u32 * fold.last);
        Places {
            lists: own + bytes * FoldStep::LISTS,
            remaining: own + bytes * FoldStep::REMAINING,
            results: own + bytes * FoldStep::RESULTS,
            waiting: own + bytes * fold.waiting(),
            waiting_bytes: value_bytes * fold.depth,
            value_bytes,
            lanes,
            below,
            value: below + value_bytes,
            last,
        }
    }

    pub(super) fn fold(&mut self, fold: &FoldStep) {
        let places = self.places(fold);
        let bytes = self.isa.packet_bytes();
        for (place, &var) in fold.arguments.iter().enumerate() {
            self.store_to(var, places.lanes + bytes * (place as u32 + 1));
        }
        self.store_to(fold.list, places.lists);
        self.store_to(fold.live, places.remaining);
        self.load_table_address(TABLE);
        let groups = self.assembly.next();
        let done = self.next_lane(&places);
        self.push(valid(Instruction::with2(Code::Cmp_rm8_imm8, memory(CANCEL, 0), 0_u32)));
        let cancelled = self.jump(Code::Jne_rel32_64);
        self.choose_lanes(&places);
        self.push(valid(Instruction::with2(Code::Lea_r64_m, WAITING, memory(FRAME, places.waiting))));
        self.operations(fold, &places);
        self.keep_results(fold, &places);
        self.push(valid(Instruction::with_branch(Code::Jmp_rel32_64, groups)));
        self.land([done, cancelled]);
        for (place, &var) in fold.results.iter().enumerate() {
            self.load_from(var, places.results + bytes * place as u32);
        }
    }

    fn load_table_address(&mut self, to: Register) {
        let address = memory(UNIFORMS, self.isa.table_address_at(self.assembly.uniforms) as u32);
        self.push(valid(Instruction::with2(Code::Mov_r64_rm64, to, address)));
    }

    /// A branch to a place that [`Self::land`] sets.
    pub(super) fn jump(&mut self, code: Code) -> usize {
        self.push(valid(Instruction::with_branch(code, 0)));
        self.assembly.instructions.len() - 1
    }

    pub(super) fn land(&mut self, branches: impl IntoIterator<Item = usize>) {
        let here = self.assembly.next();
        for branch in branches {
            self.assembly.instructions[branch].set_near_branch64(here);
        }
    }

    /// Loads the lanes of a mask in the frame as bits. The zero flag is set if there are none.
    pub(super) fn load_lanes(&mut self, mask: u32) {
        let eax = Register::EAX;
        if self.isa.has_masks() {
            let second = memory(FRAME, mask + self.isa.vector_bytes());
            self.push(valid(Instruction::with2(Code::Movzx_r32_rm16, low(WORD), second)));
            self.push(valid(Instruction::with2(Code::Shl_rm32_imm8, low(WORD), 16_u32)));
            self.push(valid(Instruction::with2(Code::Movzx_r32_rm16, eax, memory(FRAME, mask))));
            self.push(valid(Instruction::with2(Code::Or_r32_rm32, eax, low(WORD))));
        } else {
            let scratch = self.isa.scratch;
            self.push(valid(Instruction::with2(self.isa.load, scratch, memory(FRAME, mask))));
            self.push(valid(Instruction::with2(Code::VEX_Vmovmskps_r32_ymm, eax, scratch)));
            self.push(valid(Instruction::with2(Code::Test_rm32_r32, eax, eax)));
        }
    }

    /// Loads the list of the first remaining lane; returns the branch that is taken if none remains.
    fn next_lane(&mut self, places: &Places) -> usize {
        let eax = Register::EAX;
        self.load_lanes(places.remaining);
        let done = self.jump(Code::Je_rel32_64);
        self.push(valid(Instruction::with2(Code::Bsf_r32_rm32, eax, eax)));
        let list = MemoryOperand::new(FRAME, Register::RAX, 4, places.lists.into(), 1, false, Register::None);
        self.push(valid(Instruction::with2(Code::Mov_r32_rm32, low(AT), list)));
        done
    }

    /// Sets the active lanes of the fold's functions to those that have the list, and takes them from those that remain.
    fn choose_lanes(&mut self, places: &Places) {
        let scratch = self.isa.scratch;
        if self.isa.has_masks() {
            self.push(valid(Instruction::with2(Code::EVEX_Vpbroadcastd_zmm_k1z_r32, scratch, low(AT))));
            self.for_each_vector(|this| {
                let (remaining, lanes) = (this.in_packet(FRAME, places.remaining), this.in_packet(FRAME, places.lanes));
                this.push(valid(Instruction::with2(Code::VEX_Kmovw_kr_km16, MASK_SCRATCH, remaining)));
                let lists = this.in_packet(FRAME, places.lists);
                this.push(valid(Instruction::with2(Code::VEX_Kmovw_kr_km16, MASK_SCRATCH_2, remaining)));
                let code = Code::EVEX_Vpcmpeqd_kr_k1_zmm_zmmm512b32;
                let mut compare = valid(Instruction::with3(code, MASK_SCRATCH, scratch, lists));
                compare.set_op_mask(MASK_SCRATCH);
                this.push(compare);
                this.push(valid(Instruction::with2(Code::VEX_Kmovw_m16_kr, lanes, MASK_SCRATCH)));
                let xor = Code::VEX_Kxorw_kr_kr_kr;
                this.push(valid(Instruction::with3(xor, MASK_SCRATCH_2, MASK_SCRATCH_2, MASK_SCRATCH)));
                this.push(valid(Instruction::with2(Code::VEX_Kmovw_m16_kr, remaining, MASK_SCRATCH_2)));
            });
        } else {
            let other = self.isa.scratch_2;
            let (remaining, lanes) = (memory(FRAME, places.remaining), memory(FRAME, places.lanes));
            let narrow = other - Register::YMM0 as u32 + Register::XMM0 as u32;
            self.push(valid(Instruction::with2(Code::VEX_Vmovd_xmm_rm32, narrow, low(AT))));
            self.push(valid(Instruction::with2(Code::VEX_Vpbroadcastd_ymm_xmmm32, other, narrow)));
            let compare = Code::VEX_Vpcmpeqd_ymm_ymm_ymmm256;
            self.push(valid(Instruction::with3(compare, other, other, memory(FRAME, places.lists))));
            self.push(valid(Instruction::with2(self.isa.load, scratch, remaining)));
            self.push(valid(Instruction::with3(self.isa.and, other, other, scratch)));
            self.push(valid(Instruction::with2(self.isa.store, lanes, other)));
            self.push(valid(Instruction::with3(self.isa.xor, scratch, scratch, other)));
            self.push(valid(Instruction::with2(self.isa.store, remaining, scratch)));
        }
    }

    /// Runs the operations of a list from its first word on.
    fn operations(&mut self, fold: &FoldStep, places: &Places) {
        let eax = Register::EAX;
        let next = self.assembly.next();
        // An operation has two words.
        self.push(valid(Instruction::with2(Code::Mov_r32_rm32, eax, places.last)));
        self.push(valid(Instruction::with1(Code::Dec_rm32, eax)));
        self.push(valid(Instruction::with2(Code::Cmp_r32_rm32, low(AT), eax)));
        self.push(valid(Instruction::with2(Code::Cmova_r32_rm32, low(AT), eax)));
        self.push(valid(Instruction::with2(Code::Mov_r32_rm32, low(WORD), word_of_operation(0))));
        self.function_of_word();
        self.push(valid(Instruction::with2(Code::Cmp_rm32_imm8, low(FUNCTION), NO_LEAF)));
        let has_no_leaf = self.jump(Code::Je_rel32_64);

        self.numbers_of_word(fold, places);
        self.push(valid(Instruction::with2(Code::Test_rm32_imm32, word_of_operation(1), NO_LEAF << ROW_BITS)));
        let joins = self.jump(Code::Jne_rel32_64);
        self.copy_value(memory(WAITING, 0), memory(FRAME, places.below), places.value_bytes);
        self.push(valid(Instruction::with2(Code::Add_rm64_imm32, WAITING, places.value_bytes)));
        self.limit_waiting(places, places.waiting_bytes, Code::Cmova_r64_rm64);
        self.land([joins]);
        self.call_function(&fold.leaves, 0);
        let has_value = self.jump(Code::Jmp_rel32_64);

        self.land([has_no_leaf]);
        self.copy_value(memory(FRAME, places.value), memory(FRAME, places.below), places.value_bytes);
        self.push(valid(Instruction::with2(Code::Cmp_rm32_imm8, word_of_operation(1), 0_u32)));
        let is_unary = self.jump(Code::Jl_rel32_64);
        self.push(valid(Instruction::with2(Code::Sub_rm64_imm32, WAITING, places.value_bytes)));
        self.limit_waiting(places, 0, Code::Cmovb_r64_rm64);
        self.copy_value(memory(FRAME, places.below), memory(WAITING, 0), places.value_bytes);

        self.land([has_value, is_unary]);
        self.push(valid(Instruction::with2(Code::Mov_r32_rm32, low(WORD), word_of_operation(1))));
        self.function_of_word();
        self.push(valid(Instruction::with2(Code::Test_rm32_r32, low(FUNCTION), low(FUNCTION))));
        let has_no_join = self.jump(Code::Je_rel32_64);
        self.numbers_of_word(fold, places);
        self.call_function(&fold.joins, 1);
        let is_joined = self.jump(Code::Jmp_rel32_64);
        self.land([has_no_join]);
        self.copy_value(memory(FRAME, places.below), memory(FRAME, places.value), places.value_bytes);

        self.land([is_joined]);
        self.push(valid(Instruction::with2(Code::Mov_r32_rm32, low(WORD), word_of_operation(0))));
        self.push(valid(Instruction::with2(Code::Test_rm32_r32, low(WORD), low(WORD))));
        let is_last = self.jump(Code::Js_rel32_64);
        self.push(valid(Instruction::with2(Code::Add_rm32_imm8, low(AT), OPERATION_WORDS)));
        self.push(valid(Instruction::with2(Code::Cmp_r32_rm32, low(AT), places.last)));
        self.push(valid(Instruction::with_branch(Code::Jb_rel32_64, next)));
        self.land([is_last]);
    }

    fn function_of_word(&mut self) {
        self.push(valid(Instruction::with2(Code::Mov_r32_rm32, low(FUNCTION), low(WORD))));
        self.push(valid(Instruction::with2(Code::Shr_rm32_imm8, low(FUNCTION), ROW_BITS)));
        self.push(valid(Instruction::with2(Code::And_rm32_imm8, low(FUNCTION), NO_LEAF)));
    }

    /// Address of the row of a word: the last one that the table has room for, if it is beyond that.
    fn numbers_of_word(&mut self, fold: &FoldStep, places: &Places) {
        let eax = Register::EAX;
        self.push(valid(Instruction::with2(Code::And_rm32_imm32, low(WORD), ROW_MASK)));
        self.push(valid(Instruction::with2(Code::Mov_r32_rm32, eax, places.last)));
        self.push(valid(Instruction::with2(Code::Sub_rm32_imm32, eax, fold.row_words)));
        self.push(valid(Instruction::with2(Code::Cmp_r32_rm32, low(WORD), eax)));
        self.push(valid(Instruction::with2(Code::Cmova_r32_rm32, low(WORD), eax)));
        let row = MemoryOperand::new(TABLE, WORD, 4, 0, 0, false, Register::None);
        self.push(valid(Instruction::with2(Code::Lea_r64_m, NUMBERS, row)));
    }

    /// Keeps the address of the values that wait within them: the greatest, or the least, is at this offset.
    fn limit_waiting(&mut self, places: &Places, offset: u32, if_beyond: Code) {
        let limit = memory(FRAME, places.waiting + offset);
        self.push(valid(Instruction::with2(Code::Lea_r64_m, Register::RAX, limit)));
        self.push(valid(Instruction::with2(Code::Cmp_r64_rm64, WAITING, Register::RAX)));
        self.push(valid(Instruction::with2(if_beyond, WAITING, Register::RAX)));
    }

    fn copy_value(&mut self, to: MemoryOperand, from: MemoryOperand, bytes: u32) {
        let (scratch, step) = (self.isa.scratch, self.isa.vector_bytes());
        for offset in (0..bytes).step_by(step as usize) {
            let at = |place: MemoryOperand| memory(place.base, place.displacement as u32 + offset);
            self.push(valid(Instruction::with2(self.isa.load, scratch, at(from))));
            self.push(valid(Instruction::with2(self.isa.store, at(to), scratch)));
        }
    }

    /// Calls the function whose number, from `first`, is in the register: by halves.
    fn call_function(&mut self, functions: &[usize], first: u32) {
        match functions {
            [] => {}
            &[only] => {
                let target = self.assembly.functions[only].expect("callees come first");
                self.push(valid(Instruction::with_branch(Code::Call_rel32_64, target as u64 + 1)));
            }
            all => {
                let (lower, upper) = all.split_at(all.len() / 2);
                let middle = first + lower.len() as u32;
                self.push(valid(Instruction::with2(Code::Cmp_rm32_imm8, low(FUNCTION), middle)));
                let is_upper = self.jump(Code::Jae_rel32_64);
                self.call_function(lower, first);
                let done = self.jump(Code::Jmp_rel32_64);
                self.land([is_upper]);
                self.call_function(upper, middle);
                self.land([done]);
            }
        }
    }

    fn keep_results(&mut self, fold: &FoldStep, places: &Places) {
        let (scratch, other, bytes) = (self.isa.scratch, self.isa.scratch_2, self.isa.packet_bytes());
        for place in 0..fold.width() {
            self.for_each_vector(|this| {
                let (from, to) = (places.below + bytes * place, places.results + bytes * place);
                let (from, to) = (this.in_packet(FRAME, from), this.in_packet(FRAME, to));
                let lanes = this.in_packet(FRAME, places.lanes);
                this.push(valid(Instruction::with2(this.isa.load, scratch, from)));
                if this.isa.has_masks() {
                    this.push(valid(Instruction::with2(Code::VEX_Kmovw_kr_km16, MASK_SCRATCH, lanes)));
                    let mut store = valid(Instruction::with2(this.isa.store, to, scratch));
                    store.set_op_mask(MASK_SCRATCH);
                    this.push(store);
                } else {
                    this.push(valid(Instruction::with2(this.isa.load, other, to)));
                    let mask = this.isa.word_mask();
                    this.push(valid(Instruction::with2(this.isa.load, mask, lanes)));
                    let code = Code::VEX_Vblendvps_ymm_ymm_ymmm256_ymm;
                    this.push(valid(Instruction::with4(code, other, other, scratch, mask)));
                    this.push(valid(Instruction::with2(this.isa.store, to, other)));
                }
            });
        }
    }
}
