//! Packets: a block of neighboring pixels rendered together, one per lane.

use fearless_simd::{Level, Simd as Token};
use scene::integrator::Radiance;
use scene::real::{Real, vec3};
use scene::{Image, Integrator, Layer};

use crate::RenderError;
use crate::lanes::Lanes;
use crate::simd::{Simd, with_instructions};

/// Samples of a packet's pixels that are summed between two reports of progress.
const SAMPLES_PER_RUN: u32 = 64;

/// Renders packets with one CPU's vector instructions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packets(Level);

/// State shared by all packets of a band.
struct PacketRows<'a, 'b> {
    program: &'a Integrator<'a>,
    image: &'a Image,
    left: u32,
    top: u32,
    width: usize,
    planes: Vec<&'b mut [f32]>,
    progress: &'a (dyn Fn(u64) + Sync),
}

impl Packets {
    /// Packets with these instructions, if this CPU has them.
    pub(crate) fn new(simd: Simd) -> Result<Self, RenderError> {
        simd.level().map(Self)
    }

    /// The vector instructions in use.
    pub(crate) fn level(self) -> Level {
        self.0
    }

    /// Rows of a packet's block.
    pub(crate) fn block_rows(self) -> u32 {
        with_instructions!(self.0, token, N => block::<_, N>(token).1) as u32
    }

    /// Number of evaluations of the scene's distance for a row of pixels.
    pub(crate) fn evaluations(self, program: &Integrator<'_>, left: u32, row: u32, width: usize) -> u64 {
        with_instructions!(self.0, token, N => row_evaluations::<_, N>(token, program, left, row, width))
    }

    /// Renders the rows of a band that starts in column `left` and row `top`. `progress` receives the number of newly
    /// finished rays.
    #[expect(clippy::too_many_arguments, reason = "the parts of one band")]
    pub(crate) fn band(
        self,
        program: &Integrator<'_>,
        image: &Image,
        left: u32,
        top: u32,
        width: usize,
        planes: Vec<&mut [f32]>,
        progress: &(dyn Fn(u64) + Sync),
    ) {
        let mut band = PacketRows { program, image, left, top, width, planes, progress };
        with_instructions!(self.0, token, N => band.render::<_, N>(token));
    }
}

/// Columns and rows of a packet's block: as square as its lanes allow.
#[inline(always)]
fn block<S: Token, const N: usize>(_: S) -> (usize, usize) {
    let lanes = Lanes::<S, N>::COUNT;
    let columns = 1 << (lanes.ilog2().div_ceil(2));
    (columns, lanes / columns)
}

#[inline(always)]
fn row_evaluations<S: Token, const N: usize>(
    token: S,
    program: &Integrator<'_>,
    left: u32,
    row: u32,
    width: usize,
) -> u64 {
    let count = Lanes::<S, N>::COUNT;
    let mut buffer = [0.0; 64];
    let mut sum = 0;
    for column in (0..width).step_by(count) {
        let x = Lanes::<S, N>::from_fn(
            token,
            #[inline(always)]
            |lane| (left as usize + column + lane) as f32,
        );
        let y = Lanes::<S, N>::from_fn(
            token,
            #[inline(always)]
            |_| row as f32,
        );
        program.pixel(x, y).evaluations.store(&mut buffer);
        sum += buffer[..count.min(width - column)].iter().map(|&n| n as u64).sum::<u64>();
    }
    sum
}

impl PacketRows<'_, '_> {
    #[inline(always)]
    fn render<S: Token, const N: usize>(&mut self, token: S) {
        let (columns, _) = block::<_, N>(token);
        for column in (0..self.width).step_by(columns) {
            self.packet::<_, N>(token, column);
        }
    }

    /// Renders the block that starts in `column` of the band.
    #[inline(always)]
    fn packet<S: Token, const N: usize>(&mut self, token: S, column: usize) {
        let (left, top) = (self.left as usize, self.top as usize);
        let x = Lanes::<S, N>::from_fn(
            token,
            #[inline(always)]
            |lane| (left + self.lane_position::<_, N>(token, column, lane).0) as f32,
        );
        let y = Lanes::<S, N>::from_fn(
            token,
            #[inline(always)]
            |lane| (top + self.lane_position::<_, N>(token, column, lane).1) as f32,
        );
        let seen = self.radiance(token, column, x, y);
        let color = [seen.color.x, seen.color.y, seen.color.z, seen.alpha];
        for (plane, numbers) in color.into_iter().enumerate() {
            self.store(plane, column, numbers);
        }
        if self.image.layers.is_empty() {
            return;
        }
        let met = self.program.aovs(x, y);
        let mut plane = color.len();
        for layer in &self.image.layers {
            let numbers: &[Lanes<S, N>] = match layer {
                Layer::Depth => &[met.depth],
                Layer::Object => &[met.object],
                Layer::Steps => &[met.steps],
                Layer::Normal => &<[_; 3]>::from(met.normal),
                Layer::Position => &<[_; 3]>::from(met.position),
                Layer::Albedo => &<[_; 3]>::from(met.albedo),
            };
            for &numbers in numbers {
                self.store(plane, column, numbers);
                plane += 1;
            }
        }
    }

    /// The color of a packet's pixels. Their samples are summed in runs, which does not change the sum.
    #[inline(always)]
    fn radiance<S: Token, const N: usize>(
        &self,
        token: S,
        column: usize,
        x: Lanes<S, N>,
        y: Lanes<S, N>,
    ) -> Radiance<Lanes<S, N>> {
        let (columns, _) = block::<_, N>(token);
        let pixels = columns.min(self.width - column) * self.rows();
        let (samples, zero) = (self.image.samples, x.constant(0.0));
        let mut sum = Radiance { color: vec3(zero, zero, zero), alpha: zero, evaluations: zero };
        for first in (0..samples).step_by(SAMPLES_PER_RUN as usize) {
            let run = SAMPLES_PER_RUN.min(samples - first);
            let (first, end) = (first as f32, (first + run) as f32);
            sum = self.program.accumulate(x, y, x.constant(first), x.constant(end), sum);
            (self.progress)(pixels as u64 * u64::from(run));
        }
        self.program.mean(sum)
    }

    /// Rows of the band.
    #[inline(always)]
    fn rows(&self) -> usize {
        self.planes[0].len() / self.width
    }

    /// Column and row in the band of a packet's lane. Lanes beyond the band's edge repeat its last pixels.
    #[inline(always)]
    fn lane_position<S: Token, const N: usize>(&self, token: S, column: usize, lane: usize) -> (usize, usize) {
        let (columns, _) = block::<_, N>(token);
        ((column + lane % columns).min(self.width - 1), (lane / columns).min(self.rows() - 1))
    }

    /// Writes the values of a packet that starts in `column` of the band.
    #[inline(always)]
    fn store<S: Token, const N: usize>(&mut self, plane: usize, column: usize, numbers: Lanes<S, N>) {
        let mut buffer = [0.0; 64];
        // A file must not distinguish zeros by their sign.
        (numbers + 0.0).store(&mut buffer);
        for (lane, &number) in buffer[..Lanes::<S, N>::COUNT].iter().enumerate() {
            let (x, y) = self.lane_position::<_, N>(numbers.token(), column, lane);
            self.planes[plane][y * self.width + x] = number;
        }
    }
}
