//! Splits a frame into tiles: rectangles that workers lease.

use serde::{Deserialize, Serialize};

/// Tile edges are multiples of this many pixels, except at the picture's right and bottom edge.
pub const GRID_PX: u32 = 32;
/// Sample rays in a tile of ordinary size: about one second on one core.
pub const TARGET_TILE_RAYS: u64 = 1 << 20;
/// Maximum number of tiles in a frame.
pub const MAX_TILES_PER_FRAME: u64 = 1024;
/// Maximum size of a tile's pixels, in bytes.
pub const MAX_TILE_BYTES: u64 = 64 << 20;

/// A rectangle of pixels; x to the right, y down, from the picture's top left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Rect {
    /// Left edge, in pixels.
    pub x: u32,
    /// Top edge, in pixels.
    pub y: u32,
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
}

impl Rect {
    /// Number of pixels.
    pub fn pixels(self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    /// Rectangle that covers a whole picture.
    pub fn full(width: u32, height: u32) -> Self {
        Self { x: 0, y: 0, width, height }
    }
}

/// Settings that decide the size of a frame's tiles.
#[derive(Clone, Copy, Debug)]
pub struct Tiling {
    /// Picture width, in pixels.
    pub width: u32,
    /// Picture height, in pixels.
    pub height: u32,
    /// Rays a pixel.
    pub samples: u32,
    /// Bytes of finished data a pixel.
    pub pixel_bytes: u32,
    /// Edge requested by the operator, in pixels; rounded up to the grid.
    pub tile_edge: Option<u32>,
}

impl Tiling {
    /// Cuts a frame into tiles, row by row: squares of [`TARGET_TILE_RAYS`] rays unless an edge was requested;
    /// larger if the frame would otherwise have too many tiles, smaller if a tile would have too many bytes.
    pub fn tiles(&self) -> Vec<Rect> {
        let edge = self.edge_px();
        let rows = (0..self.height).step_by(edge as usize);
        rows.flat_map(|y| (0..self.width).step_by(edge as usize).map(move |x| (x, y)))
            .map(|(x, y)| Rect { x, y, width: edge.min(self.width - x), height: edge.min(self.height - y) })
            .collect()
    }

    /// Edge of the tiles, in pixels; those at the right and the bottom may be smaller.
    pub fn edge_px(&self) -> u32 {
        let by_rays = ((TARGET_TILE_RAYS / u64::from(self.samples)) as f64).sqrt() as u32;
        let fits_bytes = (((MAX_TILE_BYTES / u64::from(self.pixel_bytes)) as f64).sqrt() as u32).max(GRID_PX);
        let asked = self.tile_edge.unwrap_or(by_rays).max(1);
        let mut edge = asked.next_multiple_of(GRID_PX).min(fits_bytes / GRID_PX * GRID_PX);
        while self.count(edge) > MAX_TILES_PER_FRAME {
            edge += GRID_PX;
        }
        edge
    }

    fn count(&self, edge: u32) -> u64 {
        u64::from(self.width.div_ceil(edge)) * u64::from(self.height.div_ceil(edge))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tiling(width: u32, height: u32, samples: u32) -> Tiling {
        Tiling { width, height, samples, pixel_bytes: 16, tile_edge: None }
    }

    #[test]
    fn full_hd_at_four_samples_has_few_tiles() {
        let tiles = tiling(1920, 1080, 4).tiles();
        assert!((8..=12).contains(&tiles.len()), "{}", tiles.len());
    }

    #[test]
    fn tiles_cover_every_pixel_once() {
        for (width, height, samples) in [(1, 1, 1), (33, 65, 9), (1920, 1080, 4), (16384, 16384, 1), (640, 360, 65536)]
        {
            let tiling = tiling(width, height, samples);
            let tiles = tiling.tiles();
            assert!(tiles.len() as u64 <= MAX_TILES_PER_FRAME);
            let pixels: u64 = tiles.iter().map(|tile| tile.pixels()).sum();
            assert_eq!(pixels, u64::from(width) * u64::from(height));
            assert!(tiles.iter().all(|tile| tile.x % GRID_PX == 0 && tile.y % GRID_PX == 0));
        }
    }
}
