//! Kernel source of a picture: its recorded steps, generated as code inside `kernel.cu`.

use std::fmt::Write;
use std::ops::Range;
use std::sync::Arc;

use scene::cells::{BLOCK_CELLS, BOX_LEVELS, BOX_NUMBERS, Division, ROUNDING};
use scene::real::list::{IS_LAST, IS_UNARY, NO_LEAF, ROW_BITS, ROW_MASK};
use scene::real::{INDEX_BITS, Table};
use scene::sample_count::BATCH;
use scene::transport::Transport;
use scene::{Exposure, ImageSpec, Integrator, JobAtFrame};
use tape::{InvalidTape, record};

use super::launches::BLOCK_GROUP;
use super::paths::{self, PathSource};
use crate::cells::FastBuilder;
use crate::picture_tape::{accumulate, finish};

const KERNEL_TEMPLATE: &str = include_str!("kernel.cu");
/// The kernel that renders: sample by sample, or paths in loops of its own.
const SAMPLES: &str = include_str!("samples.cu");
const PATHS: &str = include_str!("paths.cu");
const CELLS: &str = include_str!("cells.cu");
const MEASURE: &str = include_str!("measure.cu");
const DIVIDE: &str = include_str!("divide.cu");
/// Line before the kernels of [`KernelSource::division`] that divide cells.
pub const DIVISION_POINT: &str = "// ---- the division of cells ----\n";
/// Maximum number of samples of a pixel that neighboring threads render together.
pub(super) const MAX_SAMPLES_TOGETHER: u32 = 4;
const INSERTION_POINT: &str = "// ---- the picture ----\n";

/// Input of a GPU render of a frame.
#[derive(Clone, Debug)]
pub struct KernelSource {
    /// Kernel source; the same for all frames, and for all values of a scene's numbers.
    pub text: Arc<str>,
    /// Values of the scene's numbers at the frame, which the kernel calls `uniforms`, as bits.
    pub parameters: Vec<u32>,
    /// The samples of a pixel that are taken with these values, in each round.
    pub(super) samples: Vec<Range<u32>>,
    /// Source of the kernels that divide the scene's cells, if it has any; the same for most scenes.
    pub division: Option<String>,
    /// Words that the kernel reads by computed indices, if there are any. It asks for those that are missing.
    pub table: Option<Table>,
    /// Samples of a pixel that neighboring threads render together.
    pub(super) together: u32,
    /// Number of statements of the integrator's steps.
    pub statements: usize,
    /// Operations on numbers for one evaluation of the scene's distance; `None` if that varies.
    pub distance_operations: Option<u64>,
}

impl KernelSource {
    /// Kernel source of a job's frame. Fails if its recorded formulas are invalid.
    pub fn new(at_frame: &JobAtFrame<'_>) -> Result<Self, InvalidTape> {
        let samples = at_frame.image().rounds();
        let together = samples_together(at_frame, &samples);
        Self::build(at_frame, samples, together, FastBuilder::UNLIMITED)
    }

    /// Kernel sources of the instants of a frame, all with the same text. `together` neighboring threads
    /// render a pixel's samples, or as many as is best.
    pub(super) fn of_exposure(
        exposure: &Exposure<'_>,
        together: Option<u32>,
        builder: FastBuilder,
    ) -> Result<Vec<Self>, InvalidTape> {
        let rounds = exposure.samples();
        let together = together.unwrap_or_else(|| samples_together(exposure.last(), &rounds.concat()));
        let mut sources: Vec<Self> = Vec::with_capacity(exposure.instants.len());
        for (index, at_frame) in exposure.instants.iter().enumerate() {
            let samples = rounds.iter().map(|round| round[index].clone()).collect();
            let mut source = Self::build(at_frame, samples, together, builder)?;
            if let Some(first) = sources.first().filter(|first| first.text == source.text) {
                source.text = first.text.clone();
            }
            sources.push(source);
        }
        Ok(sources)
    }

    /// Kernel source in which neighboring threads render `together` samples of a pixel: a power of two that divides the
    /// number of samples.
    pub(super) fn build(
        at_frame: &JobAtFrame<'_>,
        samples: Vec<Range<u32>>,
        together: u32,
        builder: FastBuilder,
    ) -> Result<Self, InvalidTape> {
        let image = at_frame.image();
        let integrator = Integrator::of_picture(at_frame, &builder);
        let mut of_paths = None;
        let tape = record(|recording| {
            of_paths = paths::record_steps(recording, &integrator, image.film().sum_channels());
            if of_paths.is_none() {
                accumulate(recording, &integrator, image);
            }
            finish(recording, &integrator, image);
        });
        let steps = tape.to_c()?;
        let (before, after) =
            KERNEL_TEMPLATE.split_once(INSERTION_POINT).expect("kernel.cu has a place for the picture");
        let numbers = tape.uniforms().len().max(1);
        let (has_layers, write_layers) = layers(image);
        let parts = parts_of_light(image) + &batches(image);
        let division = tape.table().and_then(|table| table.division());
        let (has_table, measure) = division.map(|_| (cell_constants(), [CELLS, MEASURE].concat())).unwrap_or_default();
        let (sizes, render) = match of_paths {
            Some(PathSource { sizes, functions }) => (sizes, functions + PATHS),
            None => (String::new(), SAMPLES.to_owned()),
        };
        Ok(Self {
            text: format!(
                "#define UNIFORM_COUNT {numbers}\n#define TOGETHER {together}u\n#define BLOCK_GROUP {BLOCK_GROUP}u\n\
                {sizes}{has_table}{parts}{has_layers}{before}{}{write_layers}{after}{render}{measure}",
                steps.code
            )
            .into(),
            samples,
            parameters: tape.uniforms().to_vec(),
            division: division.map(|division| division_source(before, division)),
            table: tape.table().cloned(),
            together,
            statements: steps.statements,
            distance_operations: tape.flops_per_call("distance"),
        })
    }
}

