//! Published figures of the paper's own program. Nothing here is measured by this program.
//!
//! The figures are from Table 1 of Robles, Lee, Yin and Dhar, "Procedural Rendering with Ray Marching",
//! USC CSCI 580, 2022: the best and the worst block of each resolution, 8 samples, a laptop's RTX 3070 next
//! to a serial run on a Ryzen. `h200_ms` is the kernel time of their CUDA program, built with nvcc 13 and run
//! on one NVIDIA H200 by this project.

use serde::Serialize;
use worker::cuda::BlockDim;

/// Hardware of the other figures of the table.
pub(super) const HARDWARE: &str = "published: RTX 3070 laptop and one core of a Ryzen; H200: the paper's program there";

/// A row of the paper's Table 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Published {
    /// Pixels along an edge of the square picture.
    #[serde(skip)]
    resolution: u32,
    #[serde(skip)]
    block: BlockDim,
    /// Time on the GPU, in milliseconds.
    pub(super) parallel_ms: f64,
    /// Time on one core, in seconds.
    pub(super) serial_s: f64,
    /// Speed of the GPU relative to the core.
    pub(super) speed_up: f64,
    /// Fraction of branches that all threads of a warp take alike, in percent.
    pub(super) branch_efficiency_percent: f64,
    /// Active fraction of the GPU's warps, in percent.
    pub(super) achieved_occupancy_percent: f64,
    /// Theoretical maximum of that fraction, in percent.
    pub(super) theoretical_occupancy_percent: f64,
    /// Kernel time of the same program on an H200, in milliseconds.
    pub(super) h200_ms: f64,
}

/// Creates a row from its figures in the order of the table.
const fn row(resolution: u32, block: (u32, u32), times: [f64; 3], kernel: [f64; 3], h200_ms: f64) -> Published {
    let [parallel_ms, serial_s, speed_up] = times;
    let [branch_efficiency_percent, achieved_occupancy_percent, theoretical_occupancy_percent] = kernel;
    Published {
        resolution,
        block: BlockDim { columns: block.0, rows: block.1 },
        parallel_ms,
        serial_s,
        speed_up,
        branch_efficiency_percent,
        achieved_occupancy_percent,
        theoretical_occupancy_percent,
        h200_ms,
    }
}

const TABLE: [Published; 8] = [
    row(256, (8, 8), [27.0, 29.5, 1092.0], [99.27, 83.4, 87.5], 4.40),
    row(256, (32, 8), [42.0, 29.5, 702.0], [97.54, 76.6, 83.3], 5.79),
    row(512, (8, 8), [73.0, 117.8, 1614.0], [99.38, 82.7, 87.5], 9.80),
    row(512, (32, 8), [96.0, 117.8, 1227.0], [99.27, 72.4, 83.3], 13.1),
    row(1024, (8, 8), [191.0, 476.9, 2497.0], [99.38, 83.7, 87.5], 25.7),
    row(1024, (16, 16), [209.0, 476.9, 2282.0], [98.65, 81.1, 87.5], 29.3),
    row(1024, (128, 1), [241.0, 476.9, 1979.0], [98.65, 75.2, 83.3], 35.6),
    row(1024, (256, 1), [244.0, 476.9, 1955.0], [98.65, 75.9, 83.3], 36.0),
];

/// Row of a resolution and block dimensions, if there is one.
pub(super) fn published(resolution: u32, block: BlockDim) -> Option<Published> {
    TABLE.into_iter().find(|row| (row.resolution, row.block) == (resolution, block))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_speed_ups_are_serial_over_parallel_time() {
        for row in TABLE {
            let ratio = row.serial_s * 1e3 / row.parallel_ms;
            assert!((ratio / row.speed_up - 1.0).abs() < 2e-3, "{row:?}: {ratio}");
        }
    }
}
