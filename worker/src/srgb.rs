//! Linear light to sRGB for whole rows, with the widest vectors of this CPU; bit-identical to
//! [`DisplayTransform::apply`] and [`srgb_from_linear`].

use fearless_simd::{Level, Simd as Token};
use scene::color::{DisplayTransform, srgb_from_linear};

use crate::lanes::Lanes;
use crate::simd::with_instructions;

/// Applies the display transform and the sRGB curve to linear values in place; results are 0 to 1.
pub fn encode(values: &mut [f32], grade: DisplayTransform) {
    with_instructions!(Level::new(), token, N => encode_with::<_, N>(token, values, grade));
}

#[inline(always)]
fn encode_with<S: Token, const N: usize>(token: S, values: &mut [f32], grade: DisplayTransform) {
    let count = Lanes::<S, N>::COUNT;
    let mut chunks = values.chunks_exact_mut(count);
    for chunk in &mut chunks {
        srgb_from_linear(grade.apply(Lanes::<S, N>::load(token, chunk))).store(chunk);
    }
    for value in chunks.into_remainder() {
        *value = srgb_from_linear(grade.apply(*value));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_vector_width_gives_the_reference_bits() {
        let linear: Vec<f32> = (0..100_003).map(|i| (i as f32 - 10.0) / 90_000.0).collect();
        for (stops, tone_map) in [("0", "none"), ("-1.3", "none"), ("2", "filmic")] {
            let image = format!(r#"{{ "width": 1, "height": 1, "exposure": {stops}, "tone_map": "{tone_map}" }}"#);
            let grade = DisplayTransform::new(&serde_json::from_str(&image).unwrap());
            let want: Vec<u32> = linear.iter().map(|&v| srgb_from_linear(grade.apply(v)).to_bits()).collect();
            let mut got = linear.clone();
            encode(&mut got, grade);
            assert!(got.iter().map(|v| v.to_bits()).eq(want), "{stops} stops, {tone_map}");
        }
    }
}
