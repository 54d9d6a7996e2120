//! Verification of a stored picture: its tiles are rendered again and compared, value by value.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Rect;

/// Edge of the tiles that are compared, in pixels; at the right and at the bottom they are smaller.
pub const TILE_PX: u32 = 64;
/// Maximum number of tiles that are listed as different; there may be more.
pub const MAX_LISTED: usize = 64;
/// Chance with which a sample should find a change.
pub const SURE: f64 = 0.95;

/// A comparison, without those who made the picture.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Tiles that were rendered again.
    pub tiles_checked: u32,
    /// Tiles of the picture.
    pub tiles_total: u32,
    /// Whether every value of these tiles is what it should be.
    pub pixels_same: bool,
    /// Whether the file is, byte by byte, what sdfarm writes for its pixels and this job.
    pub encoding_same: bool,
    /// Number of tiles that differ.
    pub tiles_different: u32,
    /// Number of pixels that differ.
    pub pixels_different: u64,
    /// The tiles that differ, from the top; at most [`MAX_LISTED`].
    pub differs: Vec<DifferingTile>,
    /// Everything else that was found, in words.
    pub findings: Vec<String>,
    /// BLAKE3 of the scene at this frame, in hex.
    pub scene: Option<String>,
}

impl Comparison {
    /// Whether nothing differs.
    pub fn is_same(&self) -> bool {
        self.pixels_same && self.encoding_same
    }
}

/// A tile with a wrong pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DifferingTile {
    /// Left edge, in pixels.
    pub x: u32,
    /// Top edge, in pixels.
    pub y: u32,
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
    /// Number of its pixels that differ.
    pub pixels: u32,
    /// The first of them, from the top.
    pub first: DifferingPixel,
}

/// A wrong value, and the right one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DifferingPixel {
    /// Column in the picture.
    pub x: u32,
    /// Row in the picture.
    pub y: u32,
    /// Channel, `R` for example.
    pub channel: String,
    /// Value in the file; null if it is not a number.
    pub value: Option<f64>,
    /// Value that it should have; null if it is not a number.
    pub expected: Option<f64>,
}

/// A worker that rendered a part of a picture.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Maker {
    /// Name of the worker.
    pub worker: String,
    /// Its id, new at every start.
    pub id: String,
    /// Its device.
    pub device: String,
    /// Rectangles that it rendered, as `[x, y, width, height]`.
    pub tiles: Vec<[u32; 4]>,
}

impl Maker {
    /// Whether it rendered a pixel of this tile.
    pub fn touches(&self, tile: &DifferingTile) -> bool {
        let meets = |start: u32, length: u32, other: u32, other_length: u32| {
            start < other + other_length && other < start + length
        };
        self.tiles
            .iter()
            .any(|&[x, y, width, height]| meets(x, width, tile.x, tile.width) && meets(y, height, tile.y, tile.height))
    }
}

/// Response to `POST /v1/jobs/{id}/frames/{frame}/verify`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Verification {
    /// Whether nothing differs in what was checked; true if no tile was asked for.
    pub same: bool,
    /// Tiles that were rendered again: fewer than asked for if the time was up.
    pub tiles_checked: u32,
    /// Tiles of the picture, of 64×64 pixels.
    pub tiles_total: u32,
    /// Chance that a change confined to one tile would have been found.
    pub finds_one_tile: f64,
    /// Number of tiles that a change had to touch to be found with a chance of 95 %.
    pub finds_tiles: u32,
    /// Number of pixels that differ.
    pub pixels_different: u64,
    /// The tiles that differ, from the top; at most 64.
    pub differs: Vec<DifferingTile>,
    /// Everything else that was found, in words.
    pub findings: Vec<String>,
    /// Workers that rendered the picture; null if the database does not know any more.
    pub made_by: Option<Vec<Maker>>,
    /// Picture version of the server.
    pub picture_version: u32,
    /// BLAKE3 of the scene at this frame, in hex; null if no tile was asked for and the database does not know it.
    pub scene: Option<String>,
    /// Version of sdfarm that rendered again.
    pub version: String,
}

/// Tiles of a picture that are compared, row by row.
pub fn tiles(width: u32, height: u32) -> Vec<Rect> {
    let rows = (0..height).step_by(TILE_PX as usize);
    rows.flat_map(|y| (0..width).step_by(TILE_PX as usize).map(move |x| (x, y)))
        .map(|(x, y)| Rect { x, y, width: TILE_PX.min(width - x), height: TILE_PX.min(height - y) })
        .collect()
}

/// Chance that `checked` of `total` tiles, chosen at random, include one of `changed` tiles.
pub fn probability_to_find(checked: u32, total: u32, changed: u32) -> f64 {
    // Without replacement: each checked tile misses with what is left.
    let missed: f64 = (0..checked.min(total))
        .map(|drawn| f64::from((total - drawn).saturating_sub(changed)) / f64::from(total - drawn))
        .product();
    1.0 - missed
}

/// Least number of changed tiles such that a sample finds one with the chance [`SURE`].
pub fn tiles_found_surely(checked: u32, total: u32) -> u32 {
    (1..total).find(|&changed| probability_to_find(checked, total, changed) >= SURE).unwrap_or(total)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chances_are_those_of_drawing_without_replacement() {
        assert_eq!(probability_to_find(10, 10, 1), 1.0);
        assert_eq!(probability_to_find(0, 10, 5), 0.0);
        assert!((probability_to_find(3, 10, 1) - 0.3).abs() < 1e-12);
        // 1 − C(8, 3)/C(10, 3)
        assert!((probability_to_find(3, 10, 2) - (1.0 - 56.0 / 120.0)).abs() < 1e-12);
        assert_eq!(probability_to_find(3, 10, 8), 1.0);
        assert_eq!(tiles_found_surely(10, 10), 1);
        let least = tiles_found_surely(8, 510);
        assert!(probability_to_find(8, 510, least) >= SURE && probability_to_find(8, 510, least - 1) < SURE, "{least}");
    }

    #[test]
    fn tiles_cover_a_picture_once() {
        let found = tiles(130, 65);
        assert_eq!(found.len(), 6);
        assert_eq!(found.iter().map(|tile| tile.pixels()).sum::<u64>(), 130 * 65);
        assert_eq!(found[5], Rect { x: 128, y: 64, width: 2, height: 1 });
    }
}
