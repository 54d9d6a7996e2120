//! The two vector extensions: their registers, and the code of each operation on a whole vector.

use iced_x86::{Code, Register};

use crate::tape::Registers;

/// A vector extension of x86-64.
#[derive(Debug)]
pub(crate) struct Isa {
    /// Lanes of a packet.
    pub(crate) lanes: usize,
    /// Vectors of a packet: one or two. Each step is emitted for one after the other, so that one computes while another waits.
    pub(super) vectors: u32,
    /// Groups of registers, one for each vector of a packet, that variables may have: all vectors but the last two,
    /// k1 to k6.
    pub(super) registers: Registers,
    pub(super) first: Register,
    pub(super) scratch: Register,
    pub(super) scratch_2: Register,
    /// Also loads from memory.
    pub(super) load: Code,
    pub(super) store: Code,
    /// From addresses of any alignment.
    pub(super) load_unaligned: Code,
    pub(super) store_unaligned: Code,
    pub(super) add: Code,
    pub(super) sub: Code,
    pub(super) mul: Code,
    pub(super) div: Code,
    pub(super) min: Code,
    pub(super) max: Code,
    pub(super) sqrt: Code,
    pub(super) floor: Code,
    pub(super) compare: Code,
    pub(super) add_u32: Code,
    pub(super) mul_u32: Code,
    pub(super) min_u32: Code,
    pub(super) and: Code,
    pub(super) or: Code,
    pub(super) xor: Code,
    pub(super) shift_left: Code,
    pub(super) shift_right: Code,
    /// Overwrites its first operand a: a · c + b.
    pub(super) fma132: Code,
    /// Overwrites its second factor a: b · a + c.
    pub(super) fma213: Code,
    /// Overwrites its term a: b · c + a.
    pub(super) fma231: Code,
}

impl Isa {
    /// Whether this CPU has the instructions.
    pub(crate) fn is_available(&self) -> bool {
        #[cfg(target_arch = "x86_64")]
        let is_available = is_x86_feature_detected!("popcnt")
            && if self.has_masks() {
                is_x86_feature_detected!("avx512f")
            } else {
                is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
            };
        #[cfg(not(target_arch = "x86_64"))]
        let is_available = false;
        is_available
    }

    /// Bytes of a packet's values.
    pub(super) fn packet_bytes(&self) -> u32 {
        4 * self.lanes as u32
    }

    /// Bytes of a vector.
    pub(super) fn vector_bytes(&self) -> u32 {
        self.packet_bytes() / self.vectors
    }

    /// Groups of registers for the variables of a program. With AVX2, words of a table take a register for their mask.
    pub(super) fn registers_of(&self, has_table: bool) -> Registers {
        let taken = u8::from(has_table && !self.has_masks());
        Registers { vectors: self.registers.vectors - taken, ..self.registers }
    }

    /// The register that variables of such a program have not, with AVX2.
    pub(super) fn word_mask(&self) -> Register {
        self.vector(self.registers.vectors - 1, 0)
    }

    /// Place of the table's address, after the uniforms.
    pub(super) fn table_address_at(&self, uniforms: usize) -> usize {
        self.input_bytes(uniforms).next_multiple_of(size_of::<usize>())
    }

    /// Words in which the code expects each constant and uniform.
    pub(super) fn copies(&self) -> usize {
        if self.has_masks() { 1 } else { self.lanes }
    }

    /// Bytes of constants or uniforms.
    pub(super) fn input_bytes(&self, words: usize) -> usize {
        4 * words * self.copies()
    }

    /// Whether masks have registers of their own, and instructions take one number for all lanes from memory.
    pub(super) fn has_masks(&self) -> bool {
        self.registers.masks > 0
    }

    /// Register of a group for one of the packet's vectors.
    pub(super) fn vector(&self, group: u8, vector: u32) -> Register {
        self.first + (u32::from(group) * self.vectors + vector)
    }

    /// Mask register of a group, from 1, for one of the packet's vectors.
    pub(super) fn mask(&self, group: u8, vector: u32) -> Register {
        Register::K1 + (u32::from(group - 1) * self.vectors + vector)
    }
}

