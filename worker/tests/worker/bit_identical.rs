//! Bit-identical output in one process: every shipped job, as a PNG and as a float EXR with all layers, has the
//! same bytes as from scalar code for all vector instructions, tiles, numbers of threads, and runs.
//!
//! `tests/bit_identical.rs` tests a few of them end to end, with `render` and with farms.

use std::io::Cursor;

use scene::Job;
use worker::frame::render_frame;
use worker::{CancelFlag, CpuRenderer, Simd};

use crate::lanes::levels;
use crate::shipped::{Shipped, few, large, shipped};

/// Wider than any picture.
const WHOLE: u32 = 65535;
const SAMPLES: u32 = 2;
/// Size of the pictures in every run of the tests.
const SMALL_PX: u32 = 40;
/// Size of the pictures in the long tests.
const LARGE_PX: u32 = 128;

/// Way to render, which must not affect the picture.
struct Way {
    name: String,
    renderer: CpuRenderer,
    /// Edge of its tiles; `None` means as a server would cut them.
    tile_px: Option<u32>,
}

impl Way {
    fn new(simd: Simd, threads: usize, tile_px: Option<u32>) -> Self {
        let name = format!("{simd}, {threads} threads, tiles of {tile_px:?}");
        Self { name, renderer: CpuRenderer::new(Some(threads), simd).expect("a level of this CPU"), tile_px }
    }

    fn picture(&self, job: &Job) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        render_frame(
            &self.renderer,
            job,
            0,
            self.tile_px,
            &std::env::temp_dir(),
            &mut out,
            &CancelFlag::new(),
            &|_| (),
        )
        .unwrap_or_else(|error| panic!("{}: {error}", self.name));
        out.into_inner()
    }
}

/// Every level, whole by one thread; and the best one in tiles, by three threads.
fn levels_and_tiles() -> Vec<Way> {
    let vectors = levels().filter(|&level| level != Simd::Scalar).map(|level| Way::new(level, 1, Some(WHOLE)));
    vectors.chain([Way::new(Simd::Auto, 3, Some(32))]).collect()
}

/// Also other tiles, numbers of threads, and a second run.
fn all_ways() -> Vec<Way> {
    let best = [(1, None), (3, None), (2, Some(256)), (1, Some(WHOLE))];
    let best = best.map(|(threads, tile_px)| Way::new(Simd::Auto, threads, tile_px));
    levels_and_tiles().into_iter().chain(best).collect()
}

/// Compares jobs, converted by `form`, over these ways.
fn assert_same(ways: &[Way], scenes: Vec<Shipped>, form: impl Fn(&Shipped) -> Job) {
    let reference = Way::new(Simd::Scalar, 1, Some(WHOLE));
    let mut wrong = Vec::new();
    for shipped in scenes {
        let job = form(&shipped);
        let want = reference.picture(&job);
        let different = ways.iter().filter(|way| way.picture(&job) != want);
        wrong.extend(different.map(|way| format!("{} by {}", shipped.name, way.name)));
    }
    assert!(wrong.is_empty(), "bytes differ from scalar code:\n{}", wrong.join("\n"));
}

#[test]
fn small_pngs_of_few_scenes_are_bit_identical_to_scalar_code() {
    assert_same(&all_ways(), few(), |shipped| shipped.png(SMALL_PX, SAMPLES));
}

#[test]
fn small_exrs_are_bit_identical_to_scalar_code() {
    assert_same(&levels_and_tiles(), shipped(), |shipped| shipped.exr(SMALL_PX, SAMPLES));
}

#[test]
#[ignore = "long: every shipped scene, larger, in all ways; 2 minutes"]
fn larger_pngs_are_bit_identical_to_scalar_code() {
    assert_same(&all_ways(), shipped(), |shipped| shipped.png(LARGE_PX, SAMPLES));
}

#[test]
#[ignore = "long: every shipped scene, larger, in all ways; 2 minutes"]
fn larger_exrs_are_bit_identical_to_scalar_code() {
    assert_same(&all_ways(), shipped(), |shipped| shipped.exr(LARGE_PX, SAMPLES));
}

#[test]
#[ignore = "long: scenes of thousands of shapes in all ways; 45 s"]
fn large_scenes_are_bit_identical_to_scalar_code() {
    assert_same(&all_ways(), large(), |shipped| shipped.exr(SMALL_PX, 1));
}
