//! Linear light to sRGB for whole rows; bit-identical to [`DisplayTransform::apply`] and [`srgb_from_linear`].

use scene::color::{DisplayTransform, srgb_from_linear};

use crate::CancelFlag;
use crate::cpu::{Evaluator, Inputs};
use crate::tape::{InvalidTape, Tape, record};

const ENCODE: &str = "encode";

/// Display transform and sRGB curve, compiled.
#[derive(Debug)]
pub struct SrgbEncoder {
    evaluator: Evaluator,
    inputs: Inputs,
}

impl SrgbEncoder {
    /// Compiles the transform. Fails if it was recorded wrongly.
    pub fn new(grade: DisplayTransform) -> Result<Self, InvalidTape> {
        let tape = tape(grade);
        let evaluator = Evaluator::fastest(&tape)?;
        Ok(Self { inputs: evaluator.inputs(&tape), evaluator })
    }

    /// Applies the display transform and the sRGB curve to linear values in place; results are 0 to 1.
    pub fn encode(&self, values: &mut [f32]) {
        let (mut frame, cancel) = (self.evaluator.frame(), CancelFlag::new());
        let mut linear = values.to_vec();
        linear.resize(values.len().next_multiple_of(self.evaluator.lanes()), 0.0);
        let mut encoded = vec![0.0; linear.len()];
        self.evaluator.run(ENCODE, &mut frame, &self.inputs, cancel.flag(), &linear, &mut encoded);
        values.copy_from_slice(&encoded[..values.len()]);
    }
}

fn tape(grade: DisplayTransform) -> Tape {
    record(|recording| recording.entry(ENCODE, |[linear]| vec![srgb_from_linear(grade.apply(linear))]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Simd;

    #[test]
    fn every_level_gives_the_reference_bits() {
        let linear: Vec<f32> = (0..100_003).map(|i| (i as f32 - 10.0) / 90_000.0).collect();
        for (stops, tone_map) in [("0", "none"), ("-1.3", "none"), ("2", "filmic")] {
            let image = format!(r#"{{ "width": 1, "height": 1, "exposure": {stops}, "tone_map": "{tone_map}" }}"#);
            let grade = DisplayTransform::new(&serde_json::from_str(&image).unwrap());
            let want: Vec<u32> = linear.iter().map(|&v| srgb_from_linear(grade.apply(v)).to_bits()).collect();
            for simd in Simd::LEVELS.into_iter().filter(|simd| simd.is_available()) {
                let mut got = linear.clone();
                let tape = tape(grade);
                let evaluator = Evaluator::new(&tape, simd).unwrap();
                let inputs = evaluator.inputs(&tape);
                SrgbEncoder { evaluator, inputs }.encode(&mut got);
                let is_equal = got.iter().zip(&want).all(|(got, want)| (got + 0.0).to_bits() == *want);
                assert!(is_equal, "{stops} stops, {tone_map}, {simd}");
            }
        }
    }
}
