//! Map of a frame's time: a small block in each cell of a grid is rendered as in the picture, with one ray a pixel, and all
//! of the frame is marched once in small, for the steps.

use std::time::Duration;

use proto::Rect;
use proto::price::PriceMap;
use scene::{Format, Job, Layer};
use worker::{CancelFlag, CpuRenderer, RenderError, Renderer, TileRequest};

use crate::cost_sample::{Block, Pass};

/// Maximum number of columns and of rows.
const MAX_CELLS: u32 = 32;
/// Minimum edge of a cell, in pixels.
const MIN_CELL_PX: u32 = 16;
/// Size of a block, in pixels: what is rendered together.
const BLOCK_PX: [u32; 2] = [16, 8];
/// Edge of a cell in the small frame, in pixels.
const STEPS_PX: u32 = 4;

/// Measures the map of frame 0, which takes this CPU time in all.
pub(super) fn measure(
    job: &Job,
    renderers: &[CpuRenderer],
    limit: Duration,
    frame_seconds: f64,
) -> anyhow::Result<PriceMap> {
    let [columns, rows] = grid(job.image.film().width, job.image.film().height);
    let steps = steps(job, renderers, limit / 2, [columns, rows])?;
    let mut single = job.clone();
    single.image.samples = 1.into();
    let rects = blocks(job.image.film().width, job.image.film().height, [columns, rows]);
    // Whatever is prepared once is prepared before.
    Pass::render(&single, 0, renderers, limit, &rects[..1])?;
    let pass = Pass::render(&single, 0, renderers, limit / 2, &rects)?;
    let seconds = fill(&pass.blocks, job, [columns, rows], &steps);
    let sum: f64 = seconds.iter().sum();
    let scale = if sum > 0.0 { frame_seconds / sum } else { 0.0 };
    let rounded = |number: f64| format!("{number:.3e}").parse().unwrap_or(number);
    Ok(PriceMap {
        columns,
        rows,
        seconds: seconds.into_iter().map(|seconds| rounded(seconds * scale)).collect(),
        steps: steps.into_iter().map(rounded).collect(),
    })
}

/// Columns and rows of cells that are about square.
fn grid(width: u32, height: u32) -> [u32; 2] {
    let edge = width.max(height).div_ceil(MAX_CELLS).max(MIN_CELL_PX);
    [width, height].map(|length| length.div_ceil(edge).max(1))
}

/// Left and right, or top and bottom, of a cell.
fn span(cell: u32, cells: u32, length: u32) -> [u32; 2] {
    [cell, cell + 1].map(|edge| (u64::from(length) * u64::from(edge) / u64::from(cells)) as u32)
}

/// A block in the middle of each cell, ordered so that the first few are all over the picture.
fn blocks(width: u32, height: u32, [columns, rows]: [u32; 2]) -> Vec<Rect> {
    let mut rects = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let place = |cell, cells, length: u32, block: u32| {
                let [start, end] = span(cell, cells, length);
                let block = block.min(length);
                ((start + end).saturating_sub(block) / 2).min(length - block)
            };
            let (x, y) = (place(column, columns, width, BLOCK_PX[0]), place(row, rows, height, BLOCK_PX[1]));
            rects.push(Rect { x, y, width: BLOCK_PX[0].min(width), height: BLOCK_PX[1].min(height) });
        }
    }
    // A step that has no divisor in common with their number visits each once.
    let count = rects.len();
    let divides = |number: usize, divisor: usize| number.is_multiple_of(divisor);
    let is_coprime = |step: &usize| !(2..=*step).any(|divisor| divides(*step, divisor) && divides(count, divisor));
    let step = (count * 5 / 8..count).find(|step| *step > 0 && is_coprime(step)).unwrap_or(1);
    (0..count).map(|index| rects[index * step % count]).collect()
}