/// AVX-512F.
pub(crate) static AVX512: Isa = Isa {
    lanes: 32,
    vectors: 2,
    registers: Registers { vectors: 15, masks: 3 },
    first: Register::ZMM0,
    scratch: Register::ZMM30,
    scratch_2: Register::ZMM31,
    load_unaligned: Code::EVEX_Vmovups_zmm_k1z_zmmm512,
    store_unaligned: Code::EVEX_Vmovups_zmmm512_k1z_zmm,
    load: Code::EVEX_Vmovaps_zmm_k1z_zmmm512,
    store: Code::EVEX_Vmovaps_zmmm512_k1z_zmm,
    add: Code::EVEX_Vaddps_zmm_k1z_zmm_zmmm512b32_er,
    sub: Code::EVEX_Vsubps_zmm_k1z_zmm_zmmm512b32_er,
    mul: Code::EVEX_Vmulps_zmm_k1z_zmm_zmmm512b32_er,
    div: Code::EVEX_Vdivps_zmm_k1z_zmm_zmmm512b32_er,
    min: Code::EVEX_Vminps_zmm_k1z_zmm_zmmm512b32_sae,
    max: Code::EVEX_Vmaxps_zmm_k1z_zmm_zmmm512b32_sae,
    sqrt: Code::EVEX_Vsqrtps_zmm_k1z_zmmm512b32_er,
    floor: Code::EVEX_Vrndscaleps_zmm_k1z_zmmm512b32_imm8_sae,
    compare: Code::EVEX_Vcmpps_kr_k1_zmm_zmmm512b32_imm8_sae,
    add_u32: Code::EVEX_Vpaddd_zmm_k1z_zmm_zmmm512b32,
    mul_u32: Code::EVEX_Vpmulld_zmm_k1z_zmm_zmmm512b32,
    min_u32: Code::EVEX_Vpminud_zmm_k1z_zmm_zmmm512b32,
    and: Code::EVEX_Vpandd_zmm_k1z_zmm_zmmm512b32,
    or: Code::EVEX_Vpord_zmm_k1z_zmm_zmmm512b32,
    xor: Code::EVEX_Vpxord_zmm_k1z_zmm_zmmm512b32,
    shift_left: Code::EVEX_Vpslld_zmm_k1z_zmmm512b32_imm8,
    shift_right: Code::EVEX_Vpsrld_zmm_k1z_zmmm512b32_imm8,
    fma132: Code::EVEX_Vfmadd132ps_zmm_k1z_zmm_zmmm512b32_er,
    fma213: Code::EVEX_Vfmadd213ps_zmm_k1z_zmm_zmmm512b32_er,
    fma231: Code::EVEX_Vfmadd231ps_zmm_k1z_zmm_zmmm512b32_er,
};

/// AVX2 and FMA.
pub(crate) static AVX2: Isa = Isa {
    lanes: 8,
    vectors: 1,
    registers: Registers { vectors: 14, masks: 0 },
    first: Register::YMM0,
    scratch: Register::YMM14,
    scratch_2: Register::YMM15,
    load_unaligned: Code::VEX_Vmovups_ymm_ymmm256,
    store_unaligned: Code::VEX_Vmovups_ymmm256_ymm,
    load: Code::VEX_Vmovaps_ymm_ymmm256,
    store: Code::VEX_Vmovaps_ymmm256_ymm,
    add: Code::VEX_Vaddps_ymm_ymm_ymmm256,
    sub: Code::VEX_Vsubps_ymm_ymm_ymmm256,
    mul: Code::VEX_Vmulps_ymm_ymm_ymmm256,
    div: Code::VEX_Vdivps_ymm_ymm_ymmm256,
    min: Code::VEX_Vminps_ymm_ymm_ymmm256,
    max: Code::VEX_Vmaxps_ymm_ymm_ymmm256,
    sqrt: Code::VEX_Vsqrtps_ymm_ymmm256,
    floor: Code::VEX_Vroundps_ymm_ymmm256_imm8,
    compare: Code::VEX_Vcmpps_ymm_ymm_ymmm256_imm8,
    add_u32: Code::VEX_Vpaddd_ymm_ymm_ymmm256,
    mul_u32: Code::VEX_Vpmulld_ymm_ymm_ymmm256,
    min_u32: Code::VEX_Vpminud_ymm_ymm_ymmm256,
    and: Code::VEX_Vandps_ymm_ymm_ymmm256,
    or: Code::VEX_Vorps_ymm_ymm_ymmm256,
    xor: Code::VEX_Vxorps_ymm_ymm_ymmm256,
    shift_left: Code::VEX_Vpslld_ymm_ymm_imm8,
    shift_right: Code::VEX_Vpsrld_ymm_ymm_imm8,
    fma132: Code::VEX_Vfmadd132ps_ymm_ymm_ymmm256,
    fma213: Code::VEX_Vfmadd213ps_ymm_ymm_ymmm256,
    fma231: Code::VEX_Vfmadd231ps_ymm_ymm_ymmm256,
};
