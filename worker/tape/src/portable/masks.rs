//! Lanes in a mask.

use super::arithmetic::LANES;
use super::{Operand, Run};

impl Run<'_> {
    /// Whether a lane is in the mask.
    #[inline(always)]
    pub(super) fn has_lane(&self, mask: Operand) -> bool {
        match mask {
            Operand::Slot(slot) => self.frame.slots[slot].0.iter().fold(0, |any, lane| any | lane) != 0,
            Operand::Input(index) => self.frame.inputs[index] != 0,
        }
    }

    /// Number of lanes in the mask.
    #[inline(always)]
    pub(super) fn lane_count(&self, mask: Operand) -> u32 {
        match mask {
            Operand::Slot(slot) => self.frame.slots[slot].0.iter().map(|&lane| u32::from(lane != 0)).sum(),
            Operand::Input(index) => LANES as u32 * u32::from(self.frame.inputs[index] != 0),
        }
    }
}