/// Seconds of each cell up to a common factor: measured, or where the time was up, as long for each step as in the nearest
/// cell that was measured.
fn fill(blocks: &[Block], job: &Job, [columns, rows]: [u32; 2], steps: &[f64]) -> Vec<f64> {
    let (width, height) = (job.image.film().width, job.image.film().height);
    let mut known: Vec<Option<f64>> = vec![None; steps.len()];
    for Block { pixels, seconds } in blocks {
        let middle = |start: u32, length: u32, cells: u32, all: u32| {
            let cell = u64::from(start + length / 2) * u64::from(cells) / u64::from(all);
            (cell as usize).min(cells as usize - 1)
        };
        let rect = pixels.rect;
        let (column, row) = (middle(rect.x, rect.width, columns, width), middle(rect.y, rect.height, rows, height));
        known[row * columns as usize + column] = Some(seconds / rect.pixels() as f64);
    }
    let place = |index: usize| [index % columns as usize, index / columns as usize];
    let nearest = |index: usize| {
        let measured = known.iter().enumerate().filter_map(|(other, seconds)| seconds.map(|seconds| (other, seconds)));
        let distance = |other: usize| {
            let ([x, y], [column, row]) = (place(index), place(other));
            x.abs_diff(column).pow(2) + y.abs_diff(row).pow(2)
        };
        measured.min_by_key(|(other, _)| distance(*other))
    };
    (0..known.len())
        .map(|index| {
            let [column, row] = place(index);
            let [left, right] = span(column as u32, columns, width);
            let [top, bottom] = span(row as u32, rows, height);
            let area = f64::from(right - left) * f64::from(bottom - top);
            let of_pixel = known[index].or_else(|| {
                nearest(index).map(|(other, seconds)| seconds * (steps[index] + 1.0) / (steps[other] + 1.0))
            });
            of_pixel.unwrap_or(0.0) * area
        })
        .collect()
}

/// Mean steps of a ray in each cell.
fn steps(job: &Job, renderers: &[CpuRenderer], limit: Duration, [columns, rows]: [u32; 2]) -> anyhow::Result<Vec<f64>> {
    let mut small = job.clone();
    small.image.resize(columns * STEPS_PX, rows * STEPS_PX);
    small.image.samples = 1.into();
    small.image.format = Format::Exr;
    small.image.clear_parts_of_light();
    small.image.layers = vec![Layer::Steps];
    small.image.denoise = false;
    let mut steps = vec![0.0; columns as usize * rows as usize];
    let Some(renderer) = renderers.first() else { return Ok(steps) };
    let cancel = CancelFlag::new();
    let start = std::time::Instant::now();
    for row in 0..rows {
        if start.elapsed() > limit {
            break;
        }
        let rect = Rect { x: 0, y: row * STEPS_PX, width: columns * STEPS_PX, height: STEPS_PX };
        let tile = match renderer.render(&TileRequest { job: &small, frame: 0, rect }, &cancel, &|_| ()) {
            Ok(tile) => tile,
            Err(RenderError::Cancelled) => break,
            Err(error) => return Err(error.into()),
        };
        let Some(plane) = tile.planes.last() else { break };
        for (index, value) in plane.iter().enumerate() {
            let column = index as u32 % rect.width / STEPS_PX;
            steps[(row * columns + column) as usize] += f64::from(*value) / f64::from(STEPS_PX * STEPS_PX);
        }
    }
    Ok(steps)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_cell_has_one_block_inside_the_picture() {
        for (width, height) in [(1, 1), (17, 3), (640, 360), (1920, 1080), (300, 4000)] {
            let [columns, rows] = grid(width, height);
            assert!(columns <= MAX_CELLS && rows <= MAX_CELLS);
            let rects = blocks(width, height, [columns, rows]);
            assert_eq!(rects.len() as u32, columns * rows);
            let distinct: std::collections::HashSet<_> = rects.iter().collect();
            assert_eq!(distinct.len(), rects.len(), "{width}×{height}");
            assert!(rects.iter().all(|rect| rect.x + rect.width <= width && rect.y + rect.height <= height));
        }
    }
}