/// How many of a pixel's samples are best rendered together by neighboring threads. With paths, a thread renders all
/// samples of its pixel, so that it goes on with the next one as soon as a path has ended.
fn samples_together(at_frame: &JobAtFrame<'_>, ranges: &[Range<u32>]) -> u32 {
    let common = ranges.iter().map(|range| range.len().trailing_zeros()).min().unwrap_or(0);
    match at_frame.scene().integrator {
        Transport::Path(_) => 1,
        Transport::Direct => (1 << common).min(MAX_SAMPLES_TOGETHER),
    }
}

/// Source of the kernels that divide cells, after the arithmetic.
fn division_source(arithmetic: &str, division: &Division) -> String {
    // Powers of two, so that few programs serve all scenes.
    let depth = division.depth.next_power_of_two().max(8);
    let constants = cell_constants();
    format!(
        "#define DIVIDES_CELLS\n#define UNIFORM_COUNT 1\n{constants}{arithmetic}{CELLS}{DIVISION_POINT}\
        #define LIST_DEPTH {depth}u\n{DIVIDE}"
    )
}

/// The constants of cells.
fn cell_constants() -> String {
    let numbers = [("EPSILON", f32::EPSILON), ("MIN_POSITIVE", f32::MIN_POSITIVE), ("INFINITE", f32::INFINITY)];
    let numbers = numbers.into_iter().chain([("ROUNDING", ROUNDING)]);
    let words = [
        ("BLOCK_CELLS", BLOCK_CELLS),
        ("ROW_BITS", ROW_BITS),
        ("ROW_MASK", ROW_MASK),
        ("NO_LEAF", NO_LEAF),
        ("IS_LAST", IS_LAST),
        ("IS_UNARY", IS_UNARY),
        ("KIND_SHIFT", INDEX_BITS),
        ("BOX_LEVELS", BOX_LEVELS),
        ("BOX_NUMBERS", BOX_NUMBERS as u32),
    ];
    let mut defines = "#define HAS_TABLE\n".to_owned();
    for (name, number) in numbers {
        let _ = writeln!(defines, "#define {name} float_from_bits({}u)", number.to_bits());
    }
    for (name, word) in words {
        let _ = writeln!(defines, "#define {name} {word}u");
    }
    defines
}

/// The number of planes of light, and what its parts, by light groups and by brightness, add to lists of a sum's numbers.
fn parts_of_light(image: &ImageSpec) -> String {
    let planes = image.film().sum_channels();
    if planes == 4 {
        return format!("#define LIGHT_PLANES {planes}\n#define PARTS_OF(sum)\n#define PARTS_FROM(result, after)\n");
    }
    let (mut given, mut taken) = (String::new(), Vec::new());
    for plane in 4..planes {
        let _ = write!(given, ", (sum).parts[{}]", plane - 4);
        taken.push(format!("(result).f{plane} after"));
    }
    format!(
        "#define LIGHT_PLANES {planes}\n#define PART_PLANES {}\n#define PARTS_OF(sum) {given}\n\
        #define PARTS_FROM(result, after) , {{ {} }}\n",
        planes - 4,
        taken.join(", ")
    )
}

/// The samples of a batch, and the first plane of the sums of those that have ended, if a picture has several.
fn batches(image: &ImageSpec) -> String {
    let plane = batches_plane(image).map(|plane| format!("#define BATCHES_PLANE {plane}u\n"));
    format!("#define BATCH {BATCH}u\n{}", plane.unwrap_or_default())
}

/// Index of the first plane of the sums of ended batches, which follow the rendered channels; `None` if there is one batch.
pub(super) fn batches_plane(image: &ImageSpec) -> Option<usize> {
    (image.samples.max() > BATCH).then(|| image.film().rendered_channels().len())
}

/// Number of planes of a picture's tiles on a GPU.
pub(super) fn device_planes(image: &ImageSpec) -> usize {
    image.film().rendered_channels().len() + batches_plane(image).map_or(0, |_| image.film().sum_channels())
}

/// Source before and after the steps if the job requests layers: the define that enables them, and the function
/// that writes them.
fn layers(image: &ImageSpec) -> (String, String) {
    let count = image.film().rendered_channels().len() - image.film().sum_channels();
    if count == 0 {
        return (String::new(), String::new());
    }
    let mut writer =
        "INLINE_FN void write_layers(const layers_result& seen, float* out, unsigned long long stride) {\n".to_owned();
    for plane in 0..count {
        let _ = writeln!(writer, "    out[{plane} * stride] = seen.f{plane} + 0.0f;");
    }
    (format!("#define AOV_PLANES {count}\n"), writer + "}\n\n")
}
