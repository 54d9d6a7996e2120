//! Reproducible random numbers: `SplitMix64` (Steele, Lea, Flood, "Fast splittable pseudorandom number generators",
//! OOPSLA 2014).

/// Increment of the state: 2⁶⁴ divided by the golden ratio.
const INCREMENT: u64 = 0x9e37_79b9_7f4a_7c15;

/// Generator with a seed.
#[derive(Clone, Debug)]
pub(super) struct Random(u64);

impl Random {
    /// Generator of this seed.
    pub(super) fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Next number, from 0 to below 1.
    pub(super) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(INCREMENT);
        fraction(self.0)
    }
}

/// Number from 0 to below 1 that depends on these numbers only.
pub(super) fn hashed_unit(numbers: [u64; 3]) -> f64 {
    let folded = numbers.iter().fold(0_u64, |hash, number| mix(hash.wrapping_add(INCREMENT) ^ number));
    fraction(folded)
}

fn fraction(bits: u64) -> f64 {
    (mix(bits) >> 11) as f64 / (1_u64 << 53) as f64
}

fn mix(bits: u64) -> u64 {
    let bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}
