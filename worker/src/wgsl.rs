//! The program of an approximate picture, for a browser's GPU: a frame's recorded formulas in WGSL, and their inputs.
//!
//! Its pictures differ from the reference by rounding, so they are shown and never stored.

use std::time::{Duration, Instant};

use scene::JobAtFrame;
use tape::InvalidTape;

use crate::cells::FastBuilder;
use crate::picture_tape::record_shown_picture;

const TEMPLATE: &str = include_str!("wgsl/picture.wgsl");
const INSERTION_POINT: &str = "// ---- the picture ----\n";

/// Maximum number of words of a whole scene: what a browser is sent for each change of a number, as digits.
const MAX_WORDS: usize = 1 << 21;
/// Number of words that cells may take, beyond the whole scene's. A cell that is not divided has the list of the cell
/// around it.
const WORDS_OF_CELLS: usize = 1 << 19;
/// Maximum size of the program: browsers take seconds to compile a MiB, and gigabytes of memory for some.
const MAX_TEXT_BYTES: usize = 2 << 20;
/// Maximum time for dividing cells.
const DIVISION_TIME: Duration = Duration::from_secs(1);

/// Program of an approximate picture, and its inputs.
#[derive(Clone, Debug)]
pub struct Shader {
    /// Text of the program: the same for all frames, sizes, and values of a scene's numbers.
    pub text: String,
    /// Values of the scene's numbers at the frame, by their bits.
    pub numbers: Vec<u32>,
    /// Words that the program reads by computed indices; none if it reads none.
    pub words: Vec<u32>,
}

/// Error returned when a frame has no program.
#[derive(Debug, thiserror::Error)]
pub enum ShaderError {
    /// Its recorded formulas are invalid.
    #[error(transparent)]
    Invalid(#[from] InvalidTape),
    /// Its table is too large.
    #[error("the shapes of the scene take {} MiB, and a browser is sent at most {} MiB: scatter fewer", .0.div_ceil(1 << 18), MAX_WORDS >> 18)]
    ManyShapes(usize),
    /// Its formulas are too long.
    #[error("the program of the scene has {} KiB, and a browser is sent at most {}: use fewer nodes and textures", .0 >> 10, MAX_TEXT_BYTES >> 10)]
    LongText(usize),
}

impl Shader {
    /// Program of a job's frame.
    pub fn new(at_frame: &JobAtFrame<'_>) -> Result<Self, ShaderError> {
        let tape = record_shown_picture(at_frame, &FastBuilder::UNLIMITED);
        let words = match tape.table() {
            None => Vec::new(),
            Some(table) if table.used() > MAX_WORDS => return Err(ShaderError::ManyShapes(table.used())),
            Some(table) => {
                let (start, most) = (Instant::now(), table.used() + WORDS_OF_CELLS);
                table.make_until(&|| table.used() > most || start.elapsed() > DIVISION_TIME);
                table.after(0)
            }
        };
        let (code, numbers) = (tape.to_wgsl()?.code, tape.finite_uniforms());
        let (before, after) = TEMPLATE.split_once(INSERTION_POINT).expect("picture.wgsl has a place for the picture");
        let text = format!(
            "const NUMBER_COUNT = {}u;\nconst IS_TRANSPARENT = {};\n{before}{code}{after}",
            numbers.len().max(1),
            at_frame.scene().is_transparent()
        );
        if text.len() > MAX_TEXT_BYTES {
            return Err(ShaderError::LongText(text.len()));
        }
        Ok(Self { text, numbers, words })
    }
}
