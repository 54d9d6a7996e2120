//! Linear light to sRGB for whole rows, by the widest vectors of this CPU; the bits are those of
//! [`scene::color::srgb_from_linear`], whatever the vectors.

use fearless_simd::{Level, Simd as Token};
use scene::color::srgb_from_linear;

use crate::lanes::Lanes;
use crate::simd::with_instructions;

/// Turns linear light into sRGB values, 0 to 1, in place.
pub fn encode(values: &mut [f32]) {
    with_instructions!(Level::new(), token, N => encode_with::<_, N>(token, values));
}

#[inline(always)]
fn encode_with<S: Token, const N: usize>(token: S, values: &mut [f32]) {
    let count = Lanes::<S, N>::COUNT;
    let mut chunks = values.chunks_exact_mut(count);
    for chunk in &mut chunks {
        srgb_from_linear(Lanes::<S, N>::load(token, chunk)).store(chunk);
    }
    for value in chunks.into_remainder() {
        *value = srgb_from_linear(*value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_vector_width_gives_the_reference_bits() {
        let linear: Vec<f32> = (0..100_003).map(|i| (i as f32 - 10.0) / 90_000.0).collect();
        let want: Vec<u32> = linear.iter().map(|&v| srgb_from_linear(v).to_bits()).collect();
        let mut got = linear;
        encode(&mut got);
        assert!(got.iter().map(|v| v.to_bits()).eq(want));
    }
}
