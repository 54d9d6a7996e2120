//! Linear light to sRGB for whole rows; bit-identical to [`DisplayTransform::apply`], [`srgb_from_linear`] and
//! [`level_of_256`].

use scene::color::{level_of_256, srgb_from_linear};
use scene::film::DisplayTransform;
use scene::sampling::thresholds;
use tape::{Evaluator, Frame, Inputs, InvalidTape, Tape, record};

use crate::CancelFlag;

const ENCODE: &str = "encode";
const DITHER: &str = "dither";
/// Rows that `DITHER` takes: three colors, and the pixels' columns and rows.
const DITHER_ARGUMENTS: usize = 5;

/// Display transform and sRGB curve, compiled.
#[derive(Debug)]
pub struct SrgbEncoder {
    evaluator: Evaluator,
    inputs: Inputs,
    cancel: CancelFlag,
}

/// Memory of a thread that encodes rows.
#[derive(Debug)]
pub struct RowMemory {
    frame: Frame,
    arguments: Vec<f32>,
    results: Vec<f32>,
}

impl SrgbEncoder {
    /// Compiles the transform. Fails if it was recorded wrongly.
    pub fn new(grade: DisplayTransform) -> Result<Self, InvalidTape> {
        let tape = tape(grade);
        let evaluator = Evaluator::fastest(&tape)?;
        Ok(Self { inputs: evaluator.inputs(&tape), evaluator, cancel: CancelFlag::new() })
    }

    /// Memory for a thread that encodes rows.
    pub fn memory(&self) -> RowMemory {
        RowMemory { frame: self.evaluator.frame(), arguments: Vec::new(), results: Vec::new() }
    }

    /// Applies the display transform and the sRGB curve to linear values in place; results are 0 to 1.
    pub fn encode(&self, values: &mut [f32], memory: &mut RowMemory) {
        let length = values.len().next_multiple_of(self.evaluator.lanes());
        memory.arguments.clear();
        memory.arguments.extend_from_slice(values);
        memory.arguments.resize(length, 0.0);
        memory.results.resize(length, 0.0);
        self.run(ENCODE, memory);
        values.copy_from_slice(&memory.results[..values.len()]);
    }

    /// Replaces the linear red, green and blue of row `y`, one color after the other, by dithered levels from 0 to 255,
    /// before their fractions are truncated.
    pub fn dither(&self, colors: &mut [f32], y: u32, memory: &mut RowMemory) {
        let width = colors.len() / 3;
        let length = width.next_multiple_of(self.evaluator.lanes());
        memory.arguments.resize(DITHER_ARGUMENTS * length, 0.0);
        memory.results.resize(3 * length, 0.0);
        let (values, places) = memory.arguments.split_at_mut(3 * length);
        for (color, values) in colors.chunks_exact(width.max(1)).zip(values.chunks_exact_mut(length.max(1))) {
            values[..width].copy_from_slice(color);
        }
        let (columns, rows) = places.split_at_mut(length);
        for (x, column) in columns.iter_mut().enumerate() {
            *column = x as f32;
        }
        rows.fill(y as f32);
        self.run(DITHER, memory);
        for (color, levels) in colors.chunks_exact_mut(width.max(1)).zip(memory.results.chunks_exact(length.max(1))) {
            color.copy_from_slice(&levels[..width]);
        }
    }

    fn run(&self, entry: &str, memory: &mut RowMemory) {
        let RowMemory { frame, arguments, results } = memory;
        self.evaluator.run(entry, frame, &self.inputs, self.cancel.flag(), arguments, results);
    }
}

fn tape(grade: DisplayTransform) -> Tape {
    record(|recording| {
        recording.entry(ENCODE, |[linear]| vec![srgb_from_linear(grade.apply(linear))]);
        recording.entry(DITHER, |[red, green, blue, x, y]| {
            let [at_red, at_green, at_blue] = thresholds(x, y);
            let level = |linear, threshold| level_of_256(srgb_from_linear(grade.apply(linear)), threshold);
            vec![level(red, at_red), level(green, at_green), level(blue, at_blue)]
        });
    })
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
                let encoder = SrgbEncoder { evaluator, inputs, cancel: CancelFlag::new() };
                let mut memory = encoder.memory();
                encoder.encode(&mut got, &mut memory);
                let is_equal = got.iter().zip(&want).all(|(got, want)| (got + 0.0).to_bits() == *want);
                assert!(is_equal, "{stops} stops, {tone_map}, {simd}");
                check_levels(&encoder, grade, &linear, &mut memory);
            }
        }
    }

    /// Compares the dithered levels of rows of several widths, which share the memory, with the reference.
    fn check_levels(encoder: &SrgbEncoder, grade: DisplayTransform, linear: &[f32], memory: &mut RowMemory) {
        for (width, y) in [(1, 0), (1920, 7), (333, 70_001), (1920, 1079)] {
            let mut got: Vec<f32> = linear.iter().step_by(17).copied().take(3 * width).collect();
            let mut want = got.clone();
            for (color, values) in want.chunks_exact_mut(width).enumerate() {
                for (x, value) in values.iter_mut().enumerate() {
                    let threshold = thresholds(x as f32, y as f32)[color];
                    *value = level_of_256(srgb_from_linear(grade.apply(*value)), threshold);
                }
            }
            encoder.dither(&mut got, y, memory);
            let is_equal = got.iter().zip(&want).all(|(got, want)| (got + 0.0).to_bits() == (want + 0.0).to_bits());
            assert!(is_equal, "{width} pixels of row {y}");
        }
    }
}
